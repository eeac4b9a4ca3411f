"""`quadlog sweep`, as typed: its runs are those of single replays, and its page and table have all of them."""

from __future__ import annotations

import json
import re
import shutil
from urllib.parse import unquote

import numpy as np
import pyarrow.parquet as pq
import pytest

from quadlog.cli.main import run
from quadlog.metrics.catalogue import THEMES
from quadlog.metrics.differences import over_runs
from quadlog.results import STAGE_FILES
from quadlog.results.text import sig
from tests.cli.conftest import FOLLOW
from tests.lab.runs import unfinish

PLANNED = [*FOLLOW, "--duration", "0.5", "--until", "plan"]
GRID = ["--set", "topics.target=uwb,/nope", "--set", "planner.name=astar,ia_star", "--jobs", "1"]
ASTAR, IA_STAR = ("topics.target=uwb,planner.name=astar", "topics.target=uwb,planner.name=ia_star")
FILES = [name for stage in ("position", "filter", "map", "plan") for name in STAGE_FILES[stage]]


@pytest.fixture(scope="session")
def swept(once):
    """A finished sweep in which half of the combinations fail; not to be changed."""

    def make(folder):
        assert run(["sweep", *PLANNED, *GRID, "-o", str(folder / "out")]) == 3
        return folder / "out"

    return once("sweep", make)


@pytest.fixture
def mine(swept, tmp_path):
    return shutil.copytree(swept, tmp_path / "out")  # the page has its name


def bytes_below(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_run_is_what_a_single_replay_gives_and_what_no_key_reaches_is_done_once(swept, tmp_path):
    setting = ["--set", "topics.target=uwb", "--set", "planner.name=ia_star"]
    assert run(["replay", "--no-plots", *PLANNED, *setting, "-o", str(tmp_path)]) == 0
    single, shared = tmp_path / "follow", swept / IA_STAR
    timed = ("scans.parquet", "plans.parquet")
    names = [name for name in FILES if name not in timed and (single / name).is_file()]
    assert len(names) > 10
    assert {name for name in names if (single / name).read_bytes() != (shared / name).read_bytes()} == set()
    one, other = (pq.read_table(run / "plans.parquet").drop_columns("us") for run in (single, shared))
    assert one.equals(other)
    records = [json.loads((place / "run.json").read_text()) for place in (single, shared, swept / ASTAR)]
    assert records[0]["config"] == records[1]["config"]
    assert [tuple(each["reused"]) for each in records[1:]] == [("position", "filter", "map"), ()]
    assert (swept / ASTAR / "scans.parquet").read_bytes() == (shared / "scans.parquet").read_bytes()
    assert not [*shared.glob("report.html"), *shared.glob("plots/*")]


def test_the_table_has_every_combination_and_why_some_failed(swept, ok):
    rows = pq.read_table(swept / "sweep.parquet").to_pylist()
    found = [(row["topics.target"], row["planner.name"], row["exit_code"]) for row in rows]
    assert found == [("uwb", "astar", 0), ("uwb", "ia_star", 0), ("/nope", "astar", 1), ("/nope", "ia_star", 1)]
    assert all("/nope is not in the recording" in row["reason"] and row["success_rate"] is None for row in rows[2:])
    for row in rows[:2]:
        metrics = json.loads((swept / row["run"] / "metrics.json").read_text())
        metrics = {name: each for name, each in metrics.items() if name not in THEMES["Computing"]}
        assert {name: row[name] for name in metrics} == {name: each["value"] for name, each in metrics.items()}
    assert len(json.loads(ok("metrics", swept, "--format", "json"))) == 2
    page = (swept / "report.html").read_text()
    assert "nothing is marked as best" in page
    assert "/nope is not in the recording" in page
    for link in re.findall(r'href="\./([^"]+)"', page):
        assert (swept / unquote(link)).exists()


def test_an_existing_sweep_is_refused_resumed_or_replaced_once_the_new_one_is_complete(mine, quadlog, monkeypatch):
    arguments = ["sweep", *PLANNED, *GRID, "-o", mine]
    refused = quadlog(*arguments)
    assert (refused.code, "--resume" in refused.err) == (1, True)
    table, page = ((mine / name).read_bytes() for name in ("sweep.parquet", "report.html"))
    plans = {each: (each / "plans.parquet").read_bytes() for each in (mine / ASTAR, mine / IA_STAR)}  # with timings
    unfinish(mine / IA_STAR)
    resumed = quadlog(*arguments, "--resume", "--json")
    assert (resumed.code, "reused 4 of 4 stages" in resumed.err) == (3, True)
    assert [row["exit_code"] for row in json.loads(resumed.out)] == [0, 0, 1, 1]
    assert {each: (each / "plans.parquet").read_bytes() for each in plans} == plans

    def stop(*_, **__):
        raise KeyboardInterrupt

    before = bytes_below(mine / ASTAR) | bytes_below(mine / IA_STAR)
    with monkeypatch.context() as patch:
        patch.setattr("quadlog.pipelines.batch.sweep.replay_all", stop)  # results are forgotten by then
        assert quadlog(*arguments, "--force").code == 1
    assert bytes_below(mine / ASTAR) | bytes_below(mine / IA_STAR) == before
    assert quadlog(*arguments, "--force").code == 3
    assert ((mine / "sweep.parquet").read_bytes(), (mine / "report.html").read_bytes()) == (table, page)
    assert all((each / "plans.parquet").read_bytes() != before for each, before in plans.items())


def test_seeds_give_intervals_and_share_all_that_draws_nothing(tmp_path, quadlog):
    noise = ["--set", "simulation.disturbances.pose_noise_m=0.0,0.1", "--set", "simulation.controller=kinematic"]
    shared = [*FOLLOW, "--duration", "1", "--seeds", "2", "--jobs", "1"]
    done = quadlog("sweep", *shared, *noise, "-o", tmp_path / "out")
    assert done.code == 0, done.err
    rows = pq.read_table(tmp_path / "out" / "sweep.parquet").to_pylist()
    assert [row["seed"] for row in rows] == [0, 1, 0, 1]
    assert len({row["eta_m"] for row in rows[:2]}) == 1 < len({row["eta_m"] for row in rows[2:]})
    assert done.err.count("reused ") == 3
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Means of 2 seeds with 95 % intervals" in page
    low, high = over_runs(np.array([row["eta_m"] for row in rows[2:]])).interval
    assert f"{sig(low, 2)} to {sig(high, 2)}" in page


def test_a_folder_of_something_else_is_left_alone(tmp_path, quadlog):
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.html").write_text("mine")
    assert quadlog("sweep", *PLANNED, *GRID, "-o", out, "--force").code == 1
    assert [each.name for each in out.iterdir()] == ["report.html"]
