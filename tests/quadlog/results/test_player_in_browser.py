"""The player in a real browser: it shows what the tables hold; slider, keys, buttons and charts move it."""

import html
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.results.page.report import write_report
from quadlog.results.run.maps import load_maps
from quadlog.results.run.tables import read_table

Browse = Callable[..., tuple[str, list[str]]]

# A browser that shows nobody its pages draws no frames: the probe does, a thirtieth of a second apart.
FRAMES = """
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
"""
PROBE = """
const say = {};
const section = document.getElementById("player");
const part = (name) => section.querySelector(`[data-part="${name}"]`);
const at = () => Number(section.dataset.seconds);
const press = (key, more = {}) =>
  part("stage").dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, ...more }));
const slide = (seconds) => {
  part("slider").value = seconds;
  part("slider").dispatchEvent(new Event("input"));
  return at();
};
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
const ask = async () => {
  for (let wait = 0; wait < 100 && !section.dataset.seconds; wait++) await new Promise((done) => setTimeout(done, 20));
  say.shown = !section.hidden;
  say.first = at();
  say.slid = slide(2.5);
  say.clock = part("clock").textContent;
  say.heads = [...document.querySelectorAll(".playhead")].filter((each) => !each.hidden).length;
  say.charts = document.querySelectorAll(".u-over").length - 1; // the map has no time
  const worst = section.querySelector("[data-seek][title^=eta_m]");
  worst.click();
  say.worst = at();
  say.keys = [["Home"], ["ArrowRight"], ["ArrowRight", { shiftKey: true }], ["ArrowLeft"], ["End"]].map((each) => {
    press(...each);
    return at();
  });
  press("Home");
  press(" ");
  say.label = part("play").getAttribute("aria-label");
  frames(31);
  say.played = at();
  press("+");
  frames(30);
  say.faster = at() - say.played;
  frames(200);
  say.end = [at(), part("play").getAttribute("aria-label")];
  const over = document.querySelector('[data-chart="tracking_error"] .u-over');
  const box = over.getBoundingClientRect();
  for (const kind of ["mousedown", "mouseup", "click"]) {
    const place = { clientX: box.left + box.width / 2, clientY: box.top + 9 };
    over.dispatchEvent(new MouseEvent(kind, { ...place, bubbles: true }));
  }
  say.clicked = at();
  slide(1.85);
  part("follow").click();
  for (let times = 0; times < 3; times++) part("nearer").click();
  say.inks = inks();
  const data = JSON.parse(document.getElementById("player-data").textContent);
  const scene = await openScene(data);
  const [windows] = data.windows;
  const image = new ImageData(windows.columns, windows.rows);
  say.windows = [...windows.t].map((when, index) => {
    scene.paint(windows, scene.window(windows, when / 1000), image);
    const cells = [...new Uint32Array(image.data.buffer)].flatMap((cell, place) => (cell ? [place] : []));
    return { x: windows.x + windows.column[index] * windows.cell, cells };
  });
  say.poses = data.tracks.map((track) => scene.pose(track, 2.0));
  document.title = JSON.stringify(say);
};
setTimeout(ask, 100);
"""


def _ask(page: Path, browse: Browse) -> dict[str, Any]:
    """A copy without the policy, with the probe in it: its answers. No complaint may be on the console."""
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text())
    probed = page.with_name("probed.html")
    text = text.replace("</head>", f"<script>{FRAMES}</script></head>", 1)
    probed.write_text(text.replace("</body>", f"<script>{PROBE}</script></body>"))
    dom, complaints = browse(probed, "--dump-dom", "--window-size=900,900", "--virtual-time-budget=6000")
    assert complaints == []
    title = re.search(r"<title>(.*?)</title>", dom, re.DOTALL)
    assert title is not None
    return json.loads(html.unescape(title[1]))


def test_the_player_shows_any_instant_and_plays(
    tiny_run: Path, browse: Browse, change: Callable[..., None], change_json: Callable[..., None]
) -> None:
    change(tiny_run, "poses", y_m=lambda y_m: y_m - 1)  # beside the simulated robot
    change_json(tiny_run / "run.json", {"config.robot": {"length_m": 0.6, "width_m": 0.3}})
    say = _ask(write_report(tiny_run), browse)
    assert say["shown"]
    assert (say["first"], say["slid"]) == (0.0, 2.5)
    assert say["clock"] == "2.50 s of 3.98 s"
    assert say["heads"] == say["charts"] >= 10
    control = read_table(tiny_run, "control")
    worst_s = (control["t_ns"][control["error_m"].argmax()] - control["t_ns"][0]) / 1e9
    assert say["worst"] == pytest.approx(worst_s, abs=1e-3)
    assert say["keys"] == pytest.approx([0.0, 0.1, 1.1, 1.0, 3.98])
    assert say["label"] == "pause"
    assert say["played"] == pytest.approx(1.0, abs=0.01)
    assert say["faster"] == pytest.approx(2.0, abs=0.01)
    assert say["end"] == [3.98, "play"]
    assert say["clicked"] == pytest.approx(2.0, abs=0.05)
    # Target, logged robot, simulated robot, its plan, and the collision of that instant.
    for color in ("213,94,0", "0,114,178", "184,86,138", "0,133,95", "156,47,0"):
        assert say["inks"].get(color, 0) >= 10, color
    for window, shown in zip(load_maps(tiny_run), say["windows"], strict=True):
        assert shown["x"] == pytest.approx(window.origin_m[0], abs=1e-6)
        assert shown["cells"] == np.flatnonzero(window.occupied[::-1]).tolist()
    for name, pose in zip(("target", "poses", "control"), say["poses"], strict=True):
        table = read_table(tiny_run, name)
        row = int(np.abs(table["t_ns"] - table["t_ns"][0] - 2_000_000_000).argmin())
        assert (pose["x"], pose["y"]) == pytest.approx((table["x_m"][row], table["y_m"][row]), abs=1e-3)
        if name != "target":
            assert pose["yaw"] == pytest.approx(table["yaw_rad"][row], abs=1e-3)


@pytest.mark.parametrize(
    "gone", [("maps.npz", "control.parquet", "paths.parquet"), ("poses.parquet", "target.parquet")]
)
def test_a_partial_run_plays_what_there_is_under_the_policy(
    tiny_run: Path, browse: Browse, gone: tuple[str, ...]
) -> None:
    for name in gone:
        (tiny_run / name).unlink()
    page = write_report(tiny_run)
    dom, complaints = browse(page, "--dump-dom", "--window-size=390,900", "--virtual-time-budget=3000")
    assert complaints == []
    section = re.search(r'<section class="player"[^>]*>', dom)
    assert section is not None
    assert 'data-seconds="0.000"' in section[0]
    assert "hidden" not in section[0]


def test_a_hostile_cause_stays_text(tiny_run: Path, browse: Browse, change: Callable[..., None]) -> None:
    hostile = "</script><img src=x onerror=\"document.title = 'owned'\">"
    change(tiny_run, "contacts", cause=[hostile, hostile])
    dom, complaints = browse(write_report(tiny_run), "--dump-dom", "--virtual-time-budget=2000")
    assert complaints == []
    assert "<title>owned" not in dom
    assert dom.count("collision: &lt;/script&gt;&lt;img src=x") == 2
