"""The page of two runs in a real browser: both where their tables have them, on one clock, under the policy."""

import html
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.pipelines.report import write_side_by_side
from quadlog.results.run.maps import MapsWriter, load_maps
from quadlog.results.run.tables import read_table

Browse = Callable[..., tuple[str, list[str]]]

PROBE = """
const ask = async () => {
  const say = {};
  const section = document.getElementById("player");
  const canvas = section.querySelector("canvas");
  for (let wait = 0; wait < 100 && !section.dataset.seconds; wait++) await new Promise((done) => setTimeout(done, 20));
  const data = JSON.parse(document.getElementById("player-data").textContent);
  const scene = await openScene(data);
  say.tracks = data.tracks.map((track) => ({ label: track.label, pose: scene.pose(track, 2.0) }));
  say.cells = data.windows.map((windows) => {
    const image = new ImageData(windows.columns, windows.rows);
    scene.paint(windows, scene.window(windows, 1.0), image);
    return [...new Uint32Array(image.data.buffer)].flatMap((cell, place) => (cell ? [place] : []));
  });
  section.querySelector('[data-part="slider"]').value = 1.85;
  section.querySelector('[data-part="slider"]').dispatchEvent(new Event("input"));
  const follow = section.querySelector('[data-part="follow"]');
  if (follow.getAttribute("aria-pressed") === "false") follow.click();
  for (let times = 0; times < 3; times++) section.querySelector('[data-part="nearer"]').click();
  const { data: pixels } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  say.inks = {};
  for (let at = 0; at < pixels.length; at += 4) {
    const color = pixels.slice(at, at + 3).join();
    say.inks[color] = (say.inks[color] ?? 0) + 1;
  }
  document.querySelector("table [data-seek]").click();
  say.sought = Number(section.dataset.seconds);
  const chart = document.querySelector('[data-chart="displacement"]');
  say.legend = [...chart.querySelectorAll(".u-label")].map((each) => each.textContent);
  say.panels = [...chart.querySelectorAll(".what")].map((each) => each.textContent);
  say.same = document.querySelector('[data-chart="ranges"] .what').textContent;
  say.figures = [...document.querySelectorAll("figure")].map((each) => each.id);
  say.wide = document.documentElement.scrollWidth - innerWidth;
  document.title = JSON.stringify(say);
};
setTimeout(ask, 100);
"""


@pytest.fixture
def page(tiny_original: Path, tmp_path: Path, change: Callable[..., None], change_json: Callable[..., None]) -> Path:
    """The tiny run, and one whose robot was simulated half a metre beside it, on other maps, from 0.4 s on."""
    a, b = (shutil.copytree(tiny_original, tmp_path / name) for name in "ab")
    for run in (a, b):
        change_json(run / "run.json", {"config.robot": {"length_m": 0.6, "width_m": 0.3}})
    change(b, "control", y_m=lambda y_m: y_m - 0.5 * (np.arange(200) >= 20))
    with MapsWriter(b / "maps.npz", 0.1, (60, 50)) as maps:
        for window in load_maps(a):
            maps.append(window.t_ns, window.origin_m, window.occupied[::-1])
    return write_side_by_side(a, b, tmp_path / "page.html", force=False)


def _ask(page: Path, browse: Browse) -> dict[str, Any]:
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text())
    probed = page.with_name("probed.html")
    probed.write_text(text.replace("</body>", f"<script>{PROBE}</script></body>"))
    dom, complaints = browse(probed, "--dump-dom", "--window-size=390,900", "--virtual-time-budget=6000")
    assert complaints == []
    title = re.search(r"<title>(.*?)</title>", dom, re.DOTALL)
    assert title is not None
    return json.loads(html.unescape(title[1]))


def test_both_runs_are_in_one_player_and_in_every_chart(page: Path, browse: Browse) -> None:
    say = _ask(page, browse)
    tracks = {each["label"]: each["pose"] for each in say["tracks"]}
    assert list(tracks) == [
        *("A and B: target", "A and B: logged robot", "A: re-simulated robot", "B: re-simulated robot"),
    ]
    for label, run in (("A: re-simulated robot", "a"), ("B: re-simulated robot", "b")):
        table = read_table(page.parent / run, "control")
        row = int(np.abs(table["t_ns"] - table["t_ns"][0] - 2_000_000_000).argmin())
        assert (tracks[label]["x"], tracks[label]["y"]) == pytest.approx(
            (table["x_m"][row], table["y_m"][row]), abs=2e-3
        )
    for run, cells in zip("ab", say["cells"], strict=True):
        (window,) = [each for k, each in enumerate(load_maps(page.parent / run)) if k == 10]
        assert cells == np.flatnonzero(window.occupied[::-1]).tolist()
    for color in ("0,114,178", "213,94,0"):  # of A and of B
        assert say["inks"].get(color, 0) >= 30, color
    assert say["sought"] == 0.0  # of the maps, which differ first
    assert say["panels"] == ["from A to B (m)", "x, forward (m): the same in A and B", "y, to the left (m)"]
    assert say["legend"].count("A") == say["legend"].count("B") == 1
    assert say["same"].endswith("the same in A and B")
    assert say["figures"].index("chart-displacement") < say["figures"].index("chart-ranges")
    assert say["wide"] <= 0


def test_the_page_runs_under_its_policy(page: Path, browse: Browse) -> None:
    dom, complaints = browse(page, "--dump-dom", "--window-size=1280,900", "--virtual-time-budget=3000")
    assert complaints == []
    section = re.search(r'<section class="player"[^>]*>', dom)
    assert section is not None
    assert 'data-seconds="0.000"' in section[0]
    assert dom.count("u-wrap") >= 10


def test_a_walk_along_a_course_beside_a_replay_plays_both(tiny_original: Path, tiny_walk: Path, browse: Browse) -> None:
    page = write_side_by_side(tiny_original, tiny_walk, tiny_walk.parent / "page.html", force=False)
    assert "B is a simulated walk and A the replay of a recording" in page.read_text()
    dom, complaints = browse(page, "--dump-dom", "--virtual-time-budget=3000")
    assert complaints == []
    assert 'data-seconds="0.000"' in dom
    assert "B: simulated robot" in dom
