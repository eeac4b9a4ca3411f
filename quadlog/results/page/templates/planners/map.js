"use strict";
// The maps of a comparison: all planners' paths for one question, and a slider over the questions.
// Blocks are unpacked by player_scene.js; numbers of questions take the place of its seconds.
const openPlannerMap = async (place, data) => {
  const DASH = 9; // pixels of each colour of a line that planners share
  const LANE = 3; // pixels between lines of different paths
  const EVERY = 120; // milliseconds from question to question while it plays
  const CALM_EVERY = 600; // the same for readers who want less motion
  const US = 10; // packed times are in tenths, costs in hundredths
  const COST = 100;
  const group = place.dataset.map;
  const [columns] = await unpack(data.answers);
  const [number, episode, replan, last] = ["number", "episode", "replan", "last"].map((name) => columns[data[name]]);
  const routes = data.routes.map((route) =>
    Object.fromEntries(Object.entries(route).map(([name, at]) => [name, columns[at]])),
  );
  const grown = data.grown && (await openScene(data.grown));
  const scene = await openScene(data);
  const { cell } = data.windows[0];
  const edge = data.edge; // of a cell of the lattice, which may be finer than those of the map
  const [goal, start] = data.tracks;
  const hidden = new Set();
  let now = 0;

  const part = (name) => place.querySelector(`[data-part="${name}"]`);
  const [stage, canvas, slider, play, clock] = ["stage", "canvas", "slider", "play", "clock"].map(part);
  const rows = [...place.querySelectorAll("[data-planner]")];

  const points = ({ first, x, y }) => {
    const found = [];
    for (let at = first[now]; at < first[now + 1]; at++) found.push([(x[at] + 0.5) * edge, (y[at] + 0.5) * edge]);
    return found;
  };
  const same = (a, b) => a.length === b.length && a.every(([x, y], at) => x === b[at][0] && y === b[at][1]);
  // Planners whose paths are the same, together: [path, numbers of the planners].
  const lanes = () => {
    const found = [];
    routes.forEach((route, planner) => {
      const path = hidden.has(planner) ? [] : points(route);
      const known = found.find(([other]) => same(other, path));
      if (known) known[1].push(planner);
      else if (path.length) found.push([path, [planner]]);
    });
    return found;
  };

  let growth = null;
  const under = ({ layer, tint, cells, pen }, at) => {
    if (!grown) return;
    const [windows] = data.grown.windows;
    const { columns: wide, rows: high, column, row, x, y } = windows;
    growth ??= { picture: layer(wide, high), at: -1 };
    const brush = growth.picture.getContext("2d");
    growth.image ??= brush.createImageData(wide, high);
    if (growth.at !== at) {
      grown.paint(windows, at, growth.image);
      brush.putImageData(growth.image, 0, 0);
      tint(growth.picture, painted("wall")());
      growth.at = at;
    }
    pen.globalAlpha = 0.45;
    cells(growth.picture, x + column[at] * cell, y + row[at] * cell, cell);
    pen.globalAlpha = 1;
  };
  const over = ({ pen, x, y, line }) => {
    if (!data.alone) {
      const walked = [];
      for (let at = now; at >= 0 && episode[at] === episode[now]; at--) walked.push([start.x[at] / 1000, start.y[at] / 1000]);
      pen.globalAlpha = 0.35;
      line(walked, painted("soft")(), 1.5);
      pen.globalAlpha = 1;
    }
    const along = [x(goal.x[now] / 1000) - x(start.x[now] / 1000), y(goal.y[now] / 1000) - y(start.y[now] / 1000)];
    const far = Math.hypot(...along) || 1;
    const found = lanes();
    found.forEach(([path, planners], lane) => {
      const aside = (lane - (found.length - 1) / 2) * LANE;
      pen.save();
      pen.translate((-along[1] / far) * aside, (along[0] / far) * aside);
      planners.forEach((planner, at) => {
        const { color, dashed } = data.planners[planner];
        const others = planners.length - 1;
        pen.lineDashOffset = -at * DASH;
        line(path, painted(color)(), 2.5, others ? [DASH, DASH * others] : dashed ? [6, 4] : []);
      });
      pen.restore();
    });
  };

  const view = openView(data, scene, canvas, { under, over });
  const heightFor = (width) => Math.round(Math.min(520, Math.max(280, 0.75 * width)));
  const value = (amount, unit = 1) => (amount < 0 ? "–" : shortNumber(amount / unit));
  const show = () => {
    view.draw(number[now]);
    slider.value = now;
    clock.textContent = data.alone
      ? `query ${number[now]} of ${data.questions}`
      : `replan ${replan[now]} of ${last[now]}${data.episodes > 1 ? `, episode ${episode[now]} of ${data.episodes}` : ""}`;
    slider.setAttribute("aria-valuetext", clock.textContent);
    place.dataset.at = now;
    part("follow").setAttribute("aria-pressed", String(view.follows()));
    rows.forEach((row, planner) => {
      const { found, cells, us, cost } = routes[planner];
      const texts = [value(cells[now]), value(us[now], US), value(cost[now], COST), found[now] ? "found" : "no path"];
      texts.forEach((text, at) => (row.cells[at + 1].textContent = text));
    });
    for (const move of playheads) move(number[now], true, group);
  };
  // Around the start: as much as the question takes, or of a walk, where that changes, as questions mostly take.
  const lengths = Array.from(number, (_, at) => Math.hypot(goal.x[at] - start.x[at], goal.y[at] - start.y[at]) / 1000);
  const usual = lengths.toSorted((a, b) => a - b)[lengths.length >> 1];
  const across = () =>
    data.alone ? Math.max(3 * lengths[now], 12 * edge) : 1.15 * Math.min(data.across, Math.max(3 * usual, 40 * edge));
  const seek = (at) => {
    now = Math.min(Math.max(at, 0), number.length - 1);
    if (view.follows() && data.alone) view.near(across());
    show();
  };
  let before = null;
  const frame = (time) => {
    if (before === null) return;
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (time - before >= (calm ? CALM_EVERY : EVERY)) {
      before = time;
      seek(now + 1);
      if (now === number.length - 1) return setPlaying(false);
    }
    requestAnimationFrame(frame);
  };
  const setPlaying = (wanted) => {
    if (wanted && now === number.length - 1) seek(0);
    before = wanted ? performance.now() : null;
    play.textContent = wanted ? "\u275a\u275a" : "\u25b6";
    play.setAttribute("aria-label", wanted ? "pause" : "play");
    if (wanted) requestAnimationFrame(frame);
  };
  const changed = (act) => () => {
    act();
    show();
  };
  const whole = changed(view.whole);
  const follow = changed(() => (view.follows() ? view.whole() : view.near(across())));
  const nearer = changed(() => view.zoom(1.5));
  const farther = changed(() => view.zoom(1 / 1.5));

  place.hidden = false;
  place.closest("figure").classList.add("charted");
  Object.entries({ whole, follow, nearer, farther, play: () => setPlaying(before === null) }).forEach(([name, act]) =>
    part(name).addEventListener("click", act),
  );
  slider.addEventListener("input", () => {
    setPlaying(false);
    seek(Number(slider.value));
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    view.pan(event.movementX, event.movementY);
    show();
  });
  rows.forEach((row, planner) => {
    const button = row.querySelector("button");
    button.addEventListener("click", () => {
      if (!hidden.delete(planner)) hidden.add(planner);
      button.setAttribute("aria-pressed", String(!hidden.has(planner)));
      show();
    });
  });
  // A chart's question, or the last one before it that is shown.
  seekers.push((wanted, of) => {
    if (of !== group) return;
    setPlaying(false);
    seek(number.filter((each) => each <= Math.round(wanted)).length - 1);
  });
  const keys = {
    " ": () => setPlaying(before === null),
    ArrowLeft: (big) => seek(now - (big ? 10 : 1)),
    ArrowRight: (big) => seek(now + (big ? 10 : 1)),
    Home: () => seek(0),
    End: () => seek(number.length - 1),
    "+": nearer,
    "=": nearer,
    "-": farther,
    f: follow,
    0: whole,
  };
  place.addEventListener("keydown", (event) => {
    const act = keys[event.key];
    const own = event.target.closest("button") && event.key === " ";
    if (!act || own || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    if (event.key !== " ") setPlaying(false);
    act(event.shiftKey);
  });

  const fit = (width) => {
    view.resize(width, heightFor(width));
    show();
  };
  view.resize(stage.clientWidth, heightFor(stage.clientWidth));
  view.whole();
  if (!data.alone) view.near(across());
  seek(0);
  onWidth(stage, fit);
  redraws.push(() => {
    view.recolor();
    if (growth) growth.at = -1;
    show();
  });
};
if (typeof DecompressionStream !== "undefined") {
  const maps = JSON.parse(document.getElementById("map-data").textContent);
  for (const place of document.querySelectorAll("[data-map]")) openPlannerMap(place, maps[place.dataset.map]);
}
