"use strict";
// What the charts over time and the map have in common: the page's colours, short numbers, a bar of buttons, keys.
const chartData = JSON.parse(document.getElementById("chart-data").textContent);
const pageStyle = getComputedStyle(document.documentElement);
const redraws = []; // of every chart, for when light and dark change places
const instants = []; // who wants to know at which instant the reader points: called with seconds, or null
const playheads = []; // of the charts over time: called with the player's seconds, whether numbers are to follow, and the group
const seekers = []; // called with the seconds at which the reader clicked in a chart, and the chart's group

// A canvas needs the colour itself, and the one of this moment; elements follow a variable on their own.
const painted = (name) => () => pageStyle.getPropertyValue(`--${name}`).trim();
const styled = (name) => `var(--${name})`;

const shortNumber = (value) =>
  value === null || value === undefined ? "–" : String(Number(value.toPrecision(4))).replace("-", "\u2212");

const element = (tag, className, text = "") => {
  const made = document.createElement(tag);
  made.className = className;
  made.textContent = text;
  return made;
};

const axis = (size) => ({
  stroke: painted("soft"),
  grid: { stroke: painted("line"), width: 1 },
  ticks: { stroke: painted("line"), width: 1, size: 4 },
  font: "12px system-ui, sans-serif",
  gap: 4,
  size,
  values: (_, values) => values.map((value) => (value === null ? "" : shortNumber(value))),
});

// The place of a figure's chart, shown instead of its picture: [place, area for the chart].
const openChart = (name, help) => {
  const place = document.querySelector(`[data-chart="${name}"]`);
  const figure = place.closest("figure");
  const title = figure.querySelector("h3").textContent;
  place.hidden = false;
  place.tabIndex = 0;
  place.setAttribute("role", "group");
  place.setAttribute("aria-label", `${title}: chart. ${help}`);
  figure.classList.add("charted");
  const area = element("div", "panels");
  place.append(area);
  return [place, area];
};

// actions: [sign, name for those who do not see it, key, what it does]
const addBar = (place, actions) => {
  const title = place.closest("figure").querySelector("h3").textContent;
  const bar = element("div", "bar");
  for (const [sign, name, , act] of actions.filter(([sign]) => sign)) {
    const button = element("button", "", sign);
    button.type = "button";
    button.title = name;
    button.setAttribute("aria-label", `${name}: ${title}`);
    button.addEventListener("click", () => act());
    bar.append(button);
  }
  const picture = element("button", "", "picture");
  picture.type = "button";
  picture.setAttribute("aria-pressed", "false");
  picture.addEventListener("click", () => {
    const shown = place.closest("figure").classList.toggle("pictured");
    picture.setAttribute("aria-pressed", String(shown));
  });
  if (place.closest("figure").querySelector("img")) bar.append(picture);
  place.prepend(bar);
  place.addEventListener("keydown", (event) => {
    const action = actions.find(([, , keys]) => keys.includes(event.key));
    if (event.target !== place || !action || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    action[3]();
  });
};

// Pictures of uPlot know their size in pixels alone; fit is called when the width that is there changes.
const onWidth = (area, fit) => {
  // A fitted chart has another height, and a look at that would be told of it: what is looked at has none.
  const ruler = element("div", "");
  area.prepend(ruler);
  let width = area.clientWidth;
  new ResizeObserver(() => {
    if (area.clientWidth === width || area.clientWidth === 0) return;
    width = area.clientWidth;
    fit(width); // at once: a moment later the reader, or a screenshot, has already seen a chart that is cut off
  }).observe(ruler);
};

// On paper colours are those of light pages.
for (const change of ["(prefers-color-scheme: dark)", "print"]) {
  matchMedia(change).addEventListener("change", () => redraws.forEach((redraw) => redraw()));
}
