"use strict";
// The player's clock and controls. Buttons with data-seek anywhere on the page jump to that many seconds.
(async () => {
  const SPEEDS = [0.5, 1, 2, 5, 10, 20];
  const STEP = 0.1; // seconds, of an arrow key
  const CHARTS_EVERY = 200; // milliseconds between new numbers in the charts while it plays
  const CALM_EVERY = 500; // milliseconds between pictures for readers who want less motion
  const data = JSON.parse(document.getElementById("player-data").textContent);
  const section = document.getElementById("player");
  if (typeof DecompressionStream === "undefined") return;
  section.hidden = false;
  const part = (name) => section.querySelector(`[data-part="${name}"]`);
  const [stage, canvas, slider, play, speed, clock] = ["stage", "canvas", "slider", "play", "speed", "clock"].map(part);
  const heightFor = (width) => Math.round(Math.min(480, Math.max(280, 0.55 * width)));
  canvas.style.height = `${heightFor(stage.clientWidth)}px`; // nothing moves when the picture comes
  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  const view = openView(data, await openScene(data), canvas);
  let now = data.from;
  let playing = false;
  let before = null; // of the last frame, milliseconds
  let [drawnAt, chartsAt] = [-Infinity, -Infinity];

  const follow = part("follow");
  const show = (settled) => {
    view.draw(now);
    slider.value = now;
    clock.textContent = `${now.toFixed(2)} s of ${data.until.toFixed(2)} s`;
    section.dataset.seconds = now.toFixed(3);
    follow.setAttribute("aria-pressed", String(view.follows()));
    for (const tell of instants) tell(now);
    for (const move of playheads) move(now, settled);
  };
  const seek = (seconds) => {
    now = Math.min(Math.max(seconds, data.from), data.until);
    slider.setAttribute("aria-valuetext", `${now.toFixed(2)} seconds`);
    show(true);
  };
  const setPlaying = (wanted) => {
    if (wanted && now >= data.until) now = data.from;
    playing = wanted;
    play.textContent = playing ? "\u275a\u275a" : "\u25b6";
    play.setAttribute("aria-label", playing ? "pause" : "play");
    before = null;
    if (playing) requestAnimationFrame(frame);
    else seek(now);
  };
  const frame = (time) => {
    if (!playing) return;
    // After a pause of the browser's the run goes on where it was seen last.
    now = Math.min(now + (Math.min(time - (before ?? time), 250) / 1000) * Number(speed.value), data.until);
    before = time;
    if (now >= data.until) return setPlaying(false);
    if (!calm.matches || time - drawnAt >= CALM_EVERY) {
      const numbers = time - chartsAt >= CHARTS_EVERY;
      if (numbers) chartsAt = time;
      drawnAt = time;
      show(numbers);
    }
    requestAnimationFrame(frame);
  };
  const faster = (steps) => {
    const at = SPEEDS.indexOf(Number(speed.value)) + steps;
    speed.value = String(SPEEDS[Math.min(Math.max(at, 0), SPEEDS.length - 1)]);
  };

  const fit = (width) => {
    view.resize(width, heightFor(width));
    show(true);
  };
  const whole = () => {
    view.whole();
    show(true);
  };
  const toggleFollow = () => {
    if (view.follows()) view.whole();
    else view.near();
    show(true);
  };
  const zoom = (factor) => {
    view.zoom(factor);
    show(true);
  };
  play.addEventListener("click", () => setPlaying(!playing));
  slider.addEventListener("input", () => seek(Number(slider.value)));
  follow.addEventListener("click", toggleFollow);
  part("whole").addEventListener("click", whole);
  part("nearer").addEventListener("click", () => zoom(1.5));
  part("farther").addEventListener("click", () => zoom(1 / 1.5));
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    view.pan(event.movementX, event.movementY);
    show(false);
  });
  document.addEventListener("click", (event) => {
    const button = event.target.closest("[data-seek]");
    if (!button) return;
    setPlaying(false);
    seek(Number(button.dataset.seek));
    if (!section.contains(button)) section.scrollIntoView({ block: "nearest" });
  });
  seekers.push((seconds) => {
    if (playing) setPlaying(false);
    seek(seconds);
  });
  const keys = {
    " ": () => setPlaying(!playing),
    ArrowLeft: (big) => seek(now - (big ? 10 : 1) * STEP),
    ArrowRight: (big) => seek(now + (big ? 10 : 1) * STEP),
    Home: () => seek(data.from),
    End: () => seek(data.until),
    "+": () => faster(1),
    "=": () => faster(1),
    "-": () => faster(-1),
    f: toggleFollow,
    0: whole,
  };
  section.addEventListener("keydown", (event) => {
    const act = keys[event.key];
    const own = event.target.closest("button, select") && (event.key === " " || event.target.matches("select"));
    if (!act || own || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act(event.shiftKey);
  });

  view.resize(stage.clientWidth, heightFor(stage.clientWidth));
  view.whole();
  if (view.isSmall()) view.near();
  seek(data.from);
  onWidth(stage, fit);
  redraws.push(() => {
    view.recolor();
    show(true);
  });
})();
