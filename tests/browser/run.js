// The page of a run: what is in sight, and everything that can be done with map and curves.
answer(async () => {
  const say = { opened: now() };
  const [map, first] = [one(".map").getBoundingClientRect(), one(".of-map .u-over").getBoundingClientRect()];
  say.inSight = Math.max(map.bottom, first.bottom) <= innerHeight;
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

  const moment = all(".moments a").find((link) => link.dataset.shows?.includes("NLOS"));
  say.hidden = pixels("note");
  say.linked = [];
  for (let time = 0; time < 2; time++) {
    press("Home");
    moment.click();
    await wait(50);
    say.linked.push(now() - Number(moment.hash.slice(3)));
  }
  say.shown = pixels("note");
  const entry = (words) => all(".layers button").find(({ textContent }) => textContent.slice(1) === words);
  say.target = [pixels("target")];
  for (let time = 0; time < 2; time++) {
    entry("target").click();
    say.target.push(pixels("target"));
  }

  const canvas = one(".stage canvas");
  const read = (share) => (point(canvas, "pointermove", share), one(".tip").textContent.match(/-?[\d.]+(?=[, ])/g).slice(0, 2).map(Number));
  const before = [read([0.3, 0.3]), read([0.6, 0.6])];
  point(canvas, "wheel", [0.3, 0.3], { deltaY: -300 });
  const after = [read([0.3, 0.3]), read([0.6, 0.6])];
  say.zoom = { fixed: before[0].map((value, axis) => value - after[0][axis]), factor: (before[1][0] - before[0][0]) / (after[1][0] - after[0][0]) };
  press("0");
  say.all = read([0.3, 0.3]).map((value, axis) => value - before[0][axis]);

  const over = one("#tracking_error .u-over");
  for (const kind of ["mousedown", "mouseup", "click"]) point(over, kind, [0.25, 0.5]);
  say.clicked = now();
  const { charts } = stretchOf("run", "time (s)");
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

  const empty = {};
  const until = Number(one(".timeline input").max);
  for (let step = 0; step <= 10; step++) {
    clocks.run.set((until * step) / 10);
    for (const row of all(".beside .uplot .u-series:not(.unseen)")) {
      if (row.querySelector(".u-value").textContent === "–") empty[row.textContent] = (empty[row.textContent] ?? 0) + 1;
    }
  }
  say.empty = empty;
  return say;
});
