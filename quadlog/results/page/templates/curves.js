"use strict";
// Curves by uPlot with every sample; it draws the least and the largest of each pixel column.
// Those of a group with one x axis show the same stretch of it and the instant of the group's clock.
const HEIGHTS = { panel: 150, lane: 40, beside: 76, row: 17, axis: 24 };
const stretches = {};
const stretchOf = (group, x) => (stretches[`${group} ${x}`] ??= { whole: [Infinity, -Infinity], shown: null, charts: [] });
const PRINTED = 440;
const TIME = "time (s)";
const inPrint = matchMedia("print");

// Beside a map on a wide screen all curves have one time axis above them.
const isBeside = (place) => place.closest(".beside") && matchMedia("(min-width: 75rem)").matches;

const openCurves = (places, { columns }) => {
  for (const place of places) {
    const { group, panels } = pageData.charts[place.dataset.chart];
    for (const panel of panels) {
      const { whole } = stretchOf(group, panel.x);
      panel.instants = columns[panel.marks];
      const ends = panel.series.flatMap(({ x }) => [columns[x][0], columns[x].at(-1)]).concat(panel.rows.length ? [...panel.instants] : []);
      for (const value of ends) Object.assign(whole, [Math.min(whole[0], value), Math.max(whole[1], value)]);
    }
  }
  for (const stretch of Object.values(stretches)) stretch.shown = [...stretch.whole];
  for (const column of document.querySelectorAll(".beside .curves")) if (isBeside(column)) openAxis(column);
  for (const column of new Set(places.map((place) => place.closest(".curves") ?? place))) nameRuns(column);
  // A chart is made when it comes near the screen, so that a page of thirty opens at once.
  const near = new IntersectionObserver((seen) => {
    for (const { isIntersecting, target } of seen) if (isIntersecting) target.open();
  }, { rootMargin: "400px" });
  for (const place of places) {
    const { group, panels } = pageData.charts[place.dataset.chart];
    for (const panel of panels) {
      const words = element("p", { class: "what" }, panel.what);
      if (panel.beyond) words.append(element("small", {}, ` ${panel.beyond} beyond`));
      const [head, plot] = [element("div", { class: "head" }, words), element("div", { class: "plot" })];
      place.append(element("div", { class: panel.lane ? "panel lane" : "panel" }, head, plot));
      if (panel.series.every(({ y }) => columns[y].filter(Number.isFinite).length < 2)) {
        const only = ({ label, y }) => `${label} ${short(columns[y].find(Number.isFinite) ?? NaN, 3)}`;
        plot.replaceWith(element("p", { class: "only" }, panel.series.map(only).join(", ")));
        continue;
      }
      const last = panel === panels.at(-1) || panel.x !== TIME;
      const hasAxis = () => last && (!isBeside(place) || inPrint.matches);
      const plain = panel.lane ? HEIGHTS.lane : place.closest(".beside") ? HEIGHTS.beside : HEIGHTS.panel;
      const rows = HEIGHTS.row * panel.rows.length + (panel.x === TIME ? 6 : HEIGHTS.axis);
      const height = (panel.rows.length ? rows : plain) + HEIGHTS.axis * hasAxis();
      plot.style.minHeight = `${height}px`;
      plot.open = () => {
        near.unobserve(plot);
        plot.open = () => {};
        openCurve({ plot, head, panel, group, height, hasAxis, stretch: stretchOf(group, panel.x) }, columns);
      };
      near.observe(plot);
    }
  }
  addEventListener("beforeprint", () => document.querySelectorAll(".plot").forEach((plot) => plot.open()));
  // On paper charts are not so wide, so that their numbers are as large as other text.
  for (const kind of ["beforeprint", "afterprint"]) addEventListener(kind, () => resizeAll(kind === "beforeprint"));
};

// A curve of several runs is called "run: curve": the runs stand once above all charts, in their colours.
const nameRuns = (column) => {
  const charts = column.dataset.chart ? [column] : [...column.querySelectorAll("[data-chart]")];
  const series = charts.flatMap(({ dataset }) => pageData.charts[dataset.chart].panels.flatMap(({ series }) => series));
  const runs = new Map(series.flatMap(({ label, color }) => (label.includes(": ") ? [[runOf(label), color]] : [])));
  if (runs.size) column.prepend(element("p", { class: "runs" }, ...[...runs].map(([run, color]) => element("span", {}, swatchOf("━", color), run))));
};
const resizeAll = (print) => {
  for (const chart of Object.values(stretches).flatMap(({ charts }) => charts)) chart.setSize({ width: print ? PRINTED : chart.root.parentNode.clientWidth, height: chart.height });
};
const runOf = (label) => label.slice(0, Math.max(label.lastIndexOf(": "), 0));

// The time axis of a column of curves, which stays in sight.
const openAxis = (column) => {
  const { group } = pageData.charts[column.querySelector("[data-chart]").dataset.chart];
  const stretch = stretchOf(group, TIME);
  const place = element("div", { class: "axis", "aria-hidden": "true" });
  column.prepend(place);
  const none = { show: false };
  const bare = { stroke: () => paint("soft"), grid: none, ticks: none, font: "12px system-ui, sans-serif" };
  const axes = [{ ...bare, side: 0, gap: 2, size: 18, values: seconds }, { ...bare, size: 48, values: () => [] }];
  const scales = { x: { time: false, range: () => stretch.shown }, y: { range: () => [0, 1] } };
  const chart = new uPlot({ width: column.clientWidth, height: 20, padding: [0, 8, 0, 0], legend: none, cursor: none, scales, axes, series: [{}, {}] }, [stretch.whole, [null, null]], place);
  stretch.charts.push(chart);
  onWidth(place, (width) => chart.setSize({ width, height: 20 }));
  redraws.push(() => chart.redraw(false, true));
};
// Without one that the right edge would cut.
const seconds = ({ scales: { x: { min, max } } }, values) => values.map((value) => (value === null || value > max - 0.015 * (max - min) ? "" : `${short(value)} s`));

// Columns over one x. NaN becomes null, a gap; where another series has a sample and this one has none is undefined.
const joined = (series, columns) => {
  const values = (column) => Array.from(columns[column], (value) => (Number.isNaN(value) ? null : value));
  const tables = series.map(({ x, y, upper }) => [Array.from(columns[x]), values(y), ...(upper === undefined ? [] : [values(upper)])]);
  return series.every(({ x }) => x === series[0].x) ? [tables[0][0], ...tables.flatMap(([, ...ys]) => ys)] : uPlot.join(tables);
};

// Points as small squares, one for each pixel.
const pointPaths = (hollow, across) => (chart, number, first, last) => {
  const [xs, ys] = [chart.data[0], chart.data[number]];
  const [path, size, known] = [new Path2D(), (xs.length < 50 ? 6 : across) * devicePixelRatio, new Set()];
  for (let at = first; at <= last; at++) {
    if (!Number.isFinite(ys[at])) continue;
    const [px, py] = [Math.round(chart.valToPos(xs[at], "x", true)), Math.round(chart.valToPos(ys[at], "y", true))];
    const key = px * 65536 + py;
    if (known.has(key)) continue;
    known.add(key);
    path.rect(px - size / 2, py - size / 2, size, size);
  }
  return hollow ? { stroke: path, fill: null, flags: 0 } : { stroke: null, fill: path, flags: 0 };
};

const optionsOf = ({ head, panel, group, height, hasAxis, stretch }) => {
  const axis = (size) => ({ stroke: () => paint("soft"), grid: { stroke: () => paint("grid"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif", gap: 4, size });
  const rows = panel.rows.length;
  const letters = 7 * Math.max(...panel.rows.map((name) => name.length)) + 8;
  const names = rows && { ...axis(panel.x === TIME ? 48 : Math.min(letters, 170)), splits: () => panel.rows.map((_, row) => row), values: () => panel.rows, stroke: () => paint("text") };
  const far = (low, high, log) => (log ? [low / 1.05, high * 1.05] : [low - 0.03 * (high - low), high + 0.03 * (high - low)]);
  const [logX, logY] = [rows ? panel.log : panel.log_x, !rows && panel.log];
  const below = () => (hasAxis() ? (panel.x === TIME ? 20 : 34) : 6);
  const numbers = (_, values) => values.map((value) => (value === null ? "" : short(value)));
  const fading = (color, share) => () => `color-mix(in srgb, ${paint(color)} ${share}%, transparent)`;
  const looks = {
    points: ({ color, variant }) => ({ fill: () => paint(color), width: variant ? 1 : 0, paths: pointPaths(variant > 0, !rows ? 2.5 : variant ? 5 : 9) }),
    band: () => ({ width: 0 }),
    line: ({ variant }) => ({ dash: rows ? [] : DASHES[variant % 4] }),
  };
  const look = (one) => ({ label: one.label, stroke: () => paint(one.color), width: rows ? 4 : 1.5, points: { show: false }, value: (_, value) => short(value, 3), single: one.style === "points", events: one.events, ...looks[one.style](one) });
  const [series, bands] = [[{ label: panel.x, class: "unseen", value: (_, value) => short(value) }], []];
  for (const one of panel.series) {
    series.push({ ...look(one), ...(one.style === "band" && panel.x === TIME && { class: "unseen" }) });
    if (one.style !== "band") continue;
    series.at(-1).value = (chart, low, number, at) => (at === null ? "–" : `${short(low, 3)} to ${short(chart.data[number + 1][at], 3)}`);
    series.push({ ...look(one), class: "unseen" });
    bands.push({ series: [series.length - 1, series.length - 2], fill: fading(one.color, 20) });
  }
  const marks = (chart) => {
    const pen = chart.ctx;
    Object.assign(pen, { strokeStyle: paint("soft"), lineWidth: devicePixelRatio });
    pen.setLineDash([2, 4]);
    pen.beginPath();
    for (const instant of panel.instants) {
      const px = chart.valToPos(instant, "x", true);
      if (px < chart.bbox.left || px > chart.bbox.left + chart.bbox.width) continue;
      pen.moveTo(px, chart.bbox.top);
      pen.lineTo(px, chart.bbox.top + chart.bbox.height);
    }
    pen.stroke();
    pen.setLineDash([]);
    if (panel.mark === "" || panel.instants.length === 0) return;
    Object.assign(pen, { fillStyle: paint("soft"), font: `${12 * devicePixelRatio}px system-ui, sans-serif`, textAlign: "left", textBaseline: "top" });
    pen.fillText(panel.mark, chart.valToPos(panel.instants[0], "x", true) + 4 * devicePixelRatio, chart.bbox.top);
  };
  const within = (_, low, high) => {
    const [from, to] = [panel.zero ? Math.min(0, low) : low, low === high && !(panel.zero && low > 0) ? high + (Math.abs(high) || 1) : high];
    return low === null ? [0, 1] : uPlot.rangeNum(from, to, 0.1, true);
  };
  return {
    height,
    series,
    bands,
    padding: [6, 8, 0, 0],
    scales: { x: { time: false, distr: logX ? 3 : 1, range: () => (panel.x === TIME ? stretch.shown : far(...stretch.shown, logX)) }, y: rows ? { dir: -1, range: () => [-0.6, rows - 0.4] } : logY ? { distr: 3, range: (_, low, high) => (low > 0 ? far(low, high, true) : [0.1, 1]) } : { range: panel.limits ? () => panel.limits : within } },
    axes: [{ ...axis(below), ...(logX && decades), values: (...all) => (hasAxis() ? (panel.x === TIME ? seconds : numbers)(...all) : []), ...(panel.x !== TIME && { label: panel.x, labelSize: 14, labelFont: "12px system-ui" }) }, names || { ...axis(48), ...(logY && decades), values: numbers, space: panel.lane ? 18 : 26 }],
    legend: { show: !rows && new Set(panel.series.map((one) => one.label)).size > (panel.x === TIME ? 0 : 1), markers: { width: 3, stroke: (_, number) => series[number].stroke(), fill: () => "transparent" }, mount: (_, legend) => head.append(legend) },
    cursor: {
      y: false,
      drag: { x: true, y: false, setScale: false, dist: 4 },
      points: { size: 6, width: 1 },
      sync: { key: `${group} ${panel.x}`, setSeries: false, scales: ["x", null] },
      bind: { dblclick: () => () => (showStretch(stretch, ...stretch.whole), null) },
      dataIdx: nearestSample,
    },
    hooks: {
      setCursor: [(chart) => chart.cursor.left < 0 && chart.head?.()], // the pointer has left: back to the clock's instant
      draw: [marks],
      ready: [() => nameSeries(head), (chart) => setTimeout(() => chart.head?.())],
      setSeries: [(chart, number) => head.querySelectorAll(".u-label button")[number]?.setAttribute("aria-pressed", String(chart.series[number].show))],
      setSelect: [
        (chart) => {
          const { left, width } = chart.select;
          if (width <= 0) return;
          chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          showStretch(stretch, chart.posToVal(left, "x"), chart.posToVal(left + width, "x"));
        },
      ],
    },
  };
};

// Readable ticks of a logarithmic axis: 1, 2, 3, 5 of each power of ten, and fewer where they are many.
const decades = {
  splits: (_, __, low, high) => {
    const [first, last] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
    const steps = last - first > 3 ? [1] : last - first > 1 ? [1, 3] : [1, 1.5, 2, 3, 5, 7];
    const ticks = Array.from({ length: last - first + 1 }, (_, at) => steps.map((step) => step * 10 ** (first + at))).flat();
    return ticks.filter((tick) => tick >= low && tick <= high);
  },
  filter: (_, ticks) => ticks,
};

// The names of a legend are buttons that show and hide their curves; the same curve of several runs is named once.
const nameSeries = (head) => {
  const known = new Set();
  for (const name of head.querySelectorAll(".u-label")) {
    const [run, curve] = [runOf(name.textContent), name.textContent.split(": ").at(-1)];
    const words = element("span", run && known.has(curve) ? { class: "unseen" } : {}, curve);
    name.replaceChildren(element("button", { type: "button", "aria-pressed": "true", title: name.textContent }, words));
    known.add(curve);
  }
};

// Each series is read off at its own nearest sample: others may have samples in between. Where it has none near there is
// no value: in and beside gaps, at single points farther than a gap, and of events at the instant of another sample.
const nearestSample = (chart, number, index, instant) => {
  const [xs, ys] = [chart.data[0], chart.data[number]];
  if (number === 0) return index;
  const { events, single } = chart.series[number];
  if (events && ys[index] === undefined) return null;
  let [before, after] = [index, index];
  while (before >= 0 && (ys[before] === undefined || xs[before] > instant)) before--;
  while (after < ys.length && (ys[after] === undefined || xs[after] < instant)) after++;
  const known = [before, after].filter((at) => Number.isFinite(ys[at]));
  const near = known.length > 1 && instant - xs[before] > xs[after] - instant ? after : known[0];
  const joined = known.length > 1 && !single;
  return near !== undefined && (joined || Math.abs(xs[near] - instant) <= pageData.gap_s) ? near : null;
};

const openCurve = (spec, columns) => {
  const { plot, panel, group, height, stretch } = spec;
  const chart = new uPlot({ width: plot.clientWidth, ...optionsOf(spec) }, joined(panel.series, columns), plot);
  stretch.charts.push(chart);
  plot.style.minHeight = "";
  if (panel.x === TIME) addHead(chart, clockOf(group), stretch);
  onWidth(plot, (width) => {
    chart.setSize({ width, height });
    chart.head?.();
  });
  redraws.push(() => chart.redraw(false, true));
};

// A line at the instant of the clock, with the values there: in a running player, in every twelfth frame, and not in
// the same one for all charts. A click sets the clock.
const TURNS = 12;
const addHead = (chart, clock, stretch) => {
  const head = element("div", { class: "playhead" });
  chart.over.append(head);
  let [seen, pressed] = [true, null];
  const own = stretch.charts.length % TURNS;
  chart.head = (turn) => {
    const there = clock.now !== null && clock.now >= stretch.shown[0] && clock.now <= stretch.shown[1];
    head.hidden = !there;
    if (!there || !seen) return;
    const left = chart.valToPos(clock.now, "x");
    head.style.transform = `translateX(${left}px)`;
    if (turn === undefined || turn % TURNS === own) chart.setCursor({ left, top: chart.over.clientHeight / 2 }, false, false);
  };
  new IntersectionObserver(([entry]) => {
    seen = entry.isIntersecting;
    chart.head();
  }).observe(chart.root);
  clock.listeners.push((_, turn) => chart.head(turn));
  chart.over.addEventListener("mousedown", (event) => (pressed = event.clientX));
  chart.over.addEventListener("wheel", (event) => {
    if (!event.ctrlKey) return;
    event.preventDefault();
    const [at, [first, until], factor] = [chart.posToVal(event.offsetX, "x"), stretch.shown, Math.exp(event.deltaY / 300)];
    showStretch(stretch, at - (at - first) * factor, at + (until - at) * factor);
  }, { passive: false });
  chart.over.addEventListener("click", (event) => {
    if (pressed !== event.clientX) return;
    clock.pause();
    clock.set(chart.posToVal(event.clientX - chart.over.getBoundingClientRect().left, "x"));
  });
};

const showStretch = (stretch, from, to) => {
  const [first, last] = stretch.whole;
  const width = Math.min(Math.max(to - from, 1e-5 * (last - first)), last - first);
  const start = Math.min(Math.max(from, first), last - width);
  stretch.shown = [start, start + width];
  for (const chart of stretch.charts) {
    chart.setScale("x", { min: start, max: start + width });
    chart.head?.();
  }
};
