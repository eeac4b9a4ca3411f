"use strict";
for (const [name, { walks, anchors, around, walls }] of Object.entries(chartData).filter(([, chart]) => chart.walks)) {
  // Who walked where, from above: metres are as long across as up, whatever is shown.
  const MARGIN_M = 1;
  const REACH = 40; // pixels from a walk within which it is read off
  const AXES = [60, 34]; // what the axes take of width and height, nearly
  const TALLEST = 620;
  const limits = (key) => {
    const values = [...walks, ...anchors, ...around].flatMap((each) => each[key]);
    return values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
  };
  const padded = ([low, high]) => [low - MARGIN_M, high + MARGIN_M];
  const whole = { x: padded(limits("x")), y: padded(limits("y")) };
  const size = ([low, high]) => high - low;
  const middle = ([low, high]) => (low + high) / 2;
  let view = whole;

  const [place, area] = openChart(name, "Arrows move the map, plus and minus zoom, 0 shows all.");
  const heightFor = (width) =>
    Math.min(TALLEST, Math.max(240, ((width - AXES[0]) * size(whole.y)) / size(whole.x) + AXES[1]));

  // The smallest view that has the whole box in it, with equal metres both ways.
  const show = (chart, box) => {
    const { width, height } = chart.bbox;
    const metre = Math.max(size(box.x) / width, size(box.y) / height, 1e-6);
    const around = (range, pixels) => [middle(range) - (metre * pixels) / 2, middle(range) + (metre * pixels) / 2];
    view = { x: around(box.x, width), y: around(box.y, height) };
    chart.batch(() => {
      for (const key of ["x", "y"]) chart.setScale(key, { min: view[key][0], max: view[key][1] });
    });
  };
  const scaled = (range, factor) => [
    middle(range) - (factor * size(range)) / 2,
    middle(range) + (factor * size(range)) / 2,
  ];
  const zoom = (chart, factor) => show(chart, { x: scaled(view.x, factor), y: scaled(view.y, factor) });
  const pan = (chart, key, share) => {
    const step = share * size(view[key]);
    show(chart, { ...view, [key]: view[key].map((value) => value + step) });
  };

  const draw = (chart) => {
    const { ctx, bbox } = chart;
    const x = (value) => chart.valToPos(value, "x", true);
    const y = (value) => chart.valToPos(value, "y", true);
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    if (walls) {
      ctx.fillStyle = painted("wall")();
      const { cell_m: cell, runs } = walls;
      for (let at = 0; at < runs.length; at += 3) {
        const left = walls.x + runs[at + 1] * cell;
        const bottom = walls.y + runs[at] * cell;
        ctx.fillRect(x(left), y(bottom + cell), x(left + runs[at + 2] * cell) - x(left), y(bottom) - y(bottom + cell));
      }
    }
    walks.forEach((walk, index) => {
      if (walk.hidden) return;
      ctx.strokeStyle = painted(walk.color)();
      ctx.lineWidth = (index === 0 ? 4 : 2) * devicePixelRatio; // later ones lie on the first
      ctx.lineJoin = "round";
      ctx.beginPath();
      walk.x.forEach((value, at) => ctx[at ? "lineTo" : "moveTo"](x(value), y(walk.y[at])));
      ctx.stroke();
      const last = walk.x.length - 1;
      const half = 5 * devicePixelRatio;
      ctx.fillStyle = ctx.strokeStyle;
      ctx.beginPath();
      ctx.arc(x(walk.x[0]), y(walk.y[0]), half, 0, 2 * Math.PI);
      ctx.rect(x(walk.x[last]) - half, y(walk.y[last]) - half, 2 * half, 2 * half);
      ctx.fill();
    });
    ctx.fillStyle = painted("text")();
    ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
    for (const anchor of anchors) {
      const [left, top, half] = [x(anchor.x), y(anchor.y), 5 * devicePixelRatio];
      ctx.beginPath();
      ctx.moveTo(left, top - half);
      ctx.lineTo(left + half, top + half);
      ctx.lineTo(left - half, top + half);
      ctx.fill();
      ctx.textAlign = "left";
      ctx.fillText(anchor.label, left + 1.8 * half, top + half);
    }
    ctx.restore();
  };

  const names = element("p", "names");
  const told = element("p", "what", "");
  const dots = [];
  const putDot = (chart, index, at) => {
    const there = at !== null && !walks[index].hidden;
    dots[index].hidden = !there;
    if (!there) return;
    const [left, top] = [chart.valToPos(walks[index].x[at], "x"), chart.valToPos(walks[index].y[at], "y")];
    dots[index].style.transform = `translate(${left}px, ${top}px)`;
  };
  // The last point that is not later.
  const indexAt = (seconds, instant) => {
    let [low, high] = [0, seconds.length - 1];
    while (low < high) {
      const half = Math.ceil((low + high) / 2);
      if (seconds[half] <= instant) low = half;
      else high = half - 1;
    }
    return low;
  };
  const readOff = (chart) => {
    const { left, top } = chart.cursor;
    let best = { distance: REACH };
    walks.forEach((walk, index) => {
      if (left < 0 || walk.hidden) return;
      walk.x.forEach((value, at) => {
        const distance = Math.hypot(chart.valToPos(value, "x") - left, chart.valToPos(walk.y[at], "y") - top);
        if (distance < best.distance) best = { distance, walk, index, at };
      });
    });
    walks.forEach((_, index) => putDot(chart, index, index === best.index ? best.at : null));
    const { walk, at } = best;
    told.textContent = walk
      ? `${walk.label}: x ${shortNumber(walk.x[at])} m, y ${shortNumber(walk.y[at])} m, t ${shortNumber(walk.seconds[at])} s`
      : "Point at a walk to read it off.";
  };

  const chart = new uPlot(
    {
      width: area.clientWidth,
      height: heightFor(area.clientWidth),
      scales: { x: { time: false, range: () => view.x }, y: { range: () => view.y } },
      series: [{}, { paths: () => null, points: { show: false } }],
      axes: [axis(26), axis(52)],
      legend: { show: false },
      cursor: {
        drag: { x: true, y: true, setScale: false, dist: 4 },
        points: { show: false },
        bind: {
          dblclick: (self) => () => {
            show(self, whole);
            return null;
          },
        },
      },
      hooks: {
        draw: [draw],
        setCursor: [readOff],
        setSelect: [
          (self) => {
            const { left, top, width, height } = self.select;
            if (width <= 0 || height <= 0) return;
            self.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
            show(self, {
              x: [self.posToVal(left, "x"), self.posToVal(left + width, "x")],
              y: [self.posToVal(top + height, "y"), self.posToVal(top, "y")],
            });
          },
        ],
      },
    },
    [whole.x, whole.y],
    area,
  );
  walks.forEach((walk, index) => {
    dots[index] = element("div", "dot");
    dots[index].style.background = styled(walk.color);
    dots[index].hidden = true;
    chart.over.append(dots[index]);
    const button = element("button", "", walk.label);
    const swatch = element("span", "swatch");
    swatch.style.background = styled(walk.color);
    button.prepend(swatch);
    button.type = "button";
    button.setAttribute("aria-pressed", "true");
    button.addEventListener("click", () => {
      walk.hidden = !walk.hidden;
      button.setAttribute("aria-pressed", String(!walk.hidden));
      chart.redraw(false, false);
    });
    names.append(button);
  });
  area.prepend(names);
  area.append(told);
  instants.push((instant) => {
    walks.forEach(({ seconds }, index) => putDot(chart, index, instant === null ? null : indexAt(seconds, instant)));
  });
  addBar(place, [
    ["+", "zoom in", ["+", "="], () => zoom(chart, 0.5)],
    ["\u2212", "zoom out", ["-", "_"], () => zoom(chart, 2)],
    ["all", "show all", ["0"], () => show(chart, whole)],
    ["", "", ["ArrowLeft"], () => pan(chart, "x", -0.2)],
    ["", "", ["ArrowRight"], () => pan(chart, "x", 0.2)],
    ["", "", ["ArrowUp"], () => pan(chart, "y", 0.2)],
    ["", "", ["ArrowDown"], () => pan(chart, "y", -0.2)],
  ]);
  show(chart, whole);
  readOff(chart);
  onWidth(area, (width) => {
    chart.setSize({ width, height: heightFor(width) });
    show(chart, view);
  });
  redraws.push(() => chart.redraw(false, true));
}
