from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pandas as pd
import pytest

from quadlog.results.export import EXPORTERS
from tests.lab.runs import unfinish


def test_every_format_is_written_where_asked_and_listed(follow, tmp_path, ok):
    for to, output in [("tum", "a.tum"), ("csv", "tables"), ("rosmap", "map"), ("mcap", "a.mcap")]:
        listed = [Path(line) for line in ok("export", follow, "--to", to, "-o", tmp_path / output).splitlines()]
        assert listed
        assert all(path.is_file() for path in listed)
    assert (tmp_path / "a.tum").read_bytes() == (follow / "trajectory.tum").read_bytes()
    assert len(pd.read_csv(tmp_path / "tables" / "scans.csv")) == 5


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
    listed = ok("export", follow, "--to", "figures", "--format", "svg", "--width", "4in", "-o", out).splitlines()
    assert "trajectory.svg" in {Path(line).name for line in listed}
    assert all('width="288pt"' in Path(line).read_text()[:2000] for line in listed)
    assert "for  --to figures" in refused(2, "export", follow, "--to", "csv", "--format", "svg")


FORMATS = [to for to in EXPORTERS if to != "mp4" or shutil.which("ffmpeg")]


@pytest.mark.parametrize("to", FORMATS)
def test_without_an_output_the_result_is_named_after_the_run(follow, tmp_path, monkeypatch, ok, refused, to):
    monkeypatch.chdir(tmp_path)
    ok("export", follow, "--to", to)
    assert [path.name for path in tmp_path.iterdir()] == [f"follow-{EXPORTERS[to].suffix}"]
    assert "--force" in refused(1, "export", follow, "--to", to)
    ok("export", follow, "--to", to, "--force")


def test_what_is_no_run_is_refused_in_one_line(follow, tmp_path, refused):
    none, file = tmp_path / "none", tmp_path / "file"
    file.write_text("")
    for path, words in ((none, "no such folder"), (file, "is no folder"), (tmp_path, "")):
        export = ["export", path, "--to", "csv", "-o", tmp_path / "out"]
        for command in (export, ["diff", follow, path], ["report", path]):
            assert f"{path}: {words}" in refused(1, *command)


def test_files_beside_the_runs_are_skipped_wherever_they_stand(follow, tmp_path, quadlog, refused):
    """As `runs/*` of a shell gives them: sorted, the page and the summary between the run folders."""
    shutil.copytree(follow, tmp_path / "zebra")
    for name in ("report.html", "notes.txt"):
        (tmp_path / name).write_text("")
    given = sorted(tmp_path.iterdir())
    bounds = ["--expect", tmp_path / "bounds.toml"]
    skipped = f"skipped, not a run folder: {tmp_path / 'notes.txt'}, {tmp_path / 'report.html'}"
    for words in (["metrics", *given], ["check", *given, *bounds, "--write"], ["check", *given, *bounds]):
        done = quadlog(*words)
        assert (done.code, done.err.splitlines()[0]) == (0, skipped)
    assert quadlog("report", *given) == (0, f"{tmp_path / 'zebra' / 'report.html'}\n", f"{skipped}\n")
    for command in ("metrics", "report"):
        assert "notes.txt: is no folder" in refused(1, command, tmp_path / "notes.txt")


def test_a_run_that_is_not_finished_is_not_exported(follow, tmp_path, refused):
    half = shutil.copytree(follow, tmp_path / "half")
    unfinish(half)
    for to in EXPORTERS:
        assert "is no finished run" in refused(1, "export", half, "--to", to, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


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
