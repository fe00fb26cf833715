// Replays of runs: the geoms of a plant, seen across the plane in which they move, at a time that
// a slider says.
"use strict";

(() => {
  const AROUND = Array.from({ length: 24 }, (_, k) => [Math.cos((k * Math.PI) / 12), Math.sin((k * Math.PI) / 12)]);
  const LEVELS = [-1, -0.87, -0.5, 0, 0.5, 0.87, 1];

  // By shape: points, and the radius by which their convex hull grows.
  const POINTS = {
    sphere: ([r]) => [[[0, 0, 0]], r],
    capsule: ([r, half]) => [[[0, 0, -half], [0, 0, half]], r],
    cylinder: ([r, half]) => [AROUND.flatMap(([x, y]) => [[r * x, r * y, -half], [r * x, r * y, half]]), 0],
    ellipsoid: ([a, b, c]) => [LEVELS.flatMap((z) => AROUND.map(([x, y]) => [a * x * Math.sqrt(1 - z * z), b * y * Math.sqrt(1 - z * z), c * z])), 0],
    box: ([a, b, c]) => [[-a, a].flatMap((x) => [-b, b].flatMap((y) => [[x, y, -c], [x, y, c]])), 0],
  };

  const floats = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const signed = (x, digits) => x.toFixed(digits).replace("-", "−");
  const rounded = (x) => String(Number(x.toPrecision(3))).replaceAll("-", "−");

  function hull(points) {
    const sorted = points.sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    const half = (given) => {
      const found = [];
      for (const p of given) {
        while (found.length > 1) {
          const [a, b] = found.slice(-2);
          if ((b[0] - a[0]) * (p[1] - a[1]) > (b[1] - a[1]) * (p[0] - a[0])) break;
          found.pop();
        }
        found.push(p);
      }
      return found;
    };
    return [...half(sorted).slice(0, -1), ...half([...sorted].reverse())];
  }

  class Replay {
    constructor(root) {
      const data = JSON.parse(document.getElementById(root.dataset.rows).textContent);
      const canvases = root.querySelectorAll("canvas");
      const names = root.querySelectorAll("figcaption");
      [this.button, this.slider, this.output] = ["button", "input", "output"].map((one) => root.querySelector(one));
      Object.assign(this, data, { root, sizes: floats(data.sizes), playing: 0 });
      this.changes = data.changes.map((one) => ({ ...one, values: floats(one.values) }));
      this.runs = data.runs.map((run, k) => ({
        ...run, canvas: canvases[k], name: names[k],
        centres: floats(run.centres), turns: floats(run.turns), aims: floats(run.aims),
      }));
      for (const { name, colour } of this.runs) name.style.setProperty("--own", colour);
      this.button.addEventListener("click", () => this.play(!this.playing));
      this.slider.addEventListener("input", () => { this.play(false); this.draw(); });
      root.addEventListener("keydown", (event) => this.key(event));
      new ResizeObserver(() => this.draw()).observe(root);
      matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    }

    get time() { return Number(this.slider.value); }
    set time(t) { this.slider.value = Math.min(Math.max(t, 0), this.duration); this.draw(); }

    key(event) {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (event.ctrlKey || event.metaKey || event.altKey || (event.key !== " " && !step)) return;
      if (event.key === " " && event.target === this.button) return; // it presses the button
      event.preventDefault();
      this.play(step ? false : !this.playing);
      if (step) this.time += (step * (event.shiftKey ? 1 : 0.1));
    }

    play(on) {
      cancelAnimationFrame(this.playing);
      this.playing = 0;
      this.button.textContent = on ? "❚❚" : "▶";
      this.button.setAttribute("aria-label", on ? "Pause" : "Play");
      if (!on) return;
      const from = this.time < this.duration ? this.time : 0;
      const start = performance.now();
      const still = matchMedia("(prefers-reduced-motion: reduce)").matches ? 1 : 0; // pictures a second apart
      const next = (now) => {
        const gone = Math.max(0, now - start) / 1000;
        this.time = from + (still ? Math.floor(gone) : gone);
        if (this.time >= this.duration) this.play(false);
        else this.playing = requestAnimationFrame(next);
      };
      this.playing = requestAnimationFrame(next);
    }

    draw() {
      if (!this.root.clientWidth) return;
      const now = Math.round(this.time * this.fps);
      const said = [`t = ${this.time.toFixed(2)} s`];
      for (const { name, unit, values } of this.changes) {
        said.push(`${name} ${rounded(values[Math.min(now, values.length - 1)])} ${unit}`);
      }
      if (this.pushes.some(([from, to]) => from <= this.time && this.time < to)) said.push("disturbed");
      this.output.textContent = said.join(" · ");
      this.slider.setAttribute("aria-valuetext", said.join(", "));
      for (const run of this.runs) this.picture(run, Math.min(now, run.frames - 1), now >= run.frames - 1);
    }

    picture(run, frame, over) {
      run.name.querySelector("span").textContent = over && run.ended ? run.ended : "";
      const { canvas } = run, [across, up] = this.view, ratio = devicePixelRatio || 1;
      const tallest = this.runs.length > 1 && innerWidth < 600 ? 220 : 420; // on a phone all are seen
      const width = canvas.clientWidth, height = Math.round(Math.min(tallest, width * Math.min(1, Math.max(0.4, up / across))));
      canvas.style.height = `${height}px`;
      [canvas.width, canvas.height] = [width * ratio, height * ratio];
      const room = height - 18; // below it stand the marks of x
      const draw = canvas.getContext("2d"), scale = Math.min(width / across, room / up);
      const [u, v] = run.aims.subarray(2 * frame, 2 * frame + 2);
      const at = ([x, y]) => [width / 2 + (x - u) * scale, room / 2 - (y - v) * scale];
      const ink = getComputedStyle(this.root).color, own = getComputedStyle(run.name, "::before").backgroundColor;
      Object.assign(canvas.dataset, { frame });
      draw.scale(ratio, ratio);
      draw.lineJoin = draw.lineCap = "round";
      draw.font = "12px system-ui, sans-serif";
      [draw.strokeStyle, draw.fillStyle] = [ink, ink];
      this.grid(draw, at, [u, v], [width, height], scale);
      const far = (width + height) / scale;
      for (const { words, at: [x, y], along: [dx, dy] } of this.lines) {
        const middle = (u - x) * dx + (v - y) * dy;
        const [near, there] = [middle - far, middle + far].map((s) => at([x + s * dx, y + s * dy]));
        draw.setLineDash(words ? [6, 4] : []);
        [draw.globalAlpha, draw.lineWidth] = words ? [0.9, 1.5] : [0.6, 2];
        draw.beginPath();
        draw.moveTo(...near);
        draw.lineTo(...there);
        draw.stroke();
        const [px, py] = at([x, y]);
        const [tx, ty] = Math.abs(dy) > 0.5 ? [px, words === "limit" ? 14 : 29] : [width - 70, py - 4];
        if (words && tx > 0 && tx < width && ty > 0 && ty < height) {
          draw.textAlign = tx > width / 2 ? "right" : "left";
          draw.fillText(words, tx + (tx > width / 2 ? -5 : 5), ty);
        }
      }
      draw.setLineDash([]);
      const order = this.shapes.map((_, g) => g);
      const depth = (g) => run.centres[3 * (frame * order.length + g) + 2];
      const back = getComputedStyle(canvas).backgroundColor;
      for (const g of order.sort((a, b) => depth(a) - depth(b) || a - b)) this.geom(draw, run, frame, g, at, scale, this.moves[g] ? own : ink, back);
      draw.globalAlpha = 1;
    }

    geom(draw, run, frame, g, at, scale, colour, back) {
      const count = this.shapes.length, here = frame * count + g;
      const size = this.sizes.length > 3 * count ? Math.min(frame, this.sizes.length / (3 * count) - 1) * count + g : g;
      const [points, radius] = POINTS[this.shapes[g]](this.sizes.subarray(3 * size, 3 * size + 3));
      const [cx, cy] = run.centres.subarray(3 * here, 3 * here + 2), turn = run.turns.subarray(6 * here, 6 * here + 6);
      const seen = points.map(([x, y, z]) => at([
        cx + turn[0] * x + turn[1] * y + turn[2] * z, cy + turn[3] * x + turn[4] * y + turn[5] * z,
      ]));
      draw.beginPath();
      for (const [x, y] of hull(seen)) draw.lineTo(x, y);
      draw.lineTo(seen[0][0] + 0.01, seen[0][1]); // else a single point is not drawn
      draw.closePath();
      const wide = Math.max(2, 2 * radius * scale);
      for (const [shade, width] of [[back, wide + 3], [colour, wide]]) {
        [draw.strokeStyle, draw.fillStyle, draw.lineWidth] = [shade, shade, width];
        draw.globalAlpha = this.moves[g] || shade === back ? 1 : 0.3;
        draw.stroke();
        draw.globalAlpha *= shade === back ? 1 : 0.45;
        if (points.length > 2) draw.fill();
      }
    }

    grid(draw, at, [u, v], [width, height], scale) {
      const rough = 64 / scale, power = 10 ** Math.floor(Math.log10(rough));
      const step = power * [1, 2, 5, 10].find((x) => x * power >= rough);
      const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
      [draw.lineWidth, draw.textAlign] = [1, "left"];
      const line = (place, mark, horizontal) => {
        const [x, y] = at([place, place]);
        draw.globalAlpha = 0.12;
        draw.beginPath();
        draw.moveTo(horizontal ? 0 : x, horizontal ? y : 0);
        draw.lineTo(horizontal ? width : x, horizontal ? y : height);
        draw.stroke();
        draw.globalAlpha = 0.75;
        draw.fillText(mark, horizontal ? 4 : x + 3, horizontal ? y - 3 : height - 5);
      };
      const marks = (middle, reach) => Array.from({ length: Math.ceil((2 * reach) / step) + 1 }, (_, k) => step * (Math.ceil((middle - reach) / step) + k));
      for (const x of marks(u, width / 2 / scale)) line(x, `${signed(x, digits)} m`, false);
      for (const y of marks(v, height / 2 / scale)) if (at([0, y])[1] < height - 30) line(y, `${signed(y, digits)} m`, true);
    }
  }

  const near = new IntersectionObserver((seen) => {
    for (const { target } of seen.filter((one) => one.isIntersecting)) {
      near.unobserve(target);
      new Replay(target);
    }
  }, { rootMargin: "300px" });
  const begin = () => {
    for (const root of document.querySelectorAll(".replay")) {
      root.hidden = false;
      near.observe(root);
    }
  };
  if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", begin);
  else begin();
})();

