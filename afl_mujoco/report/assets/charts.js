// Trajectories of a scenario: two charts, values above and |MuJoCo - ODE| below, zoomed together.
"use strict";

const QUANTITIES = {
  z: "z [m]", phi: "φ [rad]", z_dot: "z′ [m/s]", phi_dot: "φ′ [rad/s]", force: "F [N]",
};
const DEPLOYED = "mujoco sampled";
// From the largest difference to the smallest: mode of MuJoCo and its line.
const MODES = { "mujoco sampled": [], "mujoco continuous": [7, 4], "mujoco exact": [2, 3] };
const COLOURS = 6;
const FAINT = "66"; // appended to #rrggbb
const NARROW = 560;

function decode(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

const known = (x) => (Number.isFinite(x) ? x : null);
const positive = (x) => (x > 0 ? x : null);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const ofController = (index) => colour(`--series-${(index % COLOURS) + 1}`);

class Trajectories {
  constructor(root) {
    this.root = root;
    this.data = JSON.parse(document.getElementById(root.dataset.curves).textContent);
    this.time = Array.from(decode(this.data.time));
    this.all = [this.time[0], this.time[this.time.length - 1]];
    this.range = [...this.all];
    this.charts = [];
    this.watch();
    this.draw();
  }

  get quantity() {
    return this.root.querySelector("fieldset input:checked").value;
  }

  watch() {
    this.root.querySelector("fieldset").addEventListener("change", () => this.draw());
    for (const button of this.root.querySelectorAll("[data-zoom]")) {
      button.addEventListener("click", () => this.zoom(button.dataset.zoom, button.dataset));
    }
    this.root.querySelector(".plot").addEventListener("keydown", (event) => {
      const deed = { ArrowLeft: "left", ArrowRight: "right", "+": "in", "=": "in", "-": "out", 0: "all" }[event.key];
      if (!deed || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      this.zoom(deed, {});
    });
    let width = 0;
    new ResizeObserver(() => {
      const now = this.root.clientWidth;
      if (!now || now === width) return;
      width = now;
      for (const chart of this.charts) chart.setSize(this.size(chart === this.charts[0]));
    }).observe(this.root);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  zoom(deed, { from, to }) {
    const [low, high] = this.range;
    const span = high - low;
    const middle = (low + high) / 2;
    const wanted = {
      in: [middle - span / 4, middle + span / 4],
      out: [middle - span, middle + span],
      left: [low - span / 4, high - span / 4],
      right: [low + span / 4, high + span / 4],
      all: this.all,
      to: [Number(from), Number(to)],
    }[deed];
    this.show(...wanted);
  }

  // Keep the stretch within the run: moved where it sticks out, cut where it is longer.
  show(low, high) {
    const [first, last] = this.all;
    const span = Math.min(Math.max(high - low, 1e-3), last - first);
    low = Math.min(Math.max(low, first), last - span);
    this.range = [low, low + span];
    for (const chart of this.charts) chart.setScale("x", { min: low, max: low + span });
    this.say();
  }

  say() {
    const digits = this.range[1] - this.range[0] < 0.5 ? 4 : 2;
    const [low, high] = this.range.map((t) => t.toFixed(digits));
    this.root.dataset.low = low;
    this.root.dataset.high = high;
    this.root.querySelector("[data-range]").textContent = `t = ${low} to ${high} s`;
  }

  size(top) {
    const width = Math.max(240, this.root.clientWidth);
    return { width, height: width < NARROW ? (top ? 230 : 190) : top ? 290 : 220 };
  }

  draw() {
    for (const chart of this.charts) chart.destroy();
    const [above, below] = [".plot-curves", ".plot-differences"].map((s) => this.root.querySelector(s));
    const plant = this.quantity === "plant";
    below.hidden = plant;
    this.charts = plant
      ? [this.chart(above, this.plant())]
      : [this.chart(above, this.values()), this.chart(below, this.differences())];
    for (const chart of this.charts) makeLegendUsable(chart);
    this.show(...this.range);
  }

  values() {
    const lines = [], data = [this.time];
    this.data.runs.forEach((run, index) => {
      const ideal = decode(run.reference[this.quantity]);
      const stroke = ofController(index);
      lines.push({ label: `${run.controller}, ideal`, stroke: stroke + FAINT, width: 5 });
      data.push(Array.from(ideal, known));
      if (run.differences[DEPLOYED]) {
        const apart = decode(run.differences[DEPLOYED][this.quantity]);
        lines.push({ label: `${run.controller}, MuJoCo`, stroke, width: 1.5, dash: [5, 4] });
        data.push(Array.from(ideal, (x, k) => known(x + apart[k])));
      }
    });
    if (this.quantity === "force") {
      lines.push({ label: "push", stroke: colour("--neutral"), width: 1.5, paths: "stepped" });
      data.push(Array.from(decode(this.data.prescribed.push), known));
    }
    return { lines, data, label: QUANTITIES[this.quantity], digits: (x) => x.toPrecision(5) };
  }

  differences() {
    const lines = [], data = [this.time];
    this.data.runs.forEach((run, index) => {
      for (const [simulator, dash] of Object.entries(MODES)) {
        const signals = run.differences[simulator];
        if (!signals) continue;
        const label = `${run.controller}, ${simulator.replace("mujoco ", "")}`;
        lines.push({ label, stroke: ofController(index), width: 1.5, dash });
        data.push(Array.from(decode(signals[this.quantity]), (x) => positive(Math.abs(x))));
      }
    });
    const unit = QUANTITIES[this.quantity].replace(/.*\[/, "[");
    return { lines, data, label: `|MuJoCo − ideal| ${unit}`, log: true, digits: (x) => x.toExponential(1), last: true };
  }

  plant() {
    const { cart_mass: mass, half_length: length } = this.data.prescribed;
    return {
      lines: [
        { label: "M [kg]", stroke: colour("--series-3"), width: 2 },
        { label: "l [m]", stroke: colour("--series-2"), width: 2, dash: [8, 4] },
      ],
      data: [this.time, Array.from(decode(mass), known), Array.from(decode(length), known)],
      label: "M [kg], l [m]", digits: (x) => x.toPrecision(4), last: true, fromZero: true,
    };
  }

  chart(place, { lines, data, label, log, digits, last, fromZero }) {
    const faint = colour("--faint"), line = colour("--line");
    const axis = {
      stroke: faint, grid: { stroke: line, width: 1 }, ticks: { stroke: line, width: 1 },
      font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif",
    };
    const narrow = this.size(true).width < NARROW;
    const value = (_, x) => (x == null ? "–" : digits(x).replace("-", "−"));
    const options = {
      ...this.size(!log),
      legend: {
        live: true,
        markers: {
          width: (_, index) => (index ? Math.max(2, lines[index - 1].width) : 0),
          dash: (_, index) => {
            const [drawn] = (index && lines[index - 1].dash) || [];
            return !drawn ? "solid" : drawn < 4 ? "dotted" : "dashed";
          },
        },
      },
      cursor: {
        sync: { key: this.root.dataset.curves },
        drag: { x: true, y: false, setScale: false },
        dataIdx: nearestKnown,
      },
      scales: {
        x: { time: false, range: () => this.range },
        y: log ? { distr: 3, range: decades } : { range: (_, low, high) => padded(low, high, fromZero) },
      },
      axes: [
        { ...axis, label: last ? "time t [s]" : undefined, labelSize: 20, size: last ? 34 : 30 },
        {
          ...axis, label, labelSize: 20, size: narrow ? 48 : 58, labelGap: 2,
          values: (_, ticks) => ticks.map(log ? powerOfTen : plainly),
          ...(log ? { filter: wholeDecades, grid: { ...axis.grid, filter: wholeDecades }, ticks: { ...axis.ticks, filter: wholeDecades } } : {}),
        },
      ],
      series: [
        { label: "t", value: (_, t) => (t == null ? "–" : `${t.toFixed(4)} s`) },
        ...lines.map(({ paths, ...rest }) => ({
          ...rest, value, spanGaps: true, points: { show: false },
          paths: paths ? uPlot.paths.stepped({ align: 1 }) : undefined,
        })),
      ],
      hooks: {
        setSelect: [(u) => {
          const { left, width } = u.select;
          if (width < 4) return;
          const range = [u.posToVal(left, "x"), u.posToVal(left + width, "x")];
          u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
          this.show(...range);
        }],
      },
    };
    const chart = new uPlot(options, data, place);
    chart.over.addEventListener("dblclick", (event) => {
      event.stopImmediatePropagation();
      this.show(...this.all);
    }, true);
    chart.root.querySelector("canvas").setAttribute("role", "img");
    chart.root.querySelector("canvas").setAttribute("aria-label", `${label} over time`);
    return chart;
  }
}

function padded(low, high, fromZero) {
  if (low == null) return [0, 1];
  if (fromZero) return [0, 1.08 * Math.max(high, 1e-9)];
  const span = high - low || Math.abs(high) || 1;
  return [low - 0.06 * span, high + 0.06 * span];
}

function decades(_, low, high) {
  if (!(low > 0)) return [1e-17, 1];
  const floor = 10 ** Math.max(-17, Math.floor(Math.log10(low)));
  const top = 10 ** Math.ceil(Math.log10(high) + 1e-9);
  return [floor, top > floor ? top : 10 * floor];
}

const plainly = (x) => (x == null ? "" : String(Number(x.toPrecision(10))).replace("-", "−"));

function powerOfTen(x) {
  if (x == null) return "";
  const raised = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
  return "10" + String(Math.round(Math.log10(x))).replace(/[-0-9]/g, (c) => raised[c]);
}

// Ticks that are powers of ten, every other one or fewer where they would crowd.
function wholeDecades(u, ticks) {
  const range = Math.log10(u.scales.y.max / u.scales.y.min);
  const every = Math.max(1, Math.ceil((range * 18) / Math.max(1, u.bbox.height / devicePixelRatio)));
  return ticks.map((x) => {
    const power = Math.log10(x);
    const whole = Math.abs(power - Math.round(power)) < 1e-6;
    return whole && Math.round(power) % every === 0 ? x : null;
  });
}

// Instants differ between controllers: show each curve's value at its nearest own one.
function nearestKnown(u, index, at) {
  const values = u.data[index];
  if (values[at] != null) return at;
  for (let away = 1; away < 40; away++) {
    if (values[at - away] != null) return at - away;
    if (values[at + away] != null) return at + away;
  }
  return at;
}

// A name in the legend is a switch for the pointer; make it one for the keyboard and for readers.
function makeLegendUsable(chart) {
  chart.root.querySelectorAll(".u-series").forEach((row, index) => {
    const name = row.querySelector("th");
    if (!index) return;
    const say = () => name.setAttribute("aria-pressed", String(chart.series[index].show));
    name.tabIndex = 0;
    name.setAttribute("role", "button");
    name.addEventListener("click", () => setTimeout(say));
    name.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      event.stopPropagation();
      name.click();
    });
    say();
  });
}
