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
from quadlog.errors import CannotWrite, QuadlogError, RunOfAnother
from quadlog.pipelines.executor.progress import Kept, Silent
from quadlog.pipelines.replay import replay, reusable_stages
from quadlog.pipelines.report import rebuild_reports
from quadlog.pipelines.request import Existing, ReplayOutcome, ReplayRequest
from quadlog.pipelines.stages import report
from quadlog.pipelines.stages.positions import position
from quadlog.pipelines.stages.resume import finished_outcome
from quadlog.results.diff import diff_runs, of_results
from quadlog.results.record import is_finished
from quadlog.results.run import Run
from tests.lab.runs import unfinish

Ask = Callable[..., ReplayRequest]
UNTIL = {"ingest": 0, "position": 1, "map": 3}
ALL = ("position", "filter", "map", "plan", "control")
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


@pytest.fixture(scope="module")
def walked(ask: Ask, once: Callable[..., ReplayOutcome]) -> Path:
    """A run whose report alone is missing; not to be changed."""
    return once("resumed", lambda runs: replay(ask(runs / "follow", until="control"), Silent())).run


def resumed(request: ReplayRequest) -> tuple[ReplayOutcome, tuple[str, ...]]:
    """The outcome, and the stages that run.json, stderr and the plan beforehand say were reused."""
    told, kept = reusable_stages(request), Kept()
    outcome = replay(request, kept)
    record = json.loads((request.run / "run.json").read_text())
    assert tuple(record["reused"]) == told
    asked = {"filter": 2, "map": 3, "plan": 4, "control": 5, "report": 6, "position": 1}[request.options.until]
    words = f"reused {len(told)} of {asked} stages" + (f": {', '.join(told)}" if told else "")
    assert [line for line in kept.lines if line.startswith("reused")] == [words]
    return outcome, told


@pytest.mark.parametrize(("until", "count"), UNTIL.items())
def test_a_longer_run_goes_on_where_a_shorter_one_ended(until, count, ask, fresh, saved, tmp_path):
    replay(ask(tmp_path / "run", until=until), Silent())
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "run").iterdir()}
    outcome, reused = resumed(ask(tmp_path / "run"))
    assert reused == ALL[:count]
    assert saved(outcome.run) == saved(fresh())
    record = json.loads((outcome.run / "run.json").read_text())
    assert [stage["name"] for stage in record["stages"]] == ["ingest", *ALL, "report"]
    if count:
        assert (outcome.run / "poses.parquet").stat().st_mtime_ns == before["poses.parquet"]


@pytest.mark.parametrize(
    "sets",
    [
        ("topics.position=odometry", "topics.target=/truth/person/pose"),  # in frames that have names, and differ
        ("topics.position=fixed", "topics.target=fixed", "topics.target_x_m=3.0"),
        ("topics.position=odometry", "topics.target=ahead", "uwb.anchors=[]", "lidar.deskew=false"),
    ],
)
def test_tracks_of_other_sources_are_handed_over_as_they_were(sets, ask, fresh, saved, tmp_path):
    replay(ask(tmp_path / "run", *sets, until="position"), Silent())
    outcome, reused = resumed(ask(tmp_path / "run", *sets, until="control"))
    assert reused == ALL[:1]
    assert saved(outcome.run) == saved(fresh(*sets, until="control"))


def test_filter_alone_is_no_half_of_the_map(ask, fresh, saved, tmp_path):
    replay(ask(tmp_path / "run", until="filter"), Silent())
    _, reused = resumed(ask(tmp_path / "run", until="filter", start_s=0.0))
    assert reused == ()
    replay(ask(tmp_path / "run", until="filter"), Silent())
    outcome, reused = resumed(ask(tmp_path / "run", until="map"))
    assert reused == ("position",)
    assert saved(outcome.run) == saved(fresh(until="map"))


def test_a_run_that_went_further_is_done(ask, fresh, tmp_path):
    shutil.copytree(fresh(), tmp_path / "run")
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*")}
    outcome = replay(ask(tmp_path / "run", until="map"), kept := Kept())
    assert outcome.reused == ALL[:3]
    assert kept.lines == [f"{outcome.run}: already done with the same input, config and version"]
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*")} == before


def test_a_shorter_run_of_another_configuration_keeps_nothing_of_a_longer_one(ask, fresh, saved, tmp_path):
    replay(ask(tmp_path / "run", "planner.name=astar"), Silent())
    outcome, reused = resumed(ask(tmp_path / "run", until="map"))
    assert reused == ("position", "filter", "map")
    assert saved(outcome.run) == saved(fresh(until="map"))


def test_the_run_of_another_recording_is_refused(ask, fixtures, fresh, tmp_path):
    shutil.copytree(fresh(until="position"), tmp_path / "run")
    other = tmp_path / "follow.mcap"
    other.write_bytes((fixtures / "follow.mcap").read_bytes() + b"\0")
    request = replace(ask(tmp_path / "run", until="position"), recording=other)
    with pytest.raises(RunOfAnother, match=r"is the run of .*fixtures/follow\.mcap; --force replaces it"):
        replay(request, Silent())
    other.write_bytes((fixtures / "follow.mcap").read_bytes())  # a copy elsewhere is the same recording
    assert replay(request, Silent()).reused == ("position",)


def test_a_file_that_is_taken_away_before_the_end_is_missed(ask, monkeypatch, tmp_path):
    request = replace(ask(tmp_path / "run", until="position"), plots=True)

    def draw(run, drawings):
        (run / "poses.parquet").unlink()

    monkeypatch.setattr(report, "write_plots", draw)
    with pytest.raises(CannotWrite, match=r"poses\.parquet.*another process has removed it"):
        replay(request, Silent())
    assert not is_finished(tmp_path / "run")


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
def test_another_configuration_starts_at_the_stage_it_concerns(sets, count, ask, walked, fresh, saved, tmp_path):
    """And what the other one had left is gone: fixes of UWB, a simulated walk."""
    shutil.copytree(walked, tmp_path / "run")
    outcome, reused = resumed(ask(tmp_path / "run", *sets))
    assert reused == ALL[:count]
    assert saved(outcome.run) == saved(fresh(*sets))


def test_another_input_of_the_same_name_and_size_starts_anew(ask, fixtures, tmp_path):
    recording = tmp_path / "walk.mcap"
    content = (fixtures / "follow.mcap").read_bytes()
    recording.write_bytes(content)
    replay(replace(ask(tmp_path / "run", until="map"), recording=recording), Silent())
    again = replace(ask(tmp_path / "run"), recording=recording)
    assert reusable_stages(again) == ALL[:3]
    library = content.index(b"quadlog", 9)
    recording.write_bytes(content[:library] + b"Quadlog" + content[library + 7 :])
    assert reusable_stages(again) == ()
    assert resumed(replace(again, options=replace(again.options, until="map")))[1] == ()


@pytest.mark.parametrize(
    ("name", "count"),
    [
        *(("poses.parquet", 0), ("reference.tum", 0), ("ground.npz", 1), ("scans.parquet", 1), ("astar.parquet", 3)),
        *(("clearances.parquet", 4), ("stages.json", 0), ("metrics.json", 5), ("report.html", 5)),
    ],
)
@pytest.mark.parametrize("damage", ["cut", "changed", "gone"])
def test_a_stage_never_trusts_a_file_that_is_not_whole(name, count, damage, ask, walked, fresh, saved, tmp_path):
    shutil.copytree(walked, tmp_path / "run")
    path = tmp_path / "run" / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.unlink() if damage == "gone" else path.write_bytes(content[:-9] if damage == "cut" else content)
    if name == "stages.json" and damage == "changed":
        path.write_bytes(content.replace(b'"stage"', b'"stagf"'))
    request = ask(tmp_path / "run")
    assert reusable_stages(request) == ALL[:count]
    if damage == "cut" and name in ("poses.parquet", "scans.parquet", "stages.json"):
        outcome, _ = resumed(request)
        assert saved(outcome.run) == saved(fresh())


@pytest.mark.parametrize("name", ["maps.npz", "stages.json", "metrics.json"])
def test_a_finished_run_that_has_lost_a_file_is_not_done(name, ask, fresh, saved, tmp_path):
    shutil.copytree(fresh(until="map"), tmp_path / "run")
    request = ask(tmp_path / "run", until="map")
    assert finished_outcome(request).reused == ALL[:3]
    (tmp_path / "run" / name).unlink()
    assert finished_outcome(request) is None
    outcome, _ = resumed(request)
    assert saved(outcome.run) == saved(fresh(until="map"))


def test_a_finished_run_without_its_page_gets_it_again(ask, fresh, tmp_path):
    shutil.copytree(fresh(), tmp_path / "run")
    (tmp_path / "run" / "report.html").unlink()
    assert resumed(ask(tmp_path / "run"))[1] == ALL
    assert (tmp_path / "run" / "report.html").is_file()


def test_marks_of_a_stranger_are_worth_nothing(ask, fresh, tmp_path):
    """Those of another run, and ones with the right keys and files but a walk nobody could know so."""
    replay(ask(tmp_path / "run", until="map"), Silent())
    marks = tmp_path / "run" / "stages.json"
    own = json.loads(marks.read_text())
    marks.write_bytes((fresh("uwb.range_std_m=0.2", until="map") / "stages.json").read_bytes())
    assert reusable_stages(ask(tmp_path / "run")) == ()
    for change in ({"counts": {"scans": "many"}}, {"first_ns": 1.5}, {"robot": {"source": 1}}, {"more": 1}):
        damaged = json.loads(json.dumps(own))
        damaged["stages"][1]["known"] |= change
        marks.write_text(json.dumps(damaged))
        assert reusable_stages(ask(tmp_path / "run")) == ("position",)
    marks.write_text(json.dumps(own | {"stages": own["stages"][1:]}))  # nothing is reused behind a gap
    assert reusable_stages(ask(tmp_path / "run")) == ()


def test_a_stage_that_fails_leaves_the_marks_of_those_before_it(ask, fresh, saved, tmp_path):
    walks, model = "simulation.controller=fpmw", tmp_path / "broken.xml"
    model.write_text("<mujoco>")
    with pytest.raises(QuadlogError, match=r"broken\.xml"):
        replay(ask(tmp_path / "run", walks, f"robot.model={model}"), Silent())
    assert reusable_stages(ask(tmp_path / "run", walks, f"robot.model={model}")) == ALL[:4]
    assert saved(resumed(ask(tmp_path / "run", walks))[0].run) == saved(fresh(walks))
    # What the body took is in no table: a report that is made again still has it.
    unfinish(tmp_path / "run")
    outcome, reused = resumed(ask(tmp_path / "run", walks))
    assert reused == ALL
    assert saved(outcome.run) == saved(fresh(walks))
    assert "cost_of_transport" in outcome.metrics


@pytest.mark.parametrize("existing", [Existing.FORCE, Existing.RESUME])
def test_a_replay_whose_first_stage_fails_harms_no_earlier_run(existing, ask, saved, tmp_path):
    replay(ask(tmp_path / "run", until="map"), Silent())
    before = {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir() if path.is_file()}
    with pytest.raises(QuadlogError, match="no moving transforms lead"):
        replay(ask(tmp_path / "run", "topics.position=tf", existing=existing), Silent())
    assert {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir() if path.is_file()} == before


def test_whoever_reads_runs_sees_no_difference(ask, walked, fresh, tmp_path):
    shutil.copytree(walked, tmp_path / "run")
    outcome, _ = resumed(replace(ask(tmp_path / "run"), plots=True))
    assert of_results(diff_runs(Run(outcome.run), Run(fresh()))).empty
    pictures = {path.name: path.read_bytes() for path in (outcome.run / "plots").iterdir()}
    assert pictures
    assert list(rebuild_reports([outcome.run])) == [outcome.run / "report.html"]
    assert {path.name: path.read_bytes() for path in (outcome.run / "plots").iterdir()} == pictures


def test_what_is_reused_is_told_without_a_look_at_the_input_where_nothing_is_marked(ask, monkeypatch, tmp_path):
    def looked(path: Path) -> None:
        raise AssertionError(path)

    monkeypatch.setattr("quadlog.pipelines.replay.describe_input", looked)
    assert reusable_stages(ask(tmp_path / "run")) == ()
    assert not (tmp_path / "run").exists()


def test_a_stage_whose_file_another_process_has_removed_is_not_marked(ask, monkeypatch, tmp_path):
    """Its mark would say that the stage is whole, without that file."""
    locate = position.locate_walk

    def locate_and_lose(walk: Any) -> None:
        locate(walk)
        (tmp_path / "run" / "uwb_errors.parquet").unlink()

    monkeypatch.setattr(position, "locate_walk", locate_and_lose)
    with pytest.raises(CannotWrite, match=r"uwb_errors\.parquet: .* another process has removed it; --resume goes on"):
        replay(ask(tmp_path / "run"), Silent())
    assert reusable_stages(ask(tmp_path / "run")) == ()


def test_what_only_the_clouds_told_is_not_forgotten_where_they_are_not_read_again(ask, cut, fixtures, saved, tmp_path):
    """A cloud that cannot be decoded, and how long the recording is."""
    recording = cut(
        *(fixtures / "follow.mcap", tmp_path / "clouds.mcap", 1.0),
        keep=lambda schema, _: schema == "sensor_msgs/msg/PointCloud2",
        changed=lambda count, data: data[:100] if count == 2 else data,
    )
    config = load_config(settings={"topics.target": "fixed", "simulation.controller": "kinematic"}, environ={})
    requests = [
        replace(ask(tmp_path / name, duration_s=None), recording=recording, config=config)
        for name in ("one", "resumed")
    ]
    one = replay(requests[0], Silent())
    replay(replace(requests[1], options=replace(requests[1].options, until="plan")), Silent())
    again = replay(requests[1], Silent())
    assert json.loads((again.run / "run.json").read_text())["reused"] == list(ALL[:4])
    assert (again.exit_code, again.reason) == (one.exit_code, one.reason)
    assert again.exit_code == 3
    assert "1 messages could not be decoded" in again.reason
    assert json.loads((one.run / "run.json").read_text())["recorded_s"] == pytest.approx(0.9, abs=0.11)
    assert saved(again.run) == saved(one.run)
