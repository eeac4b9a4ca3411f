"""`quadlog sweep`, as typed: its runs are those of single replays, and its page and table have all of them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pyarrow.parquet as pq
import pytest

from quadlog.cli.main import run
from quadlog.metrics.comparison.over_seeds import over_seeds
from quadlog.results.numbers import sig
from quadlog.results.stage_marks import MARKS_FILE
from quadlog.results.stages import STAGE_FILES
from tests.lab.runs import unfinish

FIXTURES = Path(__file__).parents[2] / "fixtures"
FOLLOW = [str(FIXTURES / "follow.mcap"), "-c", str(FIXTURES / "follow.toml"), "--duration", "2"]
PLANNED = [*FOLLOW, "--until", "plan"]
GRID = ["--set", "topics.target=uwb,/nope", "--set", "planner.name=astar,ia_star"]
ASTAR, IA_STAR = ("topics.target=uwb,planner.name=astar", "topics.target=uwb,planner.name=ia_star")
FILES = [name for stage in ("position", "filter", "map", "plan") for name in STAGE_FILES[stage]]


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A finished sweep in which half of the combinations fail."""
    folder = tmp_path_factory.mktemp("sweep") / "out"
    assert run(["sweep", *PLANNED, *GRID, "-o", str(folder), "--jobs", "1"]) == 3
    return folder


def saved(run: Path) -> dict[str, bytes]:
    return {name: (run / name).read_bytes() for name in FILES if name != "scans.parquet" and (run / name).is_file()}


def record(run: Path) -> dict:
    return json.loads((run / "run.json").read_text())


def without_times(run: Path) -> dict[str, list]:
    table = pq.read_table(run / "plans.parquet").to_pydict()
    return {name: values for name, values in table.items() if name != "us"}


def test_a_run_is_what_a_single_replay_gives(swept, tmp_path):
    setting = ["--set", "topics.target=uwb", "--set", "planner.name=ia_star"]
    assert run(["replay", "--no-plots", *PLANNED, *setting, "-o", str(tmp_path)]) == 0
    single, shared = tmp_path / "follow", swept / IA_STAR
    one, other = saved(single), saved(shared)
    del one["plans.parquet"], other["plans.parquet"]
    assert one == other
    assert len(one) > 10
    assert without_times(single) == without_times(shared)
    assert record(single)["config"] == record(shared)["config"]


def test_what_no_key_reaches_is_done_once(swept):
    records = {name: record(swept / name) for name in (ASTAR, IA_STAR)}
    assert {tuple(each["reused"]) for each in records.values()} == {("position", "filter", "map")}
    assert (swept / ASTAR / "scans.parquet").read_bytes() == (swept / IA_STAR / "scans.parquet").read_bytes()
    assert not (swept / IA_STAR / "report.html").exists()


def test_the_table_has_every_combination_and_why_some_failed(swept):
    rows = pq.read_table(swept / "sweep.parquet").to_pylist()
    assert [(row["topics.target"], row["planner.name"], row["exit_code"]) for row in rows] == [
        ("uwb", "astar", 0),
        ("uwb", "ia_star", 0),
        ("/nope", "astar", 1),
        ("/nope", "ia_star", 1),
    ]
    assert all("/nope is not in the recording" in row["reason"] and row["success_rate"] is None for row in rows[2:])
    for row in rows[:2]:
        metrics = json.loads((swept / row["run"] / "metrics.json").read_text())
        del metrics["realtime_factor"]
        assert {name: row[name] for name in metrics} == {name: each["value"] for name, each in metrics.items()}


def test_the_page_is_whole_alone_and_marks_nothing_with_one_seed(swept, ok):
    page = (swept / "report.html").read_text()
    assert "nothing is marked as best" in page
    assert "/nope is not in the recording" in page
    assert not re.search(r"(src|href)=\"(https?:)?//|@import|url\(", page)
    for link in re.findall(r'href="\./([^"]+)"', page):
        assert (swept / unquote(link)).exists()
    (swept / "report.html").unlink()
    ok("report", swept)
    assert (swept / "report.html").read_text() == page


def test_metrics_finds_its_runs(swept, ok):
    assert len(json.loads(ok("metrics", swept, "--format", "json"))) == 2


def test_an_existing_sweep_is_refused_resumed_or_replaced(swept, quadlog):
    arguments = ["sweep", *PLANNED, *GRID, "-o", swept]
    refused = quadlog(*arguments)
    assert refused.code == 1
    assert "--resume" in refused.err
    table, page = ((swept / name).read_bytes() for name in ("sweep.parquet", "report.html"))
    marks = {each: (each / MARKS_FILE).stat().st_mtime_ns for each in (swept / ASTAR, swept / IA_STAR)}
    unfinish(swept / IA_STAR)
    (swept / "sweep.parquet").unlink()
    assert quadlog(*arguments).code == 1, "a page without its table is not replaced"
    (swept / "sweep.parquet").write_bytes(table)
    resumed = quadlog(*arguments, "--resume", "--json", "--jobs", "1")
    assert resumed.code == 3
    assert "reused 4 of 4 stages" in resumed.err
    assert [row["exit_code"] for row in json.loads(resumed.out)] == [0, 0, 1, 1]
    assert {each: (each / MARKS_FILE).stat().st_mtime_ns for each in marks} == marks
    assert ((swept / "sweep.parquet").read_bytes(), (swept / "report.html").read_bytes()) == (table, page)
    forced = quadlog(*arguments, "--force", "--jobs", "2")
    assert forced.code == 3
    assert ((swept / "sweep.parquet").read_bytes(), (swept / "report.html").read_bytes()) == (table, page)
    assert all((each / MARKS_FILE).stat().st_mtime_ns > at for each, at in marks.items())
    assert not (swept / ".stages").exists()


def test_the_runs_of_a_sweep_stand_until_those_that_replace_them_are_complete(swept, quadlog, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    arguments = ["sweep", *PLANNED, *GRID, "-o", swept, "--jobs", "1"]
    runs = (swept / ASTAR, swept / IA_STAR)
    before = {path: path.read_bytes() for run in runs for path in run.rglob("*") if path.is_file()}
    with monkeypatch.context() as patch:
        patch.setattr("quadlog.pipelines.sweep.sweep.take_over", stop)  # the shared stages are done by then
        assert quadlog(*arguments, "--force").code == 1
    assert {path: path.read_bytes() for run in runs for path in run.rglob("*") if path.is_file()} == before
    assert quadlog(*arguments, "--resume").code == 3
    assert not (swept / ".stages").exists()


def test_seeds_give_intervals_and_share_all_that_draws_nothing(tmp_path, quadlog):
    noise = ["--set", "simulation.disturbances.pose_noise_m=0.0,0.1", "--set", "simulation.controller=kinematic"]
    done = quadlog("sweep", *FOLLOW, *noise, "--seeds", "3", "-o", tmp_path / "out")
    assert done.code == 0, done.err
    rows = pq.read_table(tmp_path / "out" / "sweep.parquet").to_pylist()
    assert [row["seed"] for row in rows] == [0, 1, 2, 0, 1, 2]
    assert len({row["eta_m"] for row in rows[:3]}) == 1 < len({row["eta_m"] for row in rows[3:]})
    assert done.err.count("plan is done for all that share it") == 1
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Means of 3 seeds with 95 % intervals" in page
    _, low, high = over_seeds(np.array([row["eta_m"] for row in rows[3:]]))
    assert f"{sig(low)} to {sig(high)}" in page


def test_a_folder_of_something_else_is_left_alone(tmp_path, quadlog):
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.html").write_text("mine")
    done = quadlog("sweep", *PLANNED, "--set", "planner.name=astar,ia_star", "-o", out, "--force")
    assert done.code == 1
    assert [each.name for each in out.iterdir()] == ["report.html"]


def test_a_recording_that_cannot_be_read_fails_in_every_row(tmp_path, quadlog):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((FIXTURES / "follow.mcap").read_bytes()[:3000])
    done = quadlog("sweep", cut, "--set", "planner.name=astar,ia_star", "-o", tmp_path / "out", "--jobs", "1")
    assert done.code == 1
    rows = pq.read_table(tmp_path / "out" / "sweep.parquet").to_pylist()
    assert [row["exit_code"] for row in rows] == [1, 1]
    assert all("nothing readable" in row["reason"] for row in rows)
