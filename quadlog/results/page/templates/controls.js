"use strict";
// The controls of a scene: legend, zoom, clock, timeline and keys. A scene without a time has no clock.
const SPEEDS = [0.5, 1, 2, 5, 10, 20];

const HELP = "player. Space plays and stops, left and right arrow step, plus and minus change the speed, home and end go to start and end, brackets to the moment before and after, F follows the robot, 0 shows the walk, A all, C copies the link.";

const openScene = (place, scene, block) => {
  const [from, until] = scene.span ?? [0, 0];
  const moves = until > from;
  const clock = clockOf(scene.group);
  const canvas = element("canvas", { role: "img", "aria-label": place.dataset.name });
  const stage = element("div", { class: "stage" }, canvas);
  const view = openView(scene, canvas, block);
  for (const layer of view.layers) layer.off = layer.hidden ??= false;
  const claim = element("output", { class: "tip claim", hidden: true });
  let opened = null;
  let [fitted, own] = [true, false]; // whether the view is the first one, and whether the reader chose it
  const draw = () => {
    const instant = moves ? (clock.now ?? from) : until;
    const moment = opened && Math.abs(opened.seconds - instant) < 0.0015 ? opened : null;
    claim.hidden = !moment;
    if (moment) claim.textContent = moment.words;
    view.draw(instant, moment);
  };
  const changed = (act) => {
    [fitted, own] = [false, true];
    act();
    draw();
    follow.setAttribute("aria-pressed", String(view.follows()));
    if (moves) clock.rest();
  };
  const fit = () => {
    view.fit(scene.extent);
    [fitted, own] = [true, false];
  };
  const follow = button("follow", "follow the robot (F)", () => changed(() => (view.follows() ? fit() : view.near(12))), { "aria-pressed": "false" });
  const walk = button("walk", "show the walk (0)", () => changed(fit));
  const whole = button("all", "show all, with anchors and walls (A)", () => changed(() => view.fit(scene.whole ?? scene.extent)));
  const zooms = [["+", "zoom in", 1.5], ["\u2212", "zoom out", 1 / 1.5]].map(([sign, name, by]) => button(sign, name, () => changed(() => view.zoom(by))));
  const legend = legendOf(view.layers, () => (draw(), moves && clock.rest()));
  const timeline = element("div", { class: "timeline", role: "group", "aria-label": HELP });
  stage.append(element("div", { class: "tools" }, ...zooms, walk, ...(scene.whole ? [whole] : []), ...(moves ? [follow] : [])), claim);
  place.append(stage, element("div", { class: "legend" }, legend), ...(moves ? [timeline] : []));
  place.classList.add("open");
  // A walk that is higher than wide has a narrower map, and the curves more room.
  place.closest(".beside")?.style.setProperty("--aspect", (scene.extent[1] - scene.extent[0]) / (scene.extent[3] - scene.extent[2]));
  onWidth(stage, (width) => {
    const [left, right, bottom, top] = scene.extent;
    const fitting = Math.min(0.5 * innerHeight, (width * (top - bottom)) / (right - left));
    const isWide = place.closest(".beside") && matchMedia("(min-width: 75rem)").matches;
    // Beside curves the map ends with the screen: what lies above it, legend and timeline have their place there too.
    const above = Math.min(stage.getBoundingClientRect().top + scrollY, innerHeight / 2);
    const rest = innerHeight - above - (place.parentElement.offsetHeight - stage.offsetHeight) - 8;
    if (isWide) place.closest(".beside").style.setProperty("--high", `${Math.max(innerHeight - above - 8, 320)}px`);
    const height = Math.round(Math.max(isWide ? rest : fitting, 280)); // print may have no height
    canvas.style.height = `${height}px`;
    view.resize(width, height);
    if (fitted) fit();
    draw();
  });
  redraws.push(() => {
    view.recolor();
    draw();
  });
  addPointer(stage, view, changed, moves && clock);
  if (!moves) return null;
  // An open moment: claims at its instant, as many as fit above the map; the view goes there, or stays for the first one.
  const openMoment = (moment, closely = true) => {
    const same = scene.moments.filter(({ seconds }) => Math.abs(seconds - moment.seconds) < 0.0015);
    const drawn = [moment, ...same].find(({ line }) => line.length) ?? moment;
    const all = same.map(wordsOf), few = all.findIndex((_, index) => index && all.slice(0, index + 1).join("; ").length > 140);
    const words = few < 0 ? all : [...all.slice(0, few), `and ${all.length - few} more`];
    opened = { ...drawn, words: words.join("; "), ...(closely ? {} : { shows: [] }) };
    if (closely) (view.open(drawn), ([fitted, own] = [false, false]));
    clock.pause();
    clock.set(moment.seconds);
  };
  const groups = groupsOf(scene.moments);
  const turn = (by) => {
    const beyond = groups.filter(([{ seconds }]) => by * (seconds - clock.now) > 0.0015);
    if (beyond.length) openMoment(beyond.at(by > 0 ? 0 : -1)[0]);
  };
  const player = addTransport(timeline, scene, clock, groups, openMoment, turn);
  clock.listeners.push(draw);
  // What the address of the page says beside the instant.
  const state = () => {
    const toggled = view.layers.filter(({ hidden, off }) => hidden !== off).map(({ label }) => label);
    return { ...(own ? { view: view.place().map((value) => value.toFixed(2)).join() } : {}), ...(toggled.length ? { layers: toggled.join("~") } : {}) };
  };
  const restore = (instant, { view: wanted, layers }, closely = true) => {
    const moment = scene.moments.find(({ seconds }) => Math.abs(seconds - instant) < 0.01);
    if (layers) for (const layer of view.layers) layer.hidden = layer.off !== layers.split("~").includes(layer.label);
    legend.mark();
    if (moment && !wanted) openMoment(moment, closely);
    else clock.set(instant);
    if (wanted) changed(() => view.place(wanted.split(",").map(Number)));
  };
  const copy = () => {
    navigator.clipboard?.writeText(location.href);
    [claim.textContent, claim.hidden] = ["link copied", false];
  };
  const keys = { ...player, f: () => follow.click(), 0: () => walk.click(), a: () => whole.click(), c: copy, "[": () => turn(-1), "]": () => turn(1) };
  return { stage, keys, clock, state, restore, start: () => clock.now ?? restore(Number(place.dataset.start ?? from), {}, false) };
};

const wordsOf = ({ what, value }) => `${what}${/^[a-z]/.test(value) ? "," : ""} ${value}`;

// Moments within half a second of the first one are one dot of the timeline.
const groupsOf = (moments) => {
  const groups = [];
  for (const moment of [...moments].sort((a, b) => a.seconds - b.seconds)) {
    if (groups.length && moment.seconds - groups.at(-1)[0].seconds < 0.5) groups.at(-1).push(moment);
    else groups.push([moment]);
  }
  return groups;
};

const GLYPHS = { raster: "■", windows: "■", dot: "●", triangle: "▲", cross: "✕", ring: "○" };

const swatchOf = (glyph, color) => {
  const swatch = element("i", { "aria-hidden": "true" }, glyph);
  swatch.style.color = `var(--${color})`;
  return swatch;
};

const legendOf = (layers, draw) => {
  const entries = layers.map((layer) => {
    const { kind, shape, variant, color, label } = layer;
    const swatch = swatchOf(GLYPHS[kind] ?? GLYPHS[shape] ?? "━╍┅┉"[(variant ?? 0) % 4], color);
    return element("button", { type: "button", onclick: () => ((layer.hidden = !layer.hidden), legend.mark(), draw()) }, swatch, label);
  });
  const legend = element("div", { class: "layers", role: "group", "aria-label": "layers" }, ...entries);
  legend.mark = () => entries.forEach((made, at) => made.setAttribute("aria-pressed", String(!layers[at].hidden)));
  legend.mark();
  return legend;
};

// Wheel and pinch zoom about the pointer, drag moves, a click goes to the nearest instant of a track.
const addPointer = (stage, view, changed, clock) => {
  const tip = element("output", { class: "tip", hidden: true });
  const canvas = stage.firstChild;
  stage.append(tip);
  const fingers = new Map();
  let dragged = 0;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, event);
    dragged = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return readOff(event);
    const [dx, dy] = [event.offsetX - before.offsetX, event.offsetY - before.offsetY];
    dragged += Math.abs(dx) + Math.abs(dy);
    const other = [...fingers.values()].find(({ pointerId }) => pointerId !== event.pointerId);
    const span = (finger) => Math.hypot(finger.offsetX - other.offsetX, finger.offsetY - other.offsetY);
    changed(() => (other ? view.zoom(span(event) / Math.max(span(before), 1), other.offsetX, other.offsetY) : view.pan(dx, dy)));
    fingers.set(event.pointerId, event);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, ({ pointerId }) => fingers.delete(pointerId));
  canvas.addEventListener("pointerleave", () => (tip.hidden = true));
  canvas.addEventListener("click", (event) => {
    const found = dragged < 4 && clock && view.nearest(event.offsetX, event.offsetY);
    if (found) clock.set(found.seconds);
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    changed(() => view.zoom(Math.exp(-event.deltaY / 300), event.offsetX, event.offsetY));
  }, { passive: false });
  const readOff = (event) => {
    const [wx, wy] = view.world(event.offsetX, event.offsetY);
    const found = clock && view.nearest(event.offsetX, event.offsetY);
    tip.hidden = false;
    tip.textContent = `x ${wx.toFixed(2)}, y ${wy.toFixed(2)} m${found ? `, ${found.label} at ${found.seconds.toFixed(2)} s` : ""}`;
  };
};

// Play button, slider and speed, and above the slider when there was data of each role.
const addTransport = (place, scene, clock, groups, openMoment, step) => {
  const [from, until] = scene.span;
  let [playing, before, owed, shown, turn] = [false, null, 0, 0, 0];
  const seek = (instant, turn) => clock.set(Math.min(Math.max(instant, from), until), turn);
  // Where nothing was recorded, nothing is played.
  const spans = Object.values(scene.activity).flat();
  const skipGap = (instant) => {
    const begins = spans.filter(([, end]) => end >= instant).map(([begin]) => begin);
    return begins.length ? Math.max(instant, Math.min(...begins)) : instant;
  };
  const setPlaying = (wanted) => {
    if (wanted && clock.now >= until) seek(from);
    [playing, before] = [wanted, null];
    play.textContent = playing ? "❚❚" : "▶";
    play.setAttribute("aria-label", playing ? "Pause" : "Play");
    if (playing) requestAnimationFrame(frame);
    else seek(clock.now);
  };
  const frame = (now) => {
    if (!playing) return;
    owed += (Math.min(now - (before ?? now), 250) / 1000) * Number(speed.value);
    before = now;
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (!calm || now - shown > 500) {
      seek(skipGap(clock.now + owed), turn++);
      [owed, shown] = [0, now];
    }
    if (clock.now >= until) setPlaying(false);
    else requestAnimationFrame(frame);
  };
  const play = button("▶", "Play", () => setPlaying(!playing), { class: "play" });
  const slider = element("input", { type: "range", min: from, max: until, step: 0.001, "aria-label": "time", oninput: () => seek(Number(slider.value)) });
  const time = element("output", { class: "clock" });
  const speed = element("select", { "aria-label": "speed" }, ...SPEEDS.map((times) => element("option", { value: times, selected: times === 1 }, `${times} ×`)));
  const share = (instant) => `${(100 * (Math.min(Math.max(instant, from), until) - from)) / (until - from)}%`;
  const row = (label, marks) => {
    const jump = (event) => event.target.matches(".strip") && seek(from + ((until - from) * event.offsetX) / event.target.clientWidth);
    return [element("span", {}, label), element("div", { class: "strip", onclick: jump }, ...marks)];
  };
  const mark = (attributes, style) => {
    const made = element("i", attributes);
    Object.assign(made.style, style);
    return made;
  };
  const dots = groups.map((group) => mark({ class: "moment", title: group.map(wordsOf).join("\n"), onclick: () => openMoment(group[0]) }, { left: share(group[0].seconds) }));
  const spanOf = ([start, end]) => mark({ class: "span" }, { left: share(start), right: `calc(100% - ${share(end)})` });
  const rows = [...(dots.length ? row("moments", dots) : []), ...Object.entries(scene.activity).flatMap(([role, spans]) => row(role, spans.map(spanOf)))];
  const activity = element("div", { class: "activity", "aria-hidden": "true" }, ...rows);
  const steps = groups.length ? [button("\u2039", "moment before ([)", () => step(-1)), button("\u203a", "next moment (])", () => step(1))] : [];
  place.append(play, element("div", { class: "tracks" }, slider, activity), ...steps, time, speed);
  clock.pause = () => playing && setPlaying(false);
  clock.listeners.push((instant) => {
    slider.value = instant;
    time.textContent = `${instant.toFixed(2)} of ${until.toFixed(1)} s`;
    place.dataset.now = instant.toFixed(3);
  });
  const faster = (by) => (speed.selectedIndex = Math.min(Math.max(speed.selectedIndex + by, 0), SPEEDS.length - 1));
  return {
    " ": () => setPlaying(!playing),
    ArrowLeft: (far) => seek(clock.now - (far ? 1 : 0.1)),
    ArrowRight: (far) => seek(clock.now + (far ? 1 : 0.1)),
    Home: () => seek(from),
    End: () => seek(until),
    "+": () => faster(1),
    "-": () => faster(-1),
  };
};
