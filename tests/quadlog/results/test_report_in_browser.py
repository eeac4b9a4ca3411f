"""Both pages in a real browser: they render, the policy blocks nothing of ours, and sorting sorts."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from quadlog.results.page.folder_report import write_folder_report
from quadlog.results.page.report import write_report
from quadlog.results.run.tables import TABLES, write_table


def _click_first(page: Path, header: str) -> Path:
    """A copy without the policy, with a click on a column's name in it."""
    text = page.read_text()
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text)
    click = f"[...document.querySelectorAll('th button')].find((b) => b.textContent === '{header}').click();"
    clicked = page.with_name("clicked.html")
    clicked.write_text(text.replace("</body>", f"<script>{click}</script></body>"))
    return clicked


def test_the_report_renders_without_a_complaint(tiny_run: Path, browse: Callable[..., tuple[str, list[str]]]) -> None:
    picture = tiny_run / "shot.png"
    _, complaints = browse(write_report(tiny_run), "--window-size=1000,1400", f"--screenshot={picture}")
    assert complaints == []
    shot = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    assert shot.shape == (1400, 1000, 3)
    # The box of losses is tinted by the style sheet: without it, or with it blocked, the page is black on white.
    tint = np.abs(shot - np.array([0xFD, 0xEA, 0xE2])).max(axis=2) <= 1
    assert tint.sum() > 10_000


def test_the_policy_blocks_what_is_not_ours(tiny_run: Path, browse: Callable[..., tuple[str, list[str]]]) -> None:
    for table in [*tiny_run.glob("*.parquet"), *tiny_run.glob("*.npz")]:
        table.unlink()  # the pictures play no part
    page = write_report(tiny_run)
    text = page.read_text().replace("</body>", "<script>document.title = 'owned';</script></body>")
    page.write_text(text)
    dom, complaints = browse(page, "--dump-dom")
    assert "<title>owned" not in dom
    assert any("Content Security Policy" in line for line in complaints)


def test_a_click_sorts_the_folder(tmp_path: Path, browse: Callable[..., tuple[str, list[str]]]) -> None:
    names, eta_m = ["b", "a", "c", "d"], [10.0, np.nan, 9.0, 0.5]
    columns = {"recording": names, "exit_code": [0, 1, 0, 0], "reason": ["", "broken", "", ""], "eta_m": eta_m}
    write_table(tmp_path / "summary.parquet", TABLES["summary"], columns)
    page = write_folder_report(tmp_path)
    assert browse(page, "--dump-dom")[1] == []

    def order(header: str) -> str:
        dom, complaints = browse(_click_first(page, header), "--dump-dom")
        assert complaints == []
        return "".join(re.findall(r'<th scope="row" data-value="(.)"', dom))

    assert order("eta_m") == "dcba"
    assert order("recording") == "abcd"


def test_a_folder_of_walks_sorts_above_its_mean(tmp_path: Path, browse: Callable[..., tuple[str, list[str]]]) -> None:
    for name in "abc":
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").write_text('{"options": {"course": "line"}}')
    columns = {"recording": list("abc"), "exit_code": [0] * 3, "reason": ["", "fell", ""], "eta_m": [10.0, 9.0, 0.5]}
    write_table(tmp_path / "summary.parquet", TABLES["summary"], columns)
    dom, complaints = browse(_click_first(write_folder_report(tmp_path), "eta_m"), "--dump-dom")
    assert complaints == []
    assert "".join(re.findall(r'<th scope="row"[^>]*>(\w+)</th>', dom)) == "cbameanstd"


@pytest.mark.parametrize("width_px", [390, 1000])
def test_a_simulated_walk_fits_its_window(
    tiny_walk: Path, browse: Callable[..., tuple[str, list[str]]], width_px: int
) -> None:
    page = write_report(tiny_walk)
    flags = ("--blink-settings=preferredColorScheme=0", "--hide-scrollbars", f"--window-size={width_px},6000")
    _, complaints = browse(page, *flags, f"--screenshot={tiny_walk / 'shot.png'}")
    assert complaints == []
    shot = np.asarray(Image.open(tiny_walk / "shot.png").convert("RGB")).astype(int)
    # Dark throughout, and nothing is so wide that it reaches the right edge.
    assert (np.abs(shot[:, -4:] - np.array([0x14, 0x17, 0x1B])).max(axis=2) <= 2).all()
    assert "Simulated by quadlog" in page.read_text()
