// What the page does beside its replays. Without it everything but the replays is there.

// What scrolls by itself is a stop for the keyboard, what does not need to is none.
const fits = new ResizeObserver((seen) => {
  for (const { target } of seen) {
    if (target.scrollWidth > target.clientWidth) target.tabIndex = 0;
    else target.removeAttribute("tabindex");
  }
});
for (const region of document.querySelectorAll(".scroll, .canvas")) fits.observe(region);

// A link to something folded away opens it.
function unfold() {
  let target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!target) return;
  const folds = [];
  for (let fold = target.closest("details"); fold; fold = fold.parentElement.closest("details")) folds.push(fold);
  for (const fold of folds) fold.open = true;
  if (folds.length) target.scrollIntoView();
}
addEventListener("hashchange", unfold);
unfold();

// On a small screen the contents are folded away, again once something is chosen.
const contents = document.querySelector(".contents details");
const narrow = matchMedia("(max-width: 68.99rem)");
const fold = () => { contents.open = !narrow.matches; };
narrow.addEventListener("change", fold);
contents.addEventListener("click", (event) => {
  if (event.target.closest("a")) fold();
});
fold();
contents.parentElement.classList.add("ready");

// The section in view is marked in the contents.
const links = new Map(
  [...contents.querySelectorAll("a")].map((link) => [link.hash.slice(1), link]),
);
const headings = [...document.querySelectorAll("h2[id]")].filter((h) => links.has(h.id));
const mark = () => {
  const passed = headings.filter((h) => h.getBoundingClientRect().top < innerHeight / 3);
  const current = passed.length ? passed[passed.length - 1].id : "main";
  for (const [id, link] of links) {
    if (id === current) link.setAttribute("aria-current", "true");
    else link.removeAttribute("aria-current");
  }
};
let waiting = false;
addEventListener("scroll", () => {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => { waiting = false; mark(); });
}, { passive: true });
mark();

// A film that is not where the page looks for it is a line, not a broken player.
for (const film of document.querySelectorAll("video")) {
  const missing = () => {
    const line = document.createElement("p");
    line.className = "missing";
    line.textContent = `${film.dataset.name} is not where this page looks for it, or cannot be played here.`;
    film.replaceWith(line);
  };
  if (film.error) missing();
  else film.addEventListener("error", missing);
}

// On paper everything is unfolded.
let folded = [];
addEventListener("beforeprint", () => {
  folded = [...document.querySelectorAll("details:not([open])")];
  for (const fold of folded) fold.open = true;
});
addEventListener("afterprint", () => {
  for (const fold of folded) fold.open = false;
});
