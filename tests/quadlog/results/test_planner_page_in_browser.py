"""The page of a planner comparison in a real browser: the slider shows each question's map, paths and numbers."""

import html
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.mapping.grid import Window
from quadlog.metrics.planning import compare_planners
from quadlog.results.planner_comparison import folder as comparison_folder
from quadlog.results.planner_comparison.folder import ComparisonFiles
from quadlog.results.planner_comparison.shown_questions import QuestionSample
from quadlog.results.planner_comparison.tables import REPLANS, SCENARIOS

Browse = Callable[..., tuple[str, list[str]]]
HOSTILE = "</script><img src=x onerror=\"document.title = 'owned'\">"
ROWS, COLUMNS, CELL_M, QUESTIONS = 10, 12, 0.25, 6
PROBE = """
const say = {};
const place = document.querySelector("[data-map]");
const part = (name) => place.querySelector(`[data-part="${name}"]`);
const at = () => Number(place.dataset.at);
const press = (key, more = {}) =>
  place.querySelector(".map").dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, ...more }));
const text = (each) => each.textContent;
const texts = () => [...place.querySelectorAll("[data-planner]")].map((row) => [...row.cells].map(text));
const inks = () => {
  const canvas = part("canvas");
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const found = {};
  for (let pixel = 0; pixel < data.length; pixel += 4) {
    const color = data.slice(pixel, pixel + 3).join();
    found[color] = (found[color] ?? 0) + 1;
  }
  return found;
};
const click = (element) => {
  const box = element.getBoundingClientRect();
  for (const kind of ["mousedown", "mouseup", "click"]) {
    const at = { clientX: box.left + 0.42 * box.width, clientY: box.top + 9 };
    element.dispatchEvent(new MouseEvent(kind, { ...at, bubbles: true }));
  }
};
const ask = async () => {
  const pause = () => new Promise((done) => setTimeout(done, 20));
  for (let wait = 0; wait < 100 && place.dataset.at === undefined; wait++) await pause();
  say.keys = [["End"], ["ArrowLeft"], ["Home"], ["ArrowRight"], ["ArrowRight", { shiftKey: true }]].map((each) => {
    press(...each);
    return at();
  });
  part("slider").value = 2;
  part("slider").dispatchEvent(new Event("input"));
  say.slid = at();
  say.clock = part("clock").textContent;
  say.texts = texts();
  say.heads = [...document.querySelectorAll(".playhead")].filter((each) => !each.hidden).length;
  say.both = inks();
  const second = place.querySelectorAll("[data-planner] button")[1];
  second.click();
  say.alone = inks();
  say.pressed = second.getAttribute("aria-pressed");
  const over = document.querySelector(".u-over");
  press("Home");
  click(over);
  say.clicked = at();
  const cursor = [...document.querySelectorAll(".uplot")].map((each) => each.querySelector(".u-value").textContent);
  say.cursor = cursor;
  const data = JSON.parse(document.getElementById("map-data").textContent)[1];
  const blocks = [JSON.parse(JSON.stringify(data)), data.grown];
  const layers = await Promise.all(blocks.map(openScene));
  const image = new ImageData(data.windows[0].columns, data.windows[0].rows);
  say.maps = Array.from({ length: QUESTIONS }, (_, question) => layers.map((scene, layer) => {
    const [windows] = blocks[layer].windows;
    scene.paint(windows, scene.window(windows, question + 1), image);
    return [...new Uint32Array(image.data.buffer)].flatMap((cell, where) => (cell ? [where] : []));
  }));
  say.wide = document.documentElement.scrollWidth;
  say.paper = document.querySelectorAll("figure img").length;
  document.title = JSON.stringify(say);
};
setTimeout(ask, 100);
"""


def _maps() -> list[tuple[Window, np.ndarray, np.ndarray]]:
    """A window that slides by (2, 1) cells over noise that stays where it is, and what is kept clear of it."""
    world = np.random.default_rng(5).random((40, 40)) < 0.2
    grown = world | np.roll(world, 1, axis=1)
    made = []
    for number in range(QUESTIONS):
        col0, row0 = 2 * number, number
        part = np.s_[row0 : row0 + ROWS, col0 : col0 + COLUMNS]
        made.append((Window(col0 - 7, row0 - 3, CELL_M, (ROWS, COLUMNS)), world[part], grown[part]))
    return made


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two planners, one with a hostile name, on six questions; in the last one the second finds no path."""
    monkeypatch.setattr(comparison_folder, "render_png", lambda draw: b"")
    names = ("astar", HOSTILE)
    sample = QuestionSample(is_static=False, row_zero_on_top=False)
    columns: dict[str, list[Any]] = {name: [] for name in REPLANS.names}
    for replan, (window, occupied, blocked) in enumerate(_maps()):
        straight = np.array([[1, 1], [2, 2], [9, 2]], dtype=np.int32)
        around = np.array([[1, 1], [1, 8], [9, 8], [9, 2]], dtype=np.int32)
        lost = replan == QUESTIONS - 1
        paths = {names[0]: straight, names[1]: around[:0] if lost else around}
        sample.add((0, replan), window, (occupied, blocked), ((1, 1), (9, 2)), paths)
        for name in names:
            row = dict.fromkeys(REPLANS.names, 0) | {"source": HOSTILE, "planner": name, "why_not": ""}
            row |= {"episode": 0, "replan": replan, "found": not (lost and name == HOSTILE), "length_m": 2.0}
            row |= {"expanded": (replan + 1) * (10 if name == "astar" else 7), "cost": 84.0, "optimal_cost": 84.0}
            row |= {"turn_rad": 1.0, "us": 5.5 + replan, "from_scratch": True, "goal_projected": False}
            for column, value in row.items():
                columns[column].append(value)
    replans = {name: np.array(values) for name, values in columns.items()}
    scenarios = {name: np.array([]) for name in SCENARIOS.names}
    with ComparisonFiles(tmp_path / "out", force=False, has_queries=False) as files:
        comparison = compare_planners(replans, np.random.default_rng(0))
        files.add(comparison, replans, scenarios, None, sample.finish())
        files.finish([], [], [HOSTILE])
    return tmp_path / "out" / "report.html"


def _ask(page: Path, browse: Browse, width: int = 1200) -> dict[str, Any]:
    """A copy without the policy, with the probe in it: its answers. No complaint may be on the console."""
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text())
    probed = page.with_name("probed.html")
    probe = f"const QUESTIONS = {QUESTIONS};{PROBE}"
    probed.write_text(text.replace("</body>", f"<script>{{{probe}}}</script></body>"))
    dom, complaints = browse(probed, "--dump-dom", f"--window-size={width},2400", "--virtual-time-budget=6000")
    assert [line for line in complaints if "getImageData" not in line] == []  # the probe reads pixels
    title = re.search(r"<title>(.*?)</title>", dom, re.DOTALL)
    assert title is not None
    return json.loads(html.unescape(title[1]))


def test_the_slider_shows_each_question(page: Path, browse: Browse) -> None:
    say = _ask(page, browse)
    assert say["keys"] == [5, 4, 0, 1, 5]
    assert (say["slid"], say["clock"]) == (2, "replan 3 of 6")
    assert say["texts"] == [["astar", "30", "7.5", "84", "found"], [HOSTILE, "21", "7.5", "84", "found"]]
    assert say["heads"] == 2
    blue = "0,114,178"  # --robot, the colour of the second planner
    assert say["both"].get(blue, 0) > 200
    assert say["alone"].get(blue, 0) == 0
    assert say["pressed"] == "false"
    # 0.42 of the way from replan 1 to 6 is the third one, to which the cursors of both charts go.
    assert say["clicked"] == 2
    assert say["cursor"] == ["3", "3"]
    for (_, *expected), shown in zip(_maps(), say["maps"], strict=True):
        # Pixels start at the upper left, cells at the lower left.
        assert shown == [np.flatnonzero(layer[::-1]).tolist() for layer in expected]


def test_a_phone_needs_no_scrolling_aside(page: Path, browse: Browse) -> None:
    assert _ask(page, browse, 500)["wide"] <= 500  # the narrowest window that Chromium opens without a device


def test_the_policy_admits_the_scripts_and_names_stay_text(page: Path, browse: Browse) -> None:
    dom, complaints = browse(page, "--dump-dom", "--virtual-time-budget=3000")
    assert complaints == []
    assert "<title>owned" not in dom
    assert re.search(r'data-map="1"[^>]* data-at="0"', dom)
    assert dom.count('class="uplot') == 2
