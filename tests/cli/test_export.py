from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from quadlog.results.export import EXPORTERS


def test_figures_for_a_paper_have_the_format_and_the_width_that_were_asked_for(follow, tmp_path, ok, refused):
    out = tmp_path / "figures"
    assert "is no width between" in refused(2, "export", follow, "--to", "figures", "--width", "30cm3")
    listed = ok("export", follow, "--to", "figures", "--format", "svg", "--width", "4in", "-o", out).splitlines()
    assert "trajectory.svg" in {Path(line).name for line in listed}
    assert all('width="288pt"' in Path(line).read_text()[:2000] for line in listed)
    assert "for  --to figures" in refused(2, "export", follow, "--to", "csv", "--format", "svg")


FORMATS = [to for to in EXPORTERS if to != "figures" and (to != "mp4" or shutil.which("ffmpeg"))]


@pytest.mark.parametrize("to", FORMATS)
def test_without_an_output_the_result_is_named_after_the_run(follow, tmp_path, monkeypatch, ok, refused, to):
    monkeypatch.chdir(tmp_path)
    listed = ok("export", follow, "--to", to).splitlines()
    assert listed
    for path in map(Path, listed):
        saved = {"tum": "trajectory.tum", "mcap": "derived.mcap"}.get(to, path.name)
        assert path.is_file() if to in ("csv", "gif", "mp4") else path.read_bytes() == (follow / saved).read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == [f"follow-{EXPORTERS[to][1]}"]
    assert "--force" in refused(1, "export", follow, "--to", to)
    ok("export", follow, "--to", to, "--force")


def test_report_draws_the_same_pages_again(follow, tmp_path, ok):
    runs = shutil.copytree(follow.parent, tmp_path / "runs")
    page, folder_page = runs / "follow" / "report.html", runs / "report.html"
    before = page.read_bytes(), folder_page.read_bytes()
    plot = next((runs / "follow" / "plots").iterdir())
    drawn = plot.read_bytes()
    plot.unlink()
    assert ok("report", runs / "follow", runs).splitlines() == [str(page), str(folder_page)]
    assert (page.read_bytes(), folder_page.read_bytes()) == before
    assert plot.read_bytes() == drawn
