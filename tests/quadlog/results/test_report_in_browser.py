"""Both pages in a real browser: they render, the policy blocks nothing of ours, and sorting sorts."""

import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from quadlog.results.folder_report import write_folder_report
from quadlog.results.report import write_report
from quadlog.results.schemas import TABLES
from quadlog.results.tables import write_table

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
]


@pytest.fixture
def browse(tmp_path: Path) -> Callable[..., tuple[str, list[str]]]:
    """Opens a page with more flags; gives the DOM and the console's lines."""
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    chromium = next((found for name in names if (found := shutil.which(name))), None)
    if chromium is None:
        pytest.skip("no Chromium is installed, so the report is not tried in a browser")

    def open_page(page: Path, *flags: str) -> tuple[str, list[str]]:
        command = [chromium, *FLAGS, f"--user-data-dir={tmp_path / 'profile'}", *flags, page.resolve().as_uri()]
        quiet = {**os.environ, "HOME": str(tmp_path)}
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True, env=quiet)
        return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]

    return open_page


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
