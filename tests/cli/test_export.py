from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from quadlog.results.export import EXPORTERS
from quadlog.results.view import COLORS
from tests.lab.runs import change


def test_figures_for_a_paper_have_the_format_the_size_and_the_names_that_were_asked_for(follow, tmp_path, ok, refused):
    out, figures = tmp_path / "figures", ("export", follow, "--to", "figures")
    assert "is no length between" in refused(2, *figures, "--width", "30cm3")
    assert "choose one of: " in refused(1, *figures, "--only", "trajectories")
    listed = ok(*figures, "--format", "svg", "--width", "4in", "--font", "serif", "-o", out).splitlines()
    assert {"trajectory.svg", "error_map.svg"} <= {Path(line).name for line in listed}
    assert all('width="288pt"' in Path(line).read_text()[:2000] for line in listed)
    (low,) = ok(*figures, "--only", "uwb_error", "--format", "svg", "--height", "2in", "-o", tmp_path).splitlines()
    assert 'height="144pt"' in Path(low).read_text()[:2000]
    assert "for  --to figures" in refused(2, "export", follow, "--to", "csv", "--format", "svg")


def test_several_runs_are_one_figure_of_what_differs(follow, tmp_path, ok, refused):
    for name in ("a", "b"):
        shutil.copytree(follow, tmp_path / "runs" / name)
    change(tmp_path / "runs" / "b", "poses", x_m=lambda x_m: x_m + 0.1)
    pair = ("export", tmp_path / "runs" / "a", tmp_path / "runs" / "b", "--to")
    assert "takes one RUN" in refused(2, *pair, "tum")
    for sources in (pair, ("export", tmp_path / "runs", "--to")):
        listed = ok(*sources, "figures", "--format", "svg", "-o", tmp_path / "out", "--force").splitlines()
        named = {Path(path).stem: Path(path) for path in listed}
        assert {"trajectory", "place"} <= set(named) <= {"trajectory", "place", "motion"}
        drawn = named["trajectory"].read_text().upper()
        assert all(f"STROKE: {COLORS[color].upper()}" in drawn for color in ("robot", "target", "soft"))


FORMATS = [to for to in EXPORTERS if (to != "mp4" or shutil.which("ffmpeg"))]


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
