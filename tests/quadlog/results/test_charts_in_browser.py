"""The charts in a real browser: drawn, read off, zoomed by mouse and keys, and pictures in their place on paper."""

import html
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from quadlog.results.page.charts import to_script_json
from quadlog.results.page.report import write_report

Browse = Callable[..., tuple[str, list[str]]]
HOSTILE = "</script><script>document.title = 'owned'</script><img src=x onerror=\"document.title = 'owned'\">"

# Asks a finished page about itself; the answers go into its title.
PROBE = """
const say = {};
const place = (name) => document.querySelector(`[data-chart="${name}"]`);
const drawn = (canvas) => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some(Boolean);
const point = (name, share, kind = "mousemove") => {
  const over = place(name).querySelector(".u-over");
  const box = over.getBoundingClientRect();
  const at = { clientX: box.left + share * box.width, clientY: box.top + box.height / 2, bubbles: true };
  over.dispatchEvent(new MouseEvent(kind, at));
};
const read = (name) => [...place(name).querySelectorAll(".u-value")].map((each) => each.textContent);
const press = (name, key) => place(name).dispatchEvent(new KeyboardEvent("keydown", { key }));
const ask = async () => {
  const pause = () => new Promise((resolve) => setTimeout(resolve, 50));
  say.charts = [...document.querySelectorAll(".chart")].map((each) => each.dataset.chart);
  say.canvases = [...document.querySelectorAll(".chart canvas")].map(drawn);
  say.pictures = [...document.querySelectorAll("figure img")].map((each) => each.checkVisibility());
  point("tracking_error", 0.5);
  say.hover = read("tracking_error");
  say.follows = read("commands");
  say.dots = [...document.querySelectorAll(".dot")].filter((each) => !each.hidden).length;
  press("tracking_error", "+");
  await pause();
  point("commands", 0);
  say.zoomed = read("commands");
  press("commands", "0");
  await pause();
  point("commands", 0);
  say.all = read("commands");
  press("lookahead", "ArrowRight");
  press("lookahead", "ArrowRight");
  say.said = place("lookahead").querySelector("output").textContent;
  place("lookahead").querySelector(".bar button:last-child").click();
  say.swapped = place("lookahead").closest("figure").querySelector("img").checkVisibility();
  say.walks = [...place("trajectory").querySelectorAll(".names button")].map((each) => each.textContent);
  document.title = JSON.stringify(say);
};
setTimeout(ask, 200);
"""

# Notes where the map draws what: the frame that it clips at, and everything from then on.
MAP_NOTES = """
// A browser that shows nobody its pages draws no frames and tells of no new sizes: the probe does.
const looks = [];
window.ResizeObserver = class {
  constructor(look) { looks.push(look); }
  observe() {}
};
const drawn = { frame: null, boxes: [], walls: [], texts: [] };
const pen = CanvasRenderingContext2D.prototype;
const note = {
  rect: (_, x, y, width, height) => drawn.boxes.push([x, x + width, y, y + height]),
  clip: () => Object.assign(drawn, { frame: drawn.boxes.at(-1), boxes: [], walls: [], texts: [] }),
  fillRect: (_, x, y, width, height) => drawn.walls.push([x, x + width, y, y + height]),
  fillText: (context, text, x, y) => {
    const size = context.measureText(text);
    drawn.texts.push([x, x + size.width, y - size.actualBoundingBoxAscent, y + size.actualBoundingBoxDescent]);
  },
  arc: (_, x, y, radius) => drawn.boxes.push([x - radius, x + radius, y - radius, y + radius]),
  moveTo: (_, x, y) => drawn.boxes.push([x, x, y, y]),
  lineTo: (_, x, y) => drawn.boxes.push([x, x, y, y]),
};
for (const [name, take] of Object.entries(note)) {
  const call = pen[name];
  pen[name] = function (...args) {
    if (this.canvas.closest('[data-chart="trajectory"]') && typeof args[0] !== "object") take(this, ...args);
    return call.apply(this, args);
  };
}
"""
MAP_PROBE = """
const say = {};
const place = document.querySelector('[data-chart="trajectory"]');
const pause = () => new Promise((resolve) => setTimeout(resolve, 50));
const over = () =>
  place.querySelector("canvas").getBoundingClientRect().width - place.querySelector(".panels").clientWidth;
const widen = async (width) => {
  document.body.style.width = `${width}px`;
  looks.forEach((look) => look());
  await pause();
};
const see = (name) => {
  const { frame, boxes, walls, texts } = drawn;
  const outer = (all) => [0, 1, 2, 3].map((side) => Math[side % 2 ? "max" : "min"](...all.map((each) => each[side])));
  const cut = over() > 1;
  say[name] = { frame, cut, all: outer([...boxes, ...walls, ...texts]), walls: outer(walls), labels: texts.length };
};
const ask = async () => {
  document.body.style.maxWidth = "none";
  for (const [at, width] of [1200, 320, 390, 800, 1200].entries()) {
    await widen(width);
    see(`${at}: ${width}`);
  }
  await widen(390);
  place.dispatchEvent(new KeyboardEvent("keydown", { key: "+" }));
  await pause();
  see("zoomed");
  place.querySelector(".u-over").dispatchEvent(new MouseEvent("dblclick", { bubbles: true }));
  await pause();
  see("double click");
  document.title = JSON.stringify(say);
};
setTimeout(ask, 200);
"""
ROOM = [[0, 0, 276], [80, 0, 1], [80, 275, 1], [177, 40, 200]]  # walls: row, first column, length; in cells of 0.1 m

PAGE_REQUEST = 101845102  # Chromium's traffic annotation `blink_resource_loader`: what a page loads


@pytest.fixture
def page(reported: Path, tmp_path: Path) -> Path:
    """The report of the tiny run, to be changed."""
    return Path(shutil.copy(reported / "report.html", tmp_path))


def _ask(
    page: Path, browse: Browse, probe: str = PROBE, width: int = 900, first: str = ""
) -> tuple[dict[str, Any], list[str]]:
    """A copy without the policy, with the probe in it, and `first` before all scripts; its answers and complaints."""
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text())
    probed = page.with_name("probed.html")
    text = text.replace("</head>", f"<script>{first}</script></head>", 1)
    probed.write_text(text.replace("</body>", f"<script>{probe}</script></body>"))
    dom, complaints = browse(probed, "--dump-dom", f"--window-size={width},900", "--virtual-time-budget=4000")
    title = re.search(r"<title>(.*?)</title>", dom, re.DOTALL)
    return json.loads(html.unescape(title[1])), complaints


def test_charts_are_drawn_read_off_and_zoomed(page: Path, browse: Browse) -> None:
    say, complaints = _ask(page, browse)
    assert complaints == []
    assert len(say["charts"]) == 8
    assert len(say["canvases"]) >= 11
    assert all(say["canvases"])
    # A picture is shown where there is no chart, and only there.
    assert sum(say["pictures"]) == len(say["pictures"]) - len(say["charts"])
    seconds, timed_m, path_m = (float(value) for value in say["hover"][:3])
    assert seconds == pytest.approx(2.0, abs=0.05)
    assert 0 < path_m <= 0.1
    assert timed_m == pytest.approx(2 * path_m, abs=1e-3)
    assert float(say["follows"][0]) == seconds
    assert say["dots"] == 3
    assert float(say["zoomed"][0]) == pytest.approx(1.0, abs=0.05)
    assert float(say["all"][0]) == pytest.approx(0.0, abs=0.02)
    assert re.fullmatch(r"0\.0\d s: l 2", say["said"])
    assert say["swapped"]
    assert say["walks"] == ["robot", "target", "re-simulated walk", "UWB fixes", "some plans"]


def _chart_data(page: Path) -> tuple[str, int, int]:
    """The page, and from where to where the data of its charts lie in it."""
    text = page.read_text()
    start = text.index(">", text.index('id="chart-data"')) + 1
    return text, start, text.index("</script>", start)


def _with_map(page: Path, **changed: Any) -> None:
    """Another map in the page's trajectory chart."""
    text, start, end = _chart_data(page)
    charts = json.loads(text[start:end])
    charts["trajectory"] |= changed
    page.write_text(text[:start] + to_script_json(charts) + text[end:])


@pytest.mark.parametrize("walled", [True, False])
def test_the_map_shows_everything_at_any_width(page: Path, browse: Browse, walled: bool) -> None:
    runs = [number for run in ROOM for number in run] if walled else []
    anchors = [{"label": "a long label", "x": 20.0, "y": 1.2}, {"label": "0", "x": 1.0, "y": 16.0}]
    _with_map(page, anchors=anchors, walls=[{"cell_m": 0.1, "x": -3.0, "y": -1.0, "runs": runs}])
    say, complaints = _ask(page, browse, MAP_PROBE, 1300, MAP_NOTES)
    assert complaints == []
    zoomed = say.pop("zoomed")
    assert zoomed["all"][0] < zoomed["frame"][0]
    assert len(say) == 6
    for name, seen in say.items():
        assert not seen["cut"], name
        assert seen["labels"] == 2
        for side, (drawn, frame) in enumerate(zip(seen["all"], seen["frame"], strict=True)):
            assert drawn >= frame - 0.5 if side % 2 == 0 else drawn <= frame + 0.5, (name, side)
        if walled:
            left, right, top, bottom = seen["walls"]
            assert (right - left) / 27.6 == pytest.approx((bottom - top) / 17.8, rel=0.01), name
    # What a narrow page needed stays on no wide one.
    assert say["0: 1200"] == say["4: 1200"]


def test_the_policy_admits_the_charts_and_nothing_is_fetched(page: Path, browse: Browse) -> None:
    def asked(page: Path) -> set[str]:
        """Addresses the page asked for; the browser's own requests to its maker carry other marks."""
        log = page.with_suffix(".net.json")
        browse(page, "--dump-dom", f"--log-net-log={log}", "--virtual-time-budget=2000")
        return set(re.findall(rf'"traffic_annotation":{PAGE_REQUEST},"url":"([^"]*)"', log.read_text()))

    dom, complaints = browse(page, "--dump-dom", "--virtual-time-budget=2000")
    assert complaints == []
    assert dom.count('class="uplot') >= 11
    assert asked(page) == set()
    leaking = page.with_name("leaking.html")
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text())
    leaking.write_text(text.replace("<h1>", '<img src="http://127.0.0.1:9/leak.png"><h1>'))
    assert asked(leaking) == {"http://127.0.0.1:9/leak.png"}


def test_hostile_names_run_nothing(tiny_run: Path, browse: Browse) -> None:
    record = json.loads((tiny_run / "run.json").read_text())
    record["topics"][0]["topic"] = record["warnings"][0] = record["input"]["path"] = HOSTILE
    (tiny_run / "run.json").write_text(json.dumps(record))
    dom, complaints = browse(write_report(tiny_run), "--dump-dom", "--virtual-time-budget=2000")
    assert complaints == []
    assert "<title>owned" not in dom


def test_hostile_labels_of_a_chart_stay_text(page: Path, browse: Browse) -> None:
    text, start, end = _chart_data(page)
    charts = json.loads(text[start:end])
    for panel in charts["commands"]["panels"]:
        panel["what"] = HOSTILE
        panel["lines"][0]["label"] = HOSTILE
    charts["trajectory"]["walks"][0]["label"] = HOSTILE
    charts["trajectory"]["anchors"][0]["label"] = HOSTILE
    page.write_text(text[:start] + to_script_json(charts) + text[end:])
    say, complaints = _ask(page, browse)
    assert complaints == []
    assert say["walks"][0] == HOSTILE


def test_paper_has_every_picture_and_no_chart(page: Path, browse: Browse) -> None:
    paper = page.with_name("paper.pdf")
    _, complaints = browse(page, "--no-pdf-header-footer", f"--print-to-pdf={paper}", "--virtual-time-budget=2000")
    assert complaints == []
    # Every picture, and the player as it stands.
    assert paper.read_bytes().count(b"/Subtype /Image") == page.read_text().count("<img ") + 1
