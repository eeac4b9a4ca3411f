from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.errors import NotARun, UnknownRunFormat
from quadlog.results.compare.differences import FirstDifference, RowLocation, Tolerance
from quadlog.results.compare.run_diff import diff_runs, first_difference
from quadlog.results.run.names import OWN_FILES
from quadlog.results.run.stages import STAGE_FILES
from quadlog.results.run.tables import TABLES, read_table, write_table

SHOWN_ELSEWHERE = {"run.json", "config.toml", "stages.json", "report.html", "derived.mcap", "foxglove-layout.json"}
EXACT = Tolerance()


def differing(a: Path, b: Path, tolerance: Tolerance = EXACT) -> list[str]:
    runs = diff_runs(a, b, tolerance)
    return [f"{stage} {each.name}" for stage, results in runs.stages.items() for each in results if not each.same]


def test_every_file_of_a_run_is_compared_in_one_stage() -> None:
    listed = [name for files in STAGE_FILES.values() for name in files]
    assert len(listed) == len(set(listed))
    assert set(listed) == OWN_FILES - SHOWN_ELSEWHERE


def test_a_copy_is_the_same(tiny_run: Path, other: Path) -> None:
    runs = diff_runs(tiny_run, other, EXACT)
    assert runs.same
    assert first_difference(runs) is None
    assert not any(runs.origins.values())
    assert runs.start_ns == int(read_table(tiny_run, "poses")["t_ns"][0])
    compared = [result.name for results in runs.stages.values() for result in results]
    assert {name.partition(".")[0] for name in compared} >= {path.stem for path in tiny_run.glob("*.parquet")}


def test_the_start_is_the_first_instant_of_all(tiny_run: Path, other: Path) -> None:
    start_ns = int(read_table(tiny_run, "poses")["t_ns"][0])
    for name in ("plans", "fixes"):
        columns = {key: values[8:] for key, values in read_table(tiny_run, name).items()}
        for run in (tiny_run, other):
            write_table(run / f"{name}.parquet", TABLES[name], columns)
    assert diff_runs(tiny_run, other, EXACT).start_ns == start_ns


def test_how_a_run_was_made_is_listed_and_is_no_difference(tiny_run: Path, other: Path, change_json: Any) -> None:
    changed: dict[str, Any] = {"config.planner.name": "astar", "quadlog_version": "9.9", "seed": 5}
    changed |= {"options": {"stamp": "log", "seed": 5}, "packages.numpy": "0.1", "host.python": "2.7"}
    changed |= {"host.name": "elsewhere", "input.path": "/x", "input.sha256": "cd" * 32}
    changed |= {"command": ["y"], "stages": [], "realtime_factor": 99.0}
    change_json(other / "run.json", changed)
    runs = diff_runs(tiny_run, other, EXACT)
    assert runs.same
    keys = {name: [each.key for each in found] for name, found in runs.origins.items()}
    assert keys == {
        "config": ["planner.name"],
        "input": ["sha256"],
        "seed": ["seed"],
        "options": ["stamp", "until"],
        "versions": ["numpy", "python", "quadlog"],
    }


@pytest.mark.parametrize(
    ("one", "two", "told"),
    [
        ({"etag": "a"}, {"etag": "b"}, ["etag"]),
        ({"etag": "a", "last_modified": "May"}, {"etag": "a", "last_modified": "June"}, []),
        ({"last_modified": "May"}, {"last_modified": "June"}, ["last_modified"]),
        ({"etag": "a"}, {"sha256": "a"}, ["etag", "sha256"]),
    ],
)
def test_inputs_behind_urls_are_told_apart(
    tiny_run: Path, other: Path, change_json: Any, one: dict[str, str], two: dict[str, str], told: list[str]
) -> None:
    for run, fingerprint in ((tiny_run, one), (other, two)):
        change_json(run / "run.json", {"input": {"path": "x", "size_bytes": 1} | fingerprint})
    assert [each.key for each in diff_runs(tiny_run, other, EXACT).origins["input"]] == told


def test_what_was_read_belongs_to_ingest(tiny_run: Path, other: Path, change_json: Any) -> None:
    change_json(other / "run.json", {"topics.0.messages": 39, "topics.0.why": "a whim"})
    first = first_difference(diff_runs(tiny_run, other, EXACT))
    assert first == FirstDifference("ingest", "run.json", None, "lidar /points", 40, 39, 1.0)


def with_value(place: int, value: Any) -> Any:
    """A column with another value at one place."""
    return lambda column: np.concatenate([column[:place], np.array([value], column.dtype), column[place + 1 :]])


def test_the_first_difference_is_the_earliest_of_the_first_stage(tiny_run: Path, other: Path, change: Any) -> None:
    change(other, "control", x_m=with_value(0, 9.0))
    change(other, "links", bias_m=with_value(0, 9.0))
    change(other, "fixes", x_m=with_value(60, 9.0))
    change(other, "target", source=with_value(12, "topic"))
    runs = diff_runs(tiny_run, other, EXACT)
    t_ns = int(read_table(tiny_run, "target")["t_ns"][12])
    assert first_difference(runs) == FirstDifference(
        "position", "target", RowLocation(t_ns), "source", "uwb", "topic", None, None
    )
    assert t_ns - runs.start_ns == 1_200_000_000
    assert differing(tiny_run, other) == ["position fixes", "position links", "position target", "control control"]


def test_a_table_of_one_run_alone_comes_before_all_else(tiny_run: Path, other: Path, change: Any) -> None:
    (tiny_run / "links.parquet").unlink()
    change(other, "fixes", x_m=with_value(0, 9.0))
    assert first_difference(diff_runs(tiny_run, other, EXACT)) == FirstDifference("position", "links", only_in="B")


def test_rows_of_one_run_alone_are_a_difference(tiny_run: Path, other: Path) -> None:
    columns = read_table(other, "plans")
    write_table(other / "plans.parquet", TABLES["plans"], {name: values[:-3] for name, values in columns.items()})
    first = first_difference(diff_runs(tiny_run, other, EXACT))
    assert first == FirstDifference("plan", "plans", RowLocation(int(columns["t_ns"][-3])), only_in="A")


def test_tolerances_hold_for_tables_and_metrics(tiny_run: Path, other: Path, change: Any, change_json: Any) -> None:
    change(other, "poses", x_m=lambda x_m: x_m + 0.01)
    change_json(other / "metrics.json", {"eta_m.value": 0.124})
    assert differing(tiny_run, other) == ["position poses", "report metrics.json"]
    assert differing(tiny_run, other, Tolerance(absolute=0.005)) == ["position poses"]
    assert differing(tiny_run, other, Tolerance(absolute=0.0101)) == []
    assert differing(tiny_run, other, Tolerance(relative=0.009)) == ["position poses"]


def test_metrics_are_compared_by_name_without_durations(tiny_run: Path, other: Path, change_json: Any) -> None:
    duration = {"value": 3.0, "n": 1, "unit": ""}
    change_json(other / "metrics.json", {"eta_m.n": 199, "realtime_factor": duration, "new": duration})
    (metrics,) = [each for each in diff_runs(tiny_run, other, EXACT).stages["report"] if each.name == "metrics.json"]
    assert [(each.key, each.a, each.b) for each in metrics.values] == [("eta_m.n", 200, 199), ("new", None, 3.0)]


NOT_IN_EVERY_RUN = {"reference.tum", "joints.parquet", "other_poses.parquet", "body.parquet", "gait.parquet"}


@pytest.mark.parametrize("name", sorted({name for files in STAGE_FILES.values() for name in files} - NOT_IN_EVERY_RUN))
def test_a_damaged_file_is_named(tiny_run: Path, other: Path, name: str) -> None:
    if name in {"map.pgm", "map.yaml"}:
        (other / name).write_bytes(b"\xff\x00{")  # nothing in these can be damaged: they differ
        assert differing(tiny_run, other) == [f"map {name}"]
        return
    content = (other / name).read_bytes()
    (other / name).write_bytes(content[: len(content) // 2] + b"?")
    with pytest.raises(Exception, match=name) as raised:
        diff_runs(tiny_run, other, EXACT)
    assert type(raised.value).__name__ in {"NotARun", "UnreadableFile"}
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("name", ["run.json", "metrics.json"])
def test_a_run_without_these_is_none(tiny_run: Path, other: Path, name: str) -> None:
    (other / name).unlink()
    with pytest.raises(NotARun, match=name):
        diff_runs(tiny_run, other, EXACT)


def test_a_run_of_another_format_is_refused_by_name(tiny_run: Path, other: Path, change_json: Any) -> None:
    change_json(other / "run.json", {"run_format": 99})
    with pytest.raises(UnknownRunFormat, match="other"):
        diff_runs(tiny_run, other, EXACT)


@pytest.mark.parametrize("value", [None, 3, [], "x", {"a": [1]}])
def test_a_record_of_another_program_is_no_bug(tiny_run: Path, other: Path, change_json: Any, value: object) -> None:
    names = ("config", "options", "input", "host", "packages", "topics", "losses", "seed")
    change_json(other / "run.json", dict.fromkeys(names, value))
    assert diff_runs(tiny_run, other, EXACT).origins["config"]
