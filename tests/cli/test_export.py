from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from quadlog.results.export import EXPORTERS


def test_evo_ape_reads_the_trajectory_and_finds_the_same_error(follow, tmp_path, ok):
    out, result, truth = tmp_path / "follow.tum", tmp_path / "evo.zip", follow / "reference.tum"
    ok("export", follow, "--to", "tum", "-o", out)
    evo_ape = [Path(sys.executable).with_name("evo_ape"), "tum", truth, out, "--save_results", result]
    # evo keeps its settings at home.
    environment = {**os.environ, "HOME": str(tmp_path)}
    subprocess.run([*map(str, evo_ape)], check=True, capture_output=True, env=environment)
    with zipfile.ZipFile(result) as archive:
        theirs = json.loads(archive.read("stats.json"))
    ours = json.loads((follow / "metrics.json").read_text())["ate_rmse_m"]
    assert ours["value"] == pytest.approx(theirs["rmse"], abs=1e-9)
    assert theirs["rmse"] > 0


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
    assert all(Path(line).is_file() for line in listed)
    assert [path.name for path in tmp_path.iterdir()] == [f"follow-{EXPORTERS[to].suffix}"]
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
