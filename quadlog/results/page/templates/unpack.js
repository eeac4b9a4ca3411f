"use strict";
// Numbers of the page from one deflated block (page/pack.py), colours, small helpers, and a clock for each group.
const pageData = JSON.parse(document.getElementById("page-data").textContent);
const rootStyle = getComputedStyle(document.documentElement);
const inks = new Map(); // asking for a style is slow
const paint = (name) => inks.get(name) ?? inks.set(name, rootStyle.getPropertyValue(`--${name}`).trim()).get(name);
const redraws = []; // called when the colours change

const unpack = async () => {
  const bytes = Uint8Array.from(atob(pageData.packed), (sign) => sign.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const flat = new Uint8Array(await new Response(stream).arrayBuffer());
  let start = 0;
  const columns = pageData.columns.map(([count, unit, offset]) => {
    const column = new Float64Array(count);
    for (let row = 0, whole = 0; row < count; row++) {
      const at = start + row;
      const code = flat[at] + 256 * flat[at + count] + 65536 * flat[at + 2 * count] + 16777216 * flat[at + 3 * count];
      if (code > 0) whole += code % 2 ? (code - 1) / 2 : -code / 2;
      column[row] = code > 0 ? whole * unit + offset : NaN;
    }
    start += 4 * count;
    return column;
  });
  const cells = pageData.cells.map((count) => flat.slice(start, (start += count)));
  return { columns, cells };
};

// The instant that the charts and scenes of a group show. turn: number of the frame of a running player.
const clocks = {};
const clockOf = (group) =>
  (clocks[group] ??= {
    now: null,
    listeners: [],
    pause: () => {},
    rest: () => {}, // called when it has been set, or what is shown has changed
    set(seconds, turn) {
      this.now = seconds;
      this.listeners.forEach((listen) => listen(seconds, turn));
      this.rest();
    },
  });

const element = (tag, attributes = {}, ...children) => {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (value !== false && value !== undefined) made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children);
  return made;
};
const button = (text, name, act, attributes = {}) =>
  element("button", { type: "button", title: name, "aria-label": name, onclick: act, ...attributes }, text);

const short = (value, digits = 4) =>
  Number.isFinite(value) ? String(Number(value.toPrecision(digits))).replace("-", "\u2212") : "–";

// The last row that is not later than an instant; -1 if all are later.
const rowAt = (times, instant) => {
  let [low, high] = [-1, times.length - 1];
  while (low < high) {
    const middle = Math.ceil((low + high) / 2);
    if (times[middle] <= instant + 1e-6) low = middle;
    else high = middle - 1;
  }
  return low;
};

// Calls fit with the width of an element, now and whenever it changes.
const onWidth = (place, fit) => {
  let width = 0;
  new ResizeObserver(() => {
    if (place.clientWidth === width || place.clientWidth === 0) return;
    width = place.clientWidth;
    fit(width);
  }).observe(place);
};
for (const change of ["(prefers-color-scheme: dark)", "print"]) {
  matchMedia(change).addEventListener("change", () => {
    inks.clear();
    redraws.forEach((redraw) => redraw());
  });
}
