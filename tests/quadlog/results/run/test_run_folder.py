from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.errors import AlreadyExists, CannotWrite, NotARun, UnknownRunFormat
from quadlog.results import read_metrics, read_run_json
from quadlog.results.run.names import OWN_FILES
from quadlog.results.run.record import RUN_FORMAT, RunRecord
from quadlog.results.run.run_folder import RunFolder, read_sound_metrics
from quadlog.storage.atomic_write import part_prefix


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


def test_the_same_run_has_the_same_bytes(write_run: Callable[[Path], Path], tmp_path: Path) -> None:
    one, other = content(write_run(tmp_path / "a")), content(write_run(tmp_path / "b"))
    assert one == other
    of_some_logs = {"reference.tum", "joints.parquet", "other_poses.parquet", "body.parquet", "gait.parquet"}
    assert set(one) == OWN_FILES - {"report.html", "stages.json"} - of_some_logs


def test_an_existing_run_needs_a_flag(tiny_run: Path) -> None:
    before = content(tiny_run)
    with pytest.raises(AlreadyExists, match=r"--force.*--resume"):
        RunFolder.create(tiny_run)
    assert content(tiny_run) == before


def test_force_removes_what_is_ours_and_nothing_else(tiny_run: Path, left_part: str) -> None:
    (tiny_run / "plots").mkdir()
    (tiny_run / "plots" / "ranges.png").write_bytes(b"")
    (tiny_run / "plots" / left_part).write_bytes(b"")
    (tiny_run / "plots" / "mine.svg").write_bytes(b"drawn by hand")
    (tiny_run / "notes.md").write_bytes(b"precious")
    (tiny_run / "mine").mkdir()
    (tiny_run / "mine" / "run.json").write_bytes(b"precious too")
    (tiny_run / left_part).write_bytes(b"left by a kill")
    RunFolder.create(tiny_run, force=True)
    assert sorted([each.name for each in tiny_run.iterdir()]) == ["mine", "notes.md", "plots"]
    assert [each.name for each in (tiny_run / "plots").iterdir()] == ["mine.svg"]
    assert (tiny_run / "mine" / "run.json").read_bytes() == b"precious too"


def test_a_killed_run_can_be_taken_over(tmp_path: Path, left_part: str) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / left_part).write_bytes(b"killed before anything was whole")
    folder = RunFolder.create(tmp_path / "run")
    assert [each.name for each in (tmp_path / "run").iterdir()] == []
    folder.write_config({"planner": {"name": "astar"}})
    with pytest.raises(AlreadyExists):
        RunFolder.create(tmp_path / "run")
    RunFolder.create(tmp_path / "run", force=True)
    assert [each.name for each in (tmp_path / "run").iterdir()] == []


@pytest.mark.parametrize("name", ["notes.md", "config.toml", "run.json", "map.pgm", "poses.parquet"])
@pytest.mark.parametrize("flags", [{}, {"force": True}])
def test_a_folder_of_something_else_is_never_touched(tmp_path: Path, name: str, flags: dict[str, bool]) -> None:
    (tmp_path / name).write_bytes(b'{"name": "not ours"}')
    (tmp_path / ".quadlog-1-0.part").write_bytes(b"")
    with pytest.raises(CannotWrite, match="holds other files and is no run of quadlog"):
        RunFolder.create(tmp_path, **flags)
    assert sorted([each.name for each in tmp_path.iterdir()]) == sorted([".quadlog-1-0.part", name])


def test_nothing_behind_a_link_is_removed(tiny_run: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "picture.png").write_bytes(b"precious")
    (outside / "map.yaml").write_bytes(b"precious")
    (tiny_run / "plots").symlink_to(outside)
    (tiny_run / "map.yaml").unlink()
    (tiny_run / "map.yaml").symlink_to(outside / "map.yaml")
    link = tmp_path / "link"
    link.symlink_to(tiny_run)
    before = content(tiny_run.with_name("outside"))
    with pytest.raises(CannotWrite, match="symbolic link"):
        RunFolder.create(link, force=True)
    assert (tiny_run / "run.json").exists()
    RunFolder.create(tiny_run, force=True)
    assert [each.name for each in tiny_run.iterdir()] == []
    assert content(outside) == before


def test_a_file_in_the_way_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "run").write_bytes(b"")
    with pytest.raises(CannotWrite, match="File exists"):
        RunFolder.create(tmp_path / "run", force=True)
    with pytest.raises(CannotWrite, match="Not a directory"):
        RunFolder.create(tmp_path / "run" / "deeper")


def test_the_config_is_toml_without_nothings(tiny_run: Path) -> None:
    config = tomllib.loads((tiny_run / "config.toml").read_text())
    assert config["uwb"] == {"tag_height_m": 0.6, "anchors": [{"id": 0, "x_m": 0.0, "y_m": 5.0}]}


def test_metrics_that_do_not_apply_are_absent(tiny_run: Path) -> None:
    assert read_metrics(tiny_run) == {
        "eta_m": {"value": 0.123, "n": 200, "unit": "m"},
        "fallen": {"value": 0, "n": 1, "unit": ""},
    }


def test_only_the_same_run_is_finished(tiny_run: Path, tiny_record: RunRecord) -> None:
    folder = RunFolder(tiny_run)
    sha, config, options = "ab" * 32, tiny_record.config, tiny_record.options
    assert folder.is_finished(sha, config, "0.1.0", options)
    assert not folder.is_finished("cd" * 32, config, "0.1.0", options)
    assert not folder.is_finished(sha, {**config, "grid": {}}, "0.1.0", options)
    assert not folder.is_finished(sha, config, "0.2.0", options)
    assert not folder.is_finished(sha, config, "0.1.0", {**options, "until": "map"})
    (tiny_run / "run.json").unlink()
    assert not folder.is_finished(sha, config, "0.1.0", options)


def test_tuples_and_numpy_numbers_compare_as_json_does(tiny_run: Path, tiny_record: RunRecord) -> None:
    record = replace(tiny_record, config={"a": (1, np.float64(0.1)), "p": Path("x")})
    RunFolder(tiny_run).write_run_json(record)
    assert RunFolder(tiny_run).is_finished("ab" * 32, {"a": [1, 0.1], "p": "x"}, "0.1.0", record.options)


@pytest.mark.parametrize("damage", [b"", b"{", b"[]", b"\xff\xfe", b"[" * 100_000])
@pytest.mark.parametrize(("name", "read"), [("run.json", read_run_json), ("metrics.json", read_metrics)])
def test_damaged_json_is_no_run(tiny_run: Path, name: str, read: Any, damage: bytes) -> None:
    (tiny_run / name).write_bytes(damage)
    with pytest.raises(NotARun, match=rf"{name}: is damaged"):
        read(tiny_run)
    (tiny_run / name).unlink()
    with pytest.raises(NotARun, match=rf"no {name}"):
        read(tiny_run)


@pytest.mark.parametrize("found", [2, 0, -1, "1", 1.0, True, None, [1] * 1000])
def test_a_run_of_another_format_is_refused_by_name(tiny_run: Path, tiny_record: RunRecord, found: object) -> None:
    record = json.loads((tiny_run / "run.json").read_bytes())
    assert record["run_format"] == RUN_FORMAT == 1
    (tiny_run / "run.json").write_text(json.dumps(record | {"run_format": found, "quadlog_version": "9.8.7"}))
    with pytest.raises(
        UnknownRunFormat, match=r"walk: is a run of format .*by quadlog 9\.8\.7; this .* reads format 1"
    ) as told:
        read_run_json(tiny_run)
    assert len(str(told.value)) < 400
    assert not RunFolder(tiny_run).is_finished("ab" * 32, tiny_record.config, "0.1.0", tiny_record.options)
    with pytest.raises(AlreadyExists):
        RunFolder.create(tiny_run)
    (tiny_run / "config.toml").unlink()  # whose it is, run.json says as well
    RunFolder.create(tiny_run, force=True)
    assert not (tiny_run / "run.json").exists()


def test_a_run_from_before_formats_were_counted_is_read(tiny_run: Path) -> None:
    record = json.loads((tiny_run / "run.json").read_bytes())
    del record["run_format"]
    (tiny_run / "run.json").write_text(json.dumps(record))
    assert read_run_json(tiny_run) == record


@pytest.mark.parametrize(
    "number", ["1" + "0" * 400, "1" * 5000, str(2**64), str(-(2**63) - 1), "1e999", "Infinity", "NaN"]
)
def test_a_number_out_of_range_damages_a_record(tiny_run: Path, number: str) -> None:
    record = json.loads((tiny_run / "run.json").read_bytes()) | {"config": {"grid": {"cell_m": "NUMBER"}}}
    (tiny_run / "run.json").write_text(json.dumps(record).replace('"NUMBER"', number))
    with pytest.raises(NotARun, match=r"run\.json: is damaged: .*(too large a number|no finite number)") as raised:
        read_run_json(tiny_run)
    assert len(str(raised.value)) < 400


def test_sound_metrics_are_had_beside_damaged_ones(tiny_run: Path) -> None:
    odd = '{"value": %s, "n": %s, "unit": %s}'
    bad = [
        ('"x"', 1, '""'),
        ("NaN", 1, '"m"'),
        ("1" * 400, 1, '"m"'),
        ("true", 1, '""'),
        (1, -1, '""'),
        (1, 1.5, '""'),
        (1, 1, "3"),
    ]
    entries = [f'"bad{i}": {odd % each}' for i, each in enumerate(bad)] + ['"eta_m": {"value": 2, "n": 5, "unit": "m"}']
    entries += ['"scalar": 3', '"without": {"n": 1}']
    (tiny_run / "metrics.json").write_text(f"{{{', '.join(entries)}}}")
    metrics, damaged = read_sound_metrics(tiny_run)
    assert metrics == {"eta_m": {"value": 2, "n": 5, "unit": "m"}}
    assert damaged == [*(f"bad{i}" for i in range(len(bad))), "scalar", "without"]
    with pytest.raises(NotARun, match="bad0 has no value"):
        read_metrics(tiny_run)


def test_run_json_holds_no_nan(tiny_run: Path, tiny_record: RunRecord) -> None:
    with pytest.raises(ValueError, match="JSON"):
        RunFolder(tiny_run).write_run_json(replace(tiny_record, recorded_s=float("nan")))
    assert json.loads((tiny_run / "run.json").read_bytes())["recorded_s"] == 4.0


def test_a_claimed_run_loses_nothing_until_it_is_begun(tiny_run: Path, left_part: str) -> None:
    (tiny_run / left_part).write_bytes(b"left by a kill")
    (tiny_run / "plots").mkdir()
    (tiny_run / "plots" / "ranges.png").write_bytes(b"")
    with pytest.raises(AlreadyExists):
        RunFolder.claim(tiny_run)
    before = {name: data for name, data in content(tiny_run).items() if name != left_part}
    folder = RunFolder.claim(tiny_run, replace=True)
    assert content(tiny_run) == before
    folder.begin({"planner": {"name": "astar"}}, keep=("poses.parquet", "stages.json"))
    assert sorted(content(tiny_run)) == ["config.toml", "poses.parquet"]
    assert not (tiny_run / "plots").exists()
    assert (tiny_run / "poses.parquet").read_bytes() == before["poses.parquet"]
    assert tomllib.loads((tiny_run / "config.toml").read_text()) == {"planner": {"name": "astar"}}


@pytest.mark.parametrize("dies_at", range(5))
def test_a_run_that_is_begun_and_killed_is_unfinished_and_still_quadlogs(
    tiny_run: Path, monkeypatch: pytest.MonkeyPatch, dies_at: int
) -> None:
    (tiny_run / "plots").mkdir()
    (tiny_run / "plots" / "ranges.png").touch()
    removed, unlink = [], Path.unlink

    def dying_unlink(path: Path, missing_ok: bool = False) -> None:
        if len(removed) == dies_at + 1:
            raise KeyboardInterrupt
        removed.append(path.name)
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", dying_unlink)
    with pytest.raises(KeyboardInterrupt):
        RunFolder.claim(tiny_run, replace=True).begin({}, ())
    monkeypatch.undo()
    assert removed[0] == "run.json"
    assert not RunFolder(tiny_run).is_finished("ab" * 32, {}, "0.1.0", {})
    RunFolder.claim(tiny_run, replace=True).begin({}, ())
    assert sorted(content(tiny_run)) == ["config.toml"]


def test_two_that_take_one_folder_away_do_not_stumble(tmp_path: Path) -> None:
    folder = RunFolder.claim(tmp_path / "run")
    (tmp_path / "run").rmdir()
    folder.discard_if_empty()
    assert not (tmp_path / "run").exists()


def test_a_file_that_another_has_begun_keeps_the_folder(tmp_path: Path) -> None:
    folder = RunFolder.claim(tmp_path / "run")
    folder.write_config({})
    part = tmp_path / "run" / f"{part_prefix(os.getpid())}00000000.part"
    part.write_bytes(b"")
    folder.discard_if_empty()
    assert part.exists()
