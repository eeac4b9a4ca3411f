"use strict";
for (const [name, { walks, anchors, around, walls, fixes, plans, errors }] of Object.entries(chartData).filter(([, chart]) => chart.walks)) {
  // Who walked where, from above: metres are as long across as up, whatever is shown.
  const MARGIN_M = 1;
  const REACH = 40; // pixels from a walk within which it is read off
  const PADDING = [8, 16]; // above and to the right of the plot
  const AXES = [52, 26]; // what the axes take of width and height
  const AROUND = [PADDING[1] + AXES[0], PADDING[0] + AXES[1]];
  const TALLEST = 620;
  const MARK = 5; // half a mark's size
  const FONT = "system-ui, sans-serif";
  const LABEL_PX = 12;
  const LABEL_LEFT = 1.8 * MARK; // from an anchor to its label
  const span = (values) =>
    values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
  const size = ([low, high]) => high - low;
  const middle = ([low, high]) => (low + high) / 2;

  // All that is to be seen at once: metres, and the pixels that a mark or a label takes before and after them.
  const marks = { before: MARK + 3, after: MARK + 3 };
  const ruler = document.createElement("canvas").getContext("2d");
  ruler.font = `${LABEL_PX}px ${FONT}`;
  const items = [...walks, ...around].map(({ x, y }) => ({
    x: { ends: span([x].flat()), ...marks },
    y: { ends: span([y].flat()), ...marks },
  }));
  for (const { label, x, y } of anchors) {
    const after = LABEL_LEFT + ruler.measureText(label).width + 3;
    items.push({ x: { ends: [x, x], ...marks, after }, y: { ends: [y, y], ...marks } });
  }
  const box = (key) => span(items.flatMap((item) => item[key].ends));
  const padded = ([low, high]) => ({ ends: [low - MARGIN_M, high + MARGIN_M], before: 0, after: 0 });
  items.push({ x: padded(box("x")), y: padded(box("y")) });
  for (const each of walls.filter(({ runs }) => runs.length)) {
    const { cell_m: cell, runs } = each;
    const every = (first, value) => runs.filter((_, at) => at % 3 === first).map(value);
    const [left, right] = [every(1, (start) => start), every(2, (long, at) => runs[3 * at + 1] + long)];
    const rows = every(0, (row) => row);
    const metres = (from, cells) => ({ ends: span(cells).map((at) => from + at * cell), before: 2, after: 2 });
    items.push({
      x: metres(each.x, [span(left)[0], span(right)[1]]),
      y: metres(each.y, [span(rows)[0], span(rows)[1] + 1]),
    });
  }
  const whole = { x: box("x"), y: box("y") };
  let view = whole;
  let wanted = null; // the box to be seen; null is all

  const [place, area] = openChart(name, "Arrows move the map, plus and minus zoom, 0 shows all.");
  const heightFor = (width) =>
    Math.min(TALLEST, Math.max(240, ((width - AROUND[0]) * size(whole.y)) / size(whole.x) + AROUND[1]));

  const set = (chart, centre, metre, pixels) => {
    const around = (value, count) => [value - (metre * count) / 2, value + (metre * count) / 2];
    view = { x: around(centre.x, pixels.x), y: around(centre.y, pixels.y) };
    chart.batch(() => {
      for (const key of ["x", "y"]) chart.setScale(key, { min: view[key][0], max: view[key][1] });
    });
  };
  // The chart's own box is still the old one after a new size has been asked for.
  const plotPixels = (chart) => ({ x: chart.width - AROUND[0], y: chart.height - AROUND[1] });
  // The smallest view that has the whole box in it, with equal metres both ways.
  const show = (chart, box) => {
    wanted = box;
    const pixels = plotPixels(chart);
    const metre = Math.max(size(box.x) / pixels.x, size(box.y) / pixels.y, 1e-6);
    set(chart, { x: middle(box.x), y: middle(box.y) }, metre, pixels);
  };
  // The smallest view that has every item in it, with its mark and label.
  const showAll = (chart) => {
    wanted = null;
    const pixels = plotPixels(chart);
    const least = (key) => {
      const places = items.map((item) => item[key]);
      const left = (first, last) => Math.max(pixels[key] - first.before - last.after, pixels[key] / 4);
      return places.flatMap((first) => places.map((last) => (last.ends[1] - first.ends[0]) / left(first, last)));
    };
    const metre = span([...least("x"), ...least("y")])[1];
    const centre = (key) =>
      middle(
        span(
          items.flatMap(({ [key]: { ends, before, after } }) => [ends[0] - before * metre, ends[1] + after * metre]),
        ),
      );
    set(chart, { x: centre("x"), y: centre("y") }, metre, pixels);
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
    ctx.fillStyle = painted("wall")();
    for (const { x: fromX, y: fromY, cell_m: cell, runs } of walls) {
      for (let at = 0; at < runs.length; at += 3) {
        const left = fromX + runs[at + 1] * cell;
        const bottom = fromY + runs[at] * cell;
        ctx.fillRect(x(left), y(bottom + cell), x(left + runs[at + 2] * cell) - x(left), y(bottom) - y(bottom + cell));
      }
    }
    if (fixes && !fixes.hidden) {
      ctx.fillStyle = painted("fix")();
      ctx.globalAlpha = 0.5;
      const dot = 2 * devicePixelRatio;
      fixes.x.forEach((value, at) => ctx.fillRect(x(value) - dot / 2, y(fixes.y[at]) - dot / 2, dot, dot));
      ctx.globalAlpha = 1;
    }
    // A line through points; classes: which colour each point's step to the next has, none for -1.
    const stroke = (line, color, only = null) => {
      ctx.strokeStyle = painted(color)();
      ctx.beginPath();
      let [down, before] = [false, false];
      line.x.forEach((value, at) => {
        const mine = value !== null && (only === null || line.classes[at] === only || before);
        before = only !== null && line.classes[at] === only;
        if (mine) ctx[down ? "lineTo" : "moveTo"](x(value), y(line.y[at]));
        down = mine;
      });
      ctx.stroke();
    };
    walks.forEach((walk, index) => {
      if (walk.hidden) return;
      ctx.lineWidth = (index === 0 ? 4 : walk.dashed ? 1 : 2) * devicePixelRatio; // later ones lie on the first
      ctx.lineJoin = "round";
      ctx.setLineDash(walk.dashed ? [5 * devicePixelRatio, 4 * devicePixelRatio] : []);
      stroke(walk, walk.color);
      if (walk.classes) errors.forEach((_, level) => stroke(walk, `error-${level}`, level));
      ctx.setLineDash([]);
      ctx.fillStyle = painted(walk.color)();
      if (walk.dashed) return;
      const last = walk.x.length - 1;
      const half = MARK * devicePixelRatio;
      ctx.beginPath();
      ctx.arc(x(walk.x[0]), y(walk.y[0]), half, 0, 2 * Math.PI);
      ctx.rect(x(walk.x[last]) - half, y(walk.y[last]) - half, 2 * half, 2 * half);
      ctx.fill();
    });
    if (plans.length && !plans.hidden) {
      ctx.lineWidth = devicePixelRatio;
      plans.forEach((plan) => stroke(plan, "plan"));
    }
    ctx.fillStyle = painted("text")();
    ctx.font = `${LABEL_PX * devicePixelRatio}px ${FONT}`;
    for (const anchor of anchors) {
      const [left, top, half] = [x(anchor.x), y(anchor.y), MARK * devicePixelRatio];
      ctx.beginPath();
      ctx.moveTo(left, top - half);
      ctx.lineTo(left + half, top + half);
      ctx.lineTo(left - half, top + half);
      ctx.fill();
      ctx.textAlign = "left";
      ctx.fillText(anchor.label, left + LABEL_LEFT * devicePixelRatio, top + half);
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
      axes: [axis(AXES[1]), axis(AXES[0])],
      padding: [...PADDING, 0, 0],
      legend: { show: false },
      cursor: {
        drag: { x: true, y: true, setScale: false, dist: 4 },
        points: { show: false },
        bind: {
          dblclick: (self) => () => {
            showAll(self);
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
    button.setAttribute("aria-pressed", String(!walk.hidden));
    button.addEventListener("click", () => {
      walk.hidden = !walk.hidden;
      button.setAttribute("aria-pressed", String(!walk.hidden));
      chart.redraw(false, false);
    });
    names.append(button);
  });
  const besides = [
    [fixes, "UWB fixes", "fix"],
    [plans.length ? plans : null, "some plans", "plan"],
  ];
  for (const [shown, label, color] of besides.filter(([shown]) => shown)) {
    const button = element("button", "", label);
    const swatch = element("span", "swatch");
    swatch.style.background = styled(color);
    button.prepend(swatch);
    button.type = "button";
    button.setAttribute("aria-pressed", "true");
    button.addEventListener("click", () => {
      shown.hidden = !shown.hidden;
      button.setAttribute("aria-pressed", String(!shown.hidden));
      chart.redraw(false, false);
    });
    names.append(button);
  }
  if (errors.length) {
    const key = element("p", "what", "Robot, distance to the reference: ");
    errors.forEach((label, level) => {
      const swatch = element("span", "swatch");
      swatch.style.background = styled(`error-${level}`);
      key.append(swatch, `${label} \u2002`);
    });
    area.prepend(key);
  }
  area.prepend(names);
  area.append(told);
  instants.push((instant) => {
    walks.forEach(({ seconds }, index) => putDot(chart, index, instant === null ? null : indexAt(seconds, instant)));
  });
  addBar(place, [
    ["+", "zoom in", ["+", "="], () => zoom(chart, 0.5)],
    ["\u2212", "zoom out", ["-", "_"], () => zoom(chart, 2)],
    ["all", "show all", ["0"], () => showAll(chart)],
    ["", "", ["ArrowLeft"], () => pan(chart, "x", -0.2)],
    ["", "", ["ArrowRight"], () => pan(chart, "x", 0.2)],
    ["", "", ["ArrowUp"], () => pan(chart, "y", 0.2)],
    ["", "", ["ArrowDown"], () => pan(chart, "y", -0.2)],
  ]);
  showAll(chart);
  readOff(chart);
  onWidth(area, (width) => {
    chart.setSize({ width, height: heightFor(width) });
    if (wanted) show(chart, wanted);
    else showAll(chart);
  });
  redraws.push(() => chart.redraw(false, true));
}
