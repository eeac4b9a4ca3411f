from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from quadlog.cli.main import run as run_cli
from quadlog.results import find_runs as find_runs_module
from quadlog.results.find_runs import RECORDS, failed_recordings, find_runs, run_labels, run_name, run_names
from quadlog.results.tables import TABLES, write_table
from tests.lab.runs import begin_run


def make_run(path: Path) -> Path:
    return begin_run(path).path


def test_a_folder_stands_for_the_runs_in_it_and_a_link_for_its_run(tmp_path: Path) -> None:
    runs = [make_run(tmp_path / name) for name in ("b", "a", "line-fpmw/seed-000", "line-fpmw/seed-001")]
    (tmp_path / "notes").mkdir()
    (tmp_path / "report.html").write_text("")
    make_run(tmp_path / ".hidden")
    make_run(runs[0] / "copy")
    make_run(tmp_path / "deeper" / "than" / "three" / "folders")
    assert find_runs([tmp_path]) == [runs[1], runs[0], *runs[2:]]
    (tmp_path / "loop").symlink_to(tmp_path)
    assert find_runs([runs[2], tmp_path]) == [runs[2], runs[1], runs[0], runs[3]]
    link = tmp_path / "notes" / "fast"
    link.symlink_to(runs[0])
    assert find_runs([link.parent]) == [link]
    assert find_runs([runs[0], link]) == [runs[0]]


PARTS = st.lists(st.sampled_from("abc"), min_size=1, max_size=4).map(tuple)


@given(st.lists(PARTS, min_size=2, max_size=8, unique=True))
def test_labels_tell_all_runs_apart(parts: list[tuple[str, ...]]) -> None:
    labels = run_labels([Path("/", *each) for each in parts])
    assert len(set(labels)) == len(labels)
    assert run_labels([Path("sim/line/a"), Path("sim/circle/a")]) == ["line/a", "circle/a"]
    assert all(f"/{'/'.join(each)}".endswith(f"/{label}") for each, label in zip(parts, labels, strict=True))


def write_summary(folder: Path, codes: Mapping[str, int]) -> None:
    columns: dict[str, Any] = dict.fromkeys(TABLES["summary"].names, np.nan)
    columns |= {"recording": list(codes), "exit_code": list(codes.values()), "reason": "no bag", "worker": ""}
    write_table(folder / "summary.parquet", TABLES["summary"], columns)


def test_those_without_a_run_are_told_with_their_reason(tiny_run: Path, tmp_path: Path) -> None:
    season = tmp_path / "season"
    shutil.copytree(tiny_run, season / "walk")
    write_summary(season, {"walk": 1, "broken": 1, "lossy": 3, "fine": 0, "../outside": 1})
    assert failed_recordings([season]) == {season / "broken": f"{season / 'broken'}: was not replayed: no bag"}
    assert failed_recordings([season / "walk"]) == {}  # its last replay failed, and harmed no earlier run
    (season / "summary.parquet").write_bytes(b"mine")
    assert failed_recordings([season, tmp_path]) == {}


@given(st.text())
@example("../../etc/passwd")
@example("-rf")
@example(" -rf")
@example("C:\\x\n")
@example("report.html")
@example("é" * 200)
def test_any_name_stays_one_folder_below(name: str) -> None:
    safe = run_name(name)
    assert safe.isprintable() or not name.isprintable()
    assert safe not in ("", "report.html", "summary.parquet")
    assert Path("runs", safe).parent == Path("runs")
    assert Path("/runs", safe).resolve().parent == Path("/runs")
    assert len(safe.encode()) <= 121
    assert not safe.startswith((".", "-"))


@given(st.lists(st.text(st.sampled_from("aA.b/-"), min_size=1), max_size=12))
@example(["a/walk.mcap", "a/walk.bag", "a/run.mcap", "b/Run.mcap", "c/run.mcap", "d/alone.db3"])
def test_no_two_recordings_share_a_folder_and_the_extension_tells_them_apart_first(stems: list[str]) -> None:
    names = run_names(list(map(Path, stems)))
    assert len({name.casefold() for name in names}) == len(stems)
    if "d/alone.db3" in stems:
        assert names == ["walk.mcap", "walk.bag", "run.mcap", "Run.mcap-2", "run.mcap-3", "alone"]


PLANNED = {"run.json", "config.toml", "maps.npz", "poses.parquet", "pose_uncertainty.parquet", "target.parquet"}


@pytest.mark.parametrize(
    ("command", "copied"),
    [
        (["export", "--to", "tum"], {"run.json", "trajectory.tum"}),
        (["export", "--to", "rosmap"], {"run.json", "map.pgm", "map.yaml"}),
        (["compare-planners", "--planner", "astar"], PLANNED),
        (["metrics"], RECORDS),
    ],
)
def test_a_command_copies_only_the_files_that_it_reads(
    tiny_run: Path, tmp_path: Path, bucket: Any, monkeypatch: pytest.MonkeyPatch, command: list[str], copied: set[str]
) -> None:
    for path in tiny_run.iterdir():
        bucket.put_file(str(path), f"{bucket.name}/runs/walk/{path.name}")
    copy_object, names = find_runs_module.copy_object, set[str]()
    monkeypatch.setattr(
        find_runs_module, "copy_object", lambda remote, to: (names.add(to.name), copy_object(remote, to))
    )
    monkeypatch.chdir(tmp_path)
    assert run_cli([command[0], f"s3://{bucket.name}/runs/walk", *command[1:]]) == 0
    assert names == copied
