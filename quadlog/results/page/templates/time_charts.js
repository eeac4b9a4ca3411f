"use strict";
// Charts over time. All of a group show the same stretch of the run, and the same instant under the cursor.
const openTimeCharts = (group, timed) => {
  const HEIGHT = 190;
  const NARROWEST = 1e-4; // of the run
  const panels = timed.flatMap(([, chart]) => chart.panels);
  const whole = [
    Math.min(...panels.map((panel) => panel.seconds[0])),
    Math.max(...panels.map((panel) => panel.seconds[panel.seconds.length - 1])),
  ];
  if (whole[0] === whole[1]) whole[1] += 1;
  const charts = [];
  let shown = whole;

  // Where the player is: a line in every chart, and, in those that are in sight, the cursor with its values.
  const heads = new Map();
  const inSight = new Set(); // of charts: until the browser says that they are not
  let played = null;
  const placeHead = (chart) => {
    if (played === null) return;
    const head = heads.get(chart);
    head.hidden = played < shown[0] || played > shown[1];
    if (!head.hidden && inSight.has(chart)) head.style.transform = `translateX(${chart.valToPos(played, "x")}px)`;
  };
  const placeHeads = () => [...heads.keys()].forEach(placeHead);
  const readOff = (chart) => {
    if (played === null || heads.get(chart).hidden) return;
    chart.setCursor({ left: chart.valToPos(played, "x"), top: chart.bbox.height / devicePixelRatio / 2 }, false, false);
  };
  const comesIntoSight = new IntersectionObserver((entries) => {
    const charted = new Map([...heads.keys()].map((chart) => [chart.root, chart]));
    for (const { target, isIntersecting } of entries) {
      const chart = charted.get(target);
      inSight[isIntersecting ? "add" : "delete"](chart);
      if (!isIntersecting) continue;
      placeHead(chart);
      readOff(chart);
    }
  });
  playheads.push((seconds, numbers, of) => {
    if (of !== group) return;
    played = seconds;
    placeHeads();
    if (numbers) inSight.forEach(readOff);
  });
  const addHead = (chart) => {
    const head = element("div", "playhead");
    head.hidden = true;
    chart.over.append(head);
    heads.set(chart, head);
    inSight.add(chart);
    comesIntoSight.observe(chart.root);
    let pressed = null;
    chart.over.addEventListener("mousedown", (event) => (pressed = event.clientX));
    chart.over.addEventListener("click", (event) => {
      const left = event.clientX - chart.over.getBoundingClientRect().left;
      if (pressed === event.clientX) for (const seek of seekers) seek(chart.posToVal(left, "x"), group);
    });
  };

  const show = (from, to) => {
    const width = Math.min(Math.max(to - from, NARROWEST * (whole[1] - whole[0])), whole[1] - whole[0]);
    const first = Math.min(Math.max(from, whole[0]), whole[1] - width);
    shown = [first, first + width];
    for (const chart of charts) chart.setScale("x", { min: shown[0], max: shown[1] });
    placeHeads();
  };
  const zoom = (factor) => {
    const middle = (shown[0] + shown[1]) / 2;
    const half = (factor * (shown[1] - shown[0])) / 2;
    show(middle - half, middle + half);
  };
  const pan = (share) => {
    const step = share * (shown[1] - shown[0]);
    show(shown[0] + step, shown[1] + step);
  };
  const showAll = () => show(...whole);

  const line = ({ label, color, points, dashed }, joined) => ({
    label,
    dash: dashed ? [6, 4] : undefined,
    stroke: painted(color),
    width: points ? 0 : 1.5,
    paths: points ? () => null : undefined,
    points: points ? { show: true, size: 3, width: 0, fill: painted(color), stroke: painted(color) } : { show: false },
    spanGaps: joined,
    value: (_, value) => shortNumber(value),
  });

  // Of values that span decades: from 0 where there is one, which no logarithm has.
  const wide = { positive: { distr: 3 }, zero: { distr: 4, asinh: 1, range: (_, low, high) => [0, 1.5 * high] } };
  const isPower = (value) => value === 0 || Math.log10(value) % 1 === 0;
  const upright = (log, size) => {
    const made = axis(size);
    if (log !== "zero") return made;
    const filter = (_, splits) => splits.map((each) => (isPower(each) ? each : null)); // uPlot has -1 below 0
    return { ...made, filter, grid: { ...made.grid, filter } };
  };
  const options = (panel, width, over) => ({
    width,
    height: HEIGHT,
    scales: { x: { time: false, range: () => shown }, y: wide[panel.log] ?? {} },
    series: [
      { label: over, value: (_, value) => shortNumber(value) },
      ...panel.lines.map((each) => line(each, panel.joined)),
    ],
    axes: [axis(26), upright(panel.log, over === "t (s)" ? 52 : 64)],
    legend: {
      markers: { width: 3, stroke: (_, at) => styled(panel.lines[at - 1].color), fill: () => "transparent" },
    },
    cursor: {
      y: false,
      drag: { x: true, y: false, setScale: false, dist: 4 },
      points: { fill: (_, at) => styled(panel.lines[at - 1].color), stroke: () => styled("back"), size: 8, width: 1 },
      sync: {
        key: `time ${group}`,
        setSeries: false,
        scales: ["x", null],
        filters: { pub: (kind) => kind === "mousemove" || kind === "mouseleave" },
      },
      bind: {
        dblclick: () => () => {
          showAll();
          return null;
        },
      },
    },
    hooks: {
      setSelect: [
        (chart) => {
          const { left, width: wide } = chart.select;
          if (wide <= 0) return;
          chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          show(chart.posToVal(left, "x"), chart.posToVal(left + wide, "x"));
        },
      ],
      setCursor: [
        (chart) => {
          const seconds = chart.cursor.left >= 0 ? chart.posToVal(chart.cursor.left, "x") : null;
          for (const tell of instants) tell(seconds);
        },
      ],
    },
  });

  // The cursor by keys: to the next point of the first panel, which the others follow; said aloud as text.
  const stepper = (mine, said, over) => (steps) => {
    const [first] = mine;
    const seconds = first.data[0];
    const inside = (at) => seconds[at] >= shown[0] && seconds[at] <= shown[1];
    const from = first.cursor.idx ?? seconds.findIndex((_, at) => inside(at));
    const to = Math.min(Math.max(from + steps, 0), seconds.length - 1);
    if (!inside(to)) return;
    for (const chart of mine) {
      chart.setCursor({ left: chart.valToPos(seconds[to], "x"), top: chart.bbox.height / devicePixelRatio / 2 });
    }
    const values = mine.flatMap((chart) =>
      chart.series.slice(1).map((each, at) => {
        const index = chart.cursor.idxs[at + 1];
        return `${each.label} ${shortNumber(index === null ? null : chart.data[at + 1][index])}`;
      }),
    );
    const at = shortNumber(seconds[to]);
    said.textContent = `${over ? `${over} ${at}` : `${at} s`}: ${values.join(", ")}`;
  };

  for (const [name, { panels: own, axis: over }] of timed) {
    const help = "Left and right arrow move the cursor, plus and minus zoom, page up and page down move on, 0 shows all.";
    const [place, area] = openChart(name, help);
    const mine = own.map((panel) => {
      area.append(element("p", "what", panel.what));
      const chart = new uPlot(options(panel, area.clientWidth, over ?? "t (s)"), [panel.seconds, ...panel.values], area);
      charts.push(chart);
      addHead(chart);
      return chart;
    });
    const said = element("output", "unseen");
    place.append(said);
    const step = stepper(mine, said, over);
    addBar(place, [
      ["+", "zoom in", ["+", "="], () => zoom(0.5)],
      ["\u2212", "zoom out", ["-", "_"], () => zoom(2)],
      ["\u2190", "earlier", ["PageUp"], () => pan(-0.5)],
      ["\u2192", "later", ["PageDown"], () => pan(0.5)],
      ["all", "show all", ["0"], showAll],
      ["", "", ["ArrowLeft"], () => step(-1)],
      ["", "", ["ArrowRight"], () => step(1)],
    ]);
    onWidth(area, (width) => {
      mine.forEach((chart) => chart.setSize({ width, height: HEIGHT }));
      placeHeads();
    });
  }
  redraws.push(() => charts.forEach((chart) => chart.redraw(false, true)));
};
{
  const timed = Object.entries(chartData).filter(([, chart]) => chart.panels);
  for (const group of new Set(timed.map(([, chart]) => chart.group))) {
    openTimeCharts(group, timed.filter(([, chart]) => chart.group === group));
  }
}
