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

from quadlog.cli.main import run

FIXTURES = Path(__file__).parents[2] / "fixtures"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("out") / "runs"
    arguments = [str(FIXTURES / "follow.mcap"), "-c", str(FIXTURES / "follow.toml"), "-o", str(folder)]
    assert run(["replay", *arguments, "--until", "map", "--duration", "0.5"]) == 0
    return folder


def test_every_format_is_written_where_asked_and_listed(runs, tmp_path, capsys):
    for to, output in [("tum", "a.tum"), ("csv", "tables"), ("rosmap", "map"), ("mcap", "a.mcap")]:
        capsys.readouterr()
        assert run(["export", str(runs / "follow"), "--to", to, "-o", str(tmp_path / output)]) == 0
        listed = [Path(line) for line in capsys.readouterr().out.splitlines()]
        assert listed
        assert all(path.is_file() for path in listed)
    assert (tmp_path / "a.tum").read_bytes() == (runs / "follow" / "trajectory.tum").read_bytes()
    assert len(pd.read_csv(tmp_path / "tables" / "scans.csv")) == 5


def test_evo_ape_reads_the_trajectory_and_finds_the_same_error(runs, tmp_path):
    out, result = tmp_path / "follow.tum", tmp_path / "evo.zip"
    assert run(["export", str(runs / "follow"), "--to", "tum", "-o", str(out)]) == 0
    truth = runs / "follow" / "reference.tum"
    evo_ape = [
        str(Path(sys.executable).with_name("evo_ape")),
        "tum",
        str(truth),
        str(out),
        "--save_results",
        str(result),
    ]
    # evo keeps its settings at home.
    subprocess.run(evo_ape, check=True, capture_output=True, env={**os.environ, "HOME": str(tmp_path)})
    ours = json.loads((runs / "follow" / "metrics.json").read_text())["ate_rmse_m"]
    with zipfile.ZipFile(result) as archive:
        theirs = json.loads(archive.read("stats.json"))
    assert ours["value"] == pytest.approx(theirs["rmse"], abs=1e-9)
    assert theirs["rmse"] > 0


def test_without_an_output_the_file_bears_the_runs_name(runs, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(["export", str(runs / "follow"), "--to", "tum"]) == 0
    assert (tmp_path / "follow-trajectory.tum").is_file()
    assert run(["export", str(runs / "follow"), "--to", "tum"]) == 1
    assert "--force" in capsys.readouterr().err
    assert run(["export", str(runs / "follow"), "--to", "tum", "--force"]) == 0


def test_what_is_no_run_is_refused_in_one_line(tmp_path, capsys):
    assert run(["export", str(tmp_path), "--to", "csv", "-o", str(tmp_path / "out")]) == 1
    assert run(["report", str(tmp_path)]) == 1
    assert capsys.readouterr().err.count("\n") == 2


def test_what_does_not_exist_is_said_not_to(runs, tmp_path, capsys):
    none, file = tmp_path / "none", tmp_path / "file"
    file.write_text("")
    for path, words in ((none, "no such folder"), (file, "is no folder")):
        assert run(["export", str(path), "--to", "csv", "-o", str(tmp_path / "out")]) == 1
        assert run(["diff", str(runs / "follow"), str(path)]) == 1
        assert run(["report", str(path)]) == 1
        assert capsys.readouterr().err == f"quadlog: {path}: {words}\n" * 3


def test_files_beside_the_runs_are_skipped_wherever_they_stand(runs, tmp_path, capsys):
    """As `runs/*` of a shell gives them: sorted, the page and the summary between the run folders."""
    shutil.copytree(runs / "follow", tmp_path / "zebra")
    for name in ("report.html", "notes.txt"):
        (tmp_path / name).write_text("")
    given = [str(path) for path in sorted(tmp_path.iterdir())]
    bounds = ["--expect", str(tmp_path / "bounds.toml")]
    for words in (["metrics", *given], ["check", *given, *bounds, "--write"], ["check", *given, *bounds]):
        assert run(words) == 0, words
        skipped = f"skipped, not a run folder: {tmp_path / 'notes.txt'}, {tmp_path / 'report.html'}"
        assert capsys.readouterr().err.splitlines()[0] == skipped
    assert run(["report", *given]) == 0
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == (f"{tmp_path / 'zebra' / 'report.html'}\n", f"{skipped}\n")
    for command in ("metrics", "report"):
        assert run([command, str(tmp_path / "notes.txt")]) == 1
        assert "notes.txt: is no folder" in capsys.readouterr().err


@pytest.mark.parametrize("to", ["tum", "csv", "rosmap", "mcap"])
def test_a_run_that_is_not_finished_is_not_exported(runs, to, tmp_path, capsys):
    half = shutil.copytree(runs / "follow", tmp_path / "half")
    (half / "run.json").unlink()
    assert run(["export", str(half), "--to", to, "-o", str(tmp_path / "out")]) == 1
    assert "is no finished run" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_report_draws_the_same_pages_again(runs, capsys):
    page = runs / "follow" / "report.html"
    folder_page = (runs / "report.html").read_bytes()
    plot = next((runs / "follow" / "plots").iterdir())
    before = plot.read_bytes()
    plot.unlink()
    assert run(["report", str(runs / "follow"), str(runs)]) == 0
    assert capsys.readouterr().out.splitlines() == [str(page), str(runs / "report.html")]
    assert plot.read_bytes() == before
    assert (runs / "report.html").read_bytes() == folder_page
