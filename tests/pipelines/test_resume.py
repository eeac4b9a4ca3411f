"""`--resume`: what holds is kept, the rest is done again, and nobody can tell the results from those of one go."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from quadlog.config.file import load_config
from quadlog.errors import QuadlogError, RunOfAnother
from quadlog.pipelines.executor.progress import Kept, Silent
from quadlog.pipelines.replay import finished_outcome, replay, reusable_stages
from quadlog.pipelines.request import Existing, ReplayOutcome, ReplayRequest
from quadlog.pipelines.store import Store
from quadlog.results.diff import diff_runs, of_results
from quadlog.results.run import Run

Ask = Callable[..., ReplayRequest]
ALL = ("position", "filter", "map", "plan", "control")
ASKED = {"filter": 2, "map": 3, "plan": 4, "control": 5, "report": 6, "position": 1}
KINEMATIC = "simulation.controller=kinematic"


@pytest.fixture(scope="module")
def ask(fixtures: Path, follow_request: Callable[..., ReplayRequest]) -> Ask:
    """A request for one second of the recording and a robot without a body, which is quick, and without plots."""

    def request(run: Path, *sets: str, existing: Existing = Existing.RESUME, **options: Any) -> ReplayRequest:
        config = load_config(fixtures / "follow.toml", [KINEMATIC, *sets], {})
        made = follow_request(run, **({"duration_s": 1.0} | options))
        return replace(made, config=config, existing=existing, plots=False)

    return request


@pytest.fixture(scope="module")
def fresh(ask: Ask, once: Callable[..., ReplayOutcome]) -> Callable[..., Path]:
    """The run folder of a request that was replayed in one go, once for all tests."""

    def run(*sets: str, **options: Any) -> Path:
        def make(runs: Path) -> ReplayOutcome:
            return replay(ask(runs / "follow", *sets, existing=Existing.REFUSE, **options), Silent())

        return once("-".join(("fresh", *sets, *(f"{key}={value}" for key, value in options.items()))), make).run

    return run


@pytest.fixture
def walked(fresh: Callable[..., Path], tmp_path: Path) -> Path:
    """A finished run, and the results beside it."""
    shutil.copytree(fresh().parent, tmp_path / "runs")
    return tmp_path / "runs" / "follow"


def resumed(request: ReplayRequest) -> tuple[ReplayOutcome, tuple[str, ...]]:
    """The outcome, and the stages that run.json, stderr and the plan beforehand say were reused."""
    told, kept = reusable_stages(request), Kept()
    outcome = replay(request, kept)
    assert tuple(json.loads((request.run / "run.json").read_text())["reused"]) == tuple(outcome.reused) == told
    words = f"reused {len(told)} of {ASKED[request.options.until]} stages" + (f": {', '.join(told)}" if told else "")
    assert [line for line in kept.lines if line.startswith("reused")] == ([words] if told else [])
    return outcome, told


@pytest.mark.parametrize(("until", "count"), [("ingest", 0), ("position", 1), ("map", 3)])
def test_a_longer_run_goes_on_where_a_shorter_one_ended(until, count, ask, fresh, saved, tmp_path):
    replay(ask(tmp_path / "run", until=until), Silent())
    outcome, reused = resumed(ask(tmp_path / "run"))
    assert reused == ALL[:count]
    assert saved(outcome.run) == saved(fresh())
    record = json.loads((outcome.run / "run.json").read_text())
    assert [stage["name"] for stage in record["stages"]] == ["ingest", *ALL, "report"]
    assert of_results(diff_runs(Run(outcome.run), Run(fresh()))).empty


def read(*_: Any) -> None:
    raise AssertionError("the recording is read")


@pytest.mark.parametrize(
    "sets",
    [
        ("topics.position=odometry", "topics.target=/truth/person/pose"),  # in frames that have names, and differ
        ("topics.position=fixed", "topics.target=fixed", "topics.target_x_m=3.0"),
        ("topics.position=odometry", "topics.target=ahead", "uwb.anchors=[]", "lidar.deskew=false"),
    ],
)
def test_a_recording_is_not_read_for_stages_that_need_nothing_of_it(sets, ask, fresh, saved, monkeypatch, tmp_path):
    replay(ask(tmp_path / "run", *sets, until="map"), Silent())
    monkeypatch.setattr("quadlog.pipelines.log.read_log", read)
    outcome, reused = resumed(ask(tmp_path / "run", *sets, until="control"))
    assert reused == ALL[:3]
    monkeypatch.undo()
    assert saved(outcome.run) == saved(fresh(*sets, until="control"))


def test_filter_alone_is_no_half_of_the_map(ask, fresh, saved, tmp_path):
    replay(ask(tmp_path / "run", until="filter"), Silent())
    outcome, reused = resumed(ask(tmp_path / "run", until="map"))
    assert reused == ("position",)
    assert saved(outcome.run) == saved(fresh(until="map"))


def test_a_run_that_went_further_is_done(ask, walked):
    before = {path: path.stat().st_mtime_ns for path in walked.rglob("*")}
    outcome = replay(ask(walked, until="map"), kept := Kept())
    assert outcome.reused == ALL[:3]
    assert kept.lines == [f"{outcome.run}: already done with the same input, config and version"]
    assert {path: path.stat().st_mtime_ns for path in walked.rglob("*")} == before
    (walked / "report.html").unlink()
    assert finished_outcome(ask(walked, until="map")) is None
    assert resumed(ask(walked))[1] == ALL
    assert (walked / "report.html").is_file()


def test_the_run_of_another_recording_is_refused(ask, fixtures, tmp_path):
    replay(ask(tmp_path / "run", until="position"), Silent())
    other = tmp_path / "follow.mcap"
    other.write_bytes((fixtures / "follow.mcap").read_bytes() + b"\0")
    request = replace(ask(tmp_path / "run", until="position"), recording=other)
    with pytest.raises(RunOfAnother, match=r"is the run of .*fixtures/follow\.mcap; --force replaces it"):
        replay(request, Silent())
    other.write_bytes((fixtures / "follow.mcap").read_bytes())  # a copy elsewhere is the same recording
    assert replay(request, Silent()).exit_code == 0


@pytest.mark.parametrize(
    ("sets", "count"),
    [
        (("topics.position=odometry", "topics.target=ahead"), 0),
        (("grid.memory=scan",), 1),
        (("planner.name=astar",), 3),
        (("grid.dilation_m=0.5",), 3),
        (("pursuit.lookahead_m=1.0",), 4),
        (("simulation.controller=none",), 4),
    ],
)
def test_another_configuration_starts_at_the_stage_it_concerns(sets, count, ask, walked, fresh, saved):
    """And what the other one had left is gone: fixes of UWB, a simulated walk, results that no run has."""
    outcome, reused = resumed(ask(walked, *sets))
    assert reused == ALL[:count]
    assert saved(outcome.run) == saved(fresh(*sets))
    store = Store(walked.parent)
    store.trim()
    keys = json.loads((outcome.run / "run.json").read_text())["results"]
    assert {path.name for path in store.folder.iterdir()} == {key for stage, key in keys.items() if stage != "run"}


def test_another_input_of_the_same_name_and_size_starts_anew(ask, fixtures, tmp_path):
    recording = tmp_path / "walk.mcap"
    content = (fixtures / "follow.mcap").read_bytes()
    recording.write_bytes(content)
    replay(replace(ask(tmp_path / "run", until="position"), recording=recording), Silent())
    again = replace(ask(tmp_path / "run"), recording=recording)
    assert reusable_stages(again) == ALL[:1]
    middle = len(content) // 2
    recording.write_bytes(content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :])
    assert reusable_stages(again) == ()


def test_the_store_can_be_deleted_and_its_results_are_read_only(ask, fresh, saved, tmp_path):
    run = replay(ask(tmp_path / "run", until="map"), Silent()).run
    shared = [path for path in run.iterdir() if path.stat().st_nlink > 1]
    assert {"poses.parquet", "maps.npz", "map.yaml"} <= {path.name for path in shared}
    assert all(path.stat().st_mode & 0o777 == 0o444 for path in shared)
    shutil.rmtree(tmp_path / ".stages")
    assert finished_outcome(ask(run, until="map")) is not None
    assert resumed(ask(run))[1] == ()
    assert saved(run) == saved(fresh())


def test_a_stage_that_fails_leaves_the_results_of_those_before_it(ask, fresh, saved, tmp_path):
    walks, model = "simulation.controller=fpmw", tmp_path / "broken.xml"
    model.write_text("<mujoco>")
    with pytest.raises(QuadlogError, match=r"broken\.xml"):
        replay(ask(tmp_path / "run", walks, f"robot.model={model}"), Silent())
    assert not (tmp_path / "run").exists()
    assert reusable_stages(ask(tmp_path / "run", walks, f"robot.model={model}")) == ALL[:4]
    # What the body took is in no table: a report that is made again still has it.
    assert saved(replay(ask(tmp_path / "run", walks), Silent()).run) == saved(fresh(walks))
    outcome, reused = resumed(ask(tmp_path / "again", walks))
    assert reused == ALL
    assert saved(outcome.run) == saved(fresh(walks))
    assert "cost_of_transport" in outcome.metrics


@pytest.mark.parametrize("existing", [Existing.FORCE, Existing.RESUME])
def test_a_replay_whose_first_stage_fails_harms_no_earlier_run(existing, ask, walked):
    before = {path.name: path.read_bytes() for path in walked.iterdir() if path.is_file()}
    with pytest.raises(QuadlogError, match="no moving transforms lead"):
        replay(ask(walked, "topics.position=tf", existing=existing), Silent())
    assert {path.name: path.read_bytes() for path in walked.iterdir() if path.is_file()} == before


def test_force_makes_every_result_again(ask, walked):
    before = {path.name: path.stat().st_mtime_ns for path in walked.iterdir()}
    outcome = replay(ask(walked, existing=Existing.FORCE), Silent())
    assert outcome.reused == ()
    assert all(path.stat().st_mtime_ns > before[path.name] for path in walked.iterdir())


def test_what_only_the_clouds_told_is_not_forgotten_where_they_are_not_read_again(ask, cut, fixtures, saved, tmp_path):
    """A cloud that cannot be decoded, and how long the recording is."""
    recording = cut(
        *(fixtures / "follow.mcap", tmp_path / "clouds.mcap", 1.0),
        keep=lambda schema, _: schema == "sensor_msgs/msg/PointCloud2",
        changed=lambda count, data: data[:100] if count == 2 else data,
    )
    config = load_config(settings={"topics.target": "fixed", "simulation.controller": "kinematic"}, environ={})
    requests = [
        replace(ask(tmp_path / name / "run", duration_s=None), recording=recording, config=config)
        for name in ("one", "resumed")
    ]
    one = replay(requests[0], Silent())
    replay(replace(requests[1], options=replace(requests[1].options, until="plan")), Silent())
    again = replay(requests[1], Silent())
    assert again.reused == ALL[:4]
    assert (again.exit_code, again.reason) == (one.exit_code, one.reason)
    assert again.exit_code == 3
    assert "1 messages could not be decoded" in again.reason
    assert json.loads((one.run / "run.json").read_text())["recorded_s"] == pytest.approx(0.9, abs=0.11)
    assert saved(again.run) == saved(one.run)
