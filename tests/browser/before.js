// A browser that shows nobody its pages draws hardly a frame: the probe does, a thirtieth of a second apart,
// and everything counts as in sight.
let callbacks = [];
let time = 0;
window.requestAnimationFrame = (call) => callbacks.push(call);
const frames = (count) => {
  for (let at = 0; at < count; at++) {
    time += 1000 / 30;
    const due = callbacks;
    callbacks = [];
    due.forEach((call) => call(time));
  }
};
class Observer {
  constructor(call) {
    this.call = call;
  }
  observe(target) {
    setTimeout(() => this.call([{ isIntersecting: true, target }]));
  }
  unobserve() {}
}
window.IntersectionObserver = window.ResizeObserver = Observer;

const wait = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));
const all = (selector) => [...document.querySelectorAll(selector)];
const one = (selector) => document.querySelector(selector);
const press = (key, target = document.body, more = {}) => target.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, ...more }));
const point = (target, kind, share = [0.5, 0.5], more = {}) => {
  const { left, top, width, height } = target.getBoundingClientRect();
  const place = { clientX: left + share[0] * width, clientY: top + share[1] * height, bubbles: true, cancelable: true, ...more };
  const Kind = kind === "wheel" ? WheelEvent : kind.startsWith("pointer") ? PointerEvent : MouseEvent;
  target.dispatchEvent(new Kind(kind, place));
};
const pixels = (color) => {
  const canvas = one(".stage canvas");
  const copy = Object.assign(document.createElement("canvas"), { width: canvas.width, height: canvas.height }).getContext("2d", { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
  const [red, green, blue] = rgb(paint(color));
  let count = 0;
  for (let at = 0; at < data.length; at += 4) count += data[at] === red && data[at + 1] === green && data[at + 2] === blue;
  return count;
};
const now = () => Number(one(".timeline").dataset.now);
const answer = async (probe) => {
  try {
    for (let tries = 0; tries < 200 && document.readyState !== "complete"; tries++) await wait(20);
    for (let tries = 0; tries < 100 && one("[data-scene], [data-chart]") && !one(".stage canvas, .uplot"); tries++) await wait(20);
    await wait(500);
    parent.postMessage(JSON.stringify(await probe()), "*");
  } catch (error) {
    parent.postMessage(JSON.stringify({ failed: `${error} ${error.stack}` }), "*");
  }
};
