// The page of a run: what is in sight, and everything that can be done with map and curves.
answer(async () => {
  const say = { opened: now() };
  const [map, first] = [one(".map").getBoundingClientRect(), one(".of-map .u-over").getBoundingClientRect()];
  say.inSight = Math.max(map.bottom, first.bottom) <= innerHeight;
  const [curves, stage] = [one(".curves").getBoundingClientRect(), one(".stage").getBoundingClientRect()];
  say.plots = all(".of-map .u-over").filter((plot) => plot.getBoundingClientRect().bottom <= Math.min(curves.bottom, innerHeight)).length;
  const { extent, layers } = pageData.scenes.trajectory;
  const { columns } = await unpack();
  const [wide, high] = ["x", "y"].map((axis) => {
    const places = layers.filter(({ kind }) => kind === "track").flatMap((track) => [...columns[track[axis]]].filter(Number.isFinite));
    return Math.max(...places) - Math.min(...places);
  });
  const scale = Math.min(stage.width / (extent[1] - extent[0]), stage.height / (extent[3] - extent[2]));
  say.first = [stage.height, (wide * high * scale ** 2) / (stage.width * stage.height)];
  say.lines = all(".verdict.well, .cards").map((part) => part.getBoundingClientRect().height);
  say.share = map.width / one(".beside").clientWidth;
  say.sideways = document.documentElement.scrollWidth - innerWidth;
  say.parts = [one(".timeline input").type, one(".play").getAttribute("aria-label"), all(".beside .uplot").length > 10];

  say.keys = [["Home"], ["ArrowRight"], ["ArrowRight", { shiftKey: true }], ["ArrowLeft"], ["End"]].map(([key, more]) => (press(key, document.body, more), now()));
  press("Home", one(".timeline input"));
  press("ArrowRight", one(".timeline input"));
  say.slider = [now(), Number(one(".timeline input").value)];
  press("Home");
  press(" ");
  say.playing = one(".play").getAttribute("aria-label");
  frames(31);
  say.played = now();
  press("+");
  frames(15);
  say.faster = now() - say.played;
  for (let times = 0; times < 3; times++) press("+");
  frames(10);
  say.end = [now(), one(".play").getAttribute("aria-label")];

  const moment = all(".moments a").find(({ textContent }) => textContent.startsWith("worst error of tag 1"));
  say.hidden = pixels("note");
  say.linked = [];
  for (let time = 0; time < 2; time++) {
    press("Home");
    moment.click();
    await wait(50);
    say.linked.push(now() - Number(moment.hash.slice(3)));
  }
  say.shown = pixels("note");
  say.claim = [one(".claim").textContent, pixels("bad") > 0];
  press("[");
  say.next = [now() < Number(moment.hash.slice(3)), one(".claim").hidden];
  press("]");
  say.before = now() - Number(moment.hash.slice(3));
  await wait(600);
  say.address = location.hash;
  press("0");
  const entry = (words) => all(".layers button").find(({ textContent }) => textContent.slice(1) === words);
  say.target = [pixels("target")];
  for (let time = 0; time < 2; time++) {
    entry("target").click();
    say.target.push(pixels("target"));
  }

  const canvas = one(".stage canvas");
  const read = (share) => (point(canvas, "pointermove", share), one(".tip:not(.claim)").textContent.match(/-?[\d.]+(?=[, ])/g).slice(0, 2).map(Number));
  const before = [read([0.3, 0.3]), read([0.6, 0.6])];
  point(canvas, "wheel", [0.3, 0.3], { deltaY: -300 });
  const after = [read([0.3, 0.3]), read([0.6, 0.6])];
  say.zoom = { fixed: before[0].map((value, axis) => value - after[0][axis]), factor: (before[1][0] - before[0][0]) / (after[1][0] - after[0][0]) };
  await wait(600);
  say.zoomed = location.hash;
  press("0");
  say.all = read([0.3, 0.3]).map((value, axis) => value - before[0][axis]);

  const over = one("#tracking_error .u-over");
  for (const kind of ["mousedown", "mouseup", "click"]) point(over, kind, [0.25, 0.5]);
  say.clicked = now();
  const { charts } = stretchOf("run", "time (s)");
  const stretch = [...stretchOf("run", "time (s)").shown];
  point(over, "wheel", [0.5, 0.5], { deltaY: -300, ctrlKey: true });
  say.wheel = (stretch[1] - stretch[0]) / (stretchOf("run", "time (s)").shown[1] - stretchOf("run", "time (s)").shown[0]);
  point(over, "dblclick");
  const name = one("#tracking_error .u-series:not(.unseen) button");
  say.pressed = [0, 1].map(() => (name.click(), name.getAttribute("aria-pressed")));
  const error = charts.find(({ series }) => series.some(({ label }) => label === "cross-track"));
  const column = error.series.findIndex(({ label }) => label === "cross-track");
  say.samples = error.data[column].filter(Number.isFinite).length;
  const height = () => error.scales.y.min;
  const whole = height();
  showStretch(stretchOf("run", "time (s)"), 0, 0.1);
  await wait(50);
  say.fits = height() / whole;
  point(one("#cross_track .u-over"), "dblclick");
  await wait(50);
  say.whole = height() / whole;

  redraws.forEach((redraw) => redraw()); // as for print, or in the dark
  say.redrawn = redraws.length;

  // Everything that stands beside a legend, at instants between samples.
  say.read = [];
  const until = Number(one(".timeline input").max);
  for (let step = 0; step < 40; step++) {
    const instant = Math.round(1000 * until * ((step * 0.61803) % 1)) / 1000;
    clocks.run.set(instant);
    for (const panel of all(".of-map .panel")) {
      for (const row of panel.querySelectorAll(".u-series:not(.unseen)")) {
        say.read.push([instant, panel.querySelector(".what").firstChild.textContent, ...[".u-label", ".u-value"].map((part) => row.querySelector(part).textContent)]);
      }
    }
  }
  return say;
});
