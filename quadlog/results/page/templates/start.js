"use strict";
// Opens the scenes and curves of the page. Keys work anywhere; #t=18.08 opens an instant, and the address follows it.
(async () => {
  // Words are painted before drawings are made; a page that is not in sight has no frames.
  await new Promise((done) => (requestAnimationFrame(() => setTimeout(done)), setTimeout(done, 100)));
  const block = await unpack();
  const places = [...document.querySelectorAll("[data-scene]")];
  const open = (place) => openScene(place, pageData.scenes[place.dataset.scene], block);
  const isNear = (place) => place.getBoundingClientRect().top < 2 * innerHeight;
  const players = places.filter(isNear).map(open);
  openCurves([...document.querySelectorAll("[data-chart]")], block);
  players.push(...places.filter((place) => !place.classList.contains("open")).map(open));
  const moving = players.filter(Boolean);
  const goTo = (address) => {
    const { t, ...more } = Object.fromEntries(new URLSearchParams(address.slice(1)));
    if (t === undefined || !Number.isFinite(Number(t))) return false;
    for (const clock of Object.values(clocks)) (clock.pause(), clock.set(Number(t)));
    moving[0]?.restore(Number(t), more);
    return true;
  };
  if (!goTo(location.hash)) moving.forEach(({ start }) => start());
  addEventListener("hashchange", () => goTo(location.hash));
  // Once the clock rests: a browser refuses an address a frame.
  let waiting = 0;
  for (const { clock, state } of moving.slice(0, 1)) {
    const say = () => history.replaceState(null, "", `#${new URLSearchParams({ t: clock.now.toFixed(3), ...state() })}`);
    clock.rest = () => (clearTimeout(waiting), (waiting = setTimeout(say, 400)));
  }
  addEventListener("click", (event) => {
    const link = event.target.closest('a[href^="#t="]');
    if (!link || !goTo(link.hash)) return; // a second click on a link changes no hash
    const { top, bottom } = moving[0]?.stage.getBoundingClientRect() ?? {};
    if (bottom < 40 || top > innerHeight - 40) moving[0].stage.scrollIntoView({ block: "nearest" });
  });
  addEventListener("keydown", (event) => {
    const taken = event.target.closest('input:not([type="range"]), select, textarea, [contenteditable]') || (event.key === " " && event.target.closest("button, summary, a"));
    const act = moving[0]?.keys[event.key];
    if (!act || taken || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act(event.shiftKey);
  });
})();
