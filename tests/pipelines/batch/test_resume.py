"""`--resume`, kills and full disks: what holds is kept, the rest is done again, and the results are those of one go."""

from __future__ import annotations

import json
import resource
import shutil
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from quadlog.config.file import load_config
from quadlog.errors import CannotWrite, QuadlogError, RunExists, RunOfAnother
from quadlog.pipelines.batch.batch import replay_alone
from quadlog.pipelines.batch.plan import plan_batch, preview_batch
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import finished_outcome, planned_keys, replay, reusable_stages
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayOutcome, ReplayRequest
from quadlog.pipelines.stages import report
from quadlog.pipelines.store import Store
from quadlog.results.run import load_run
from tests.lab.kept import Kept
from tests.pipelines.conftest import FIXTURES, cut, fixture_request, results_of

ALL = ("position", "filter", "map", "plan", "control")
RECORDING = FIXTURES / "follow.mcap"


def ask(run: Path, *sets: str, existing: Existing = Existing.RESUME, **options: Any) -> ReplayRequest:
    """A request for one second of the recording and a robot without a body, which is quick, and without plots."""
    config = load_config(FIXTURES / "follow.toml", ["simulation.controller=kinematic", *sets])
    made = fixture_request(run, **({"duration_s": 1.0} | options))
    return replace(made, config=config, existing=existing, plots=False)


@pytest.fixture(scope="module")
def fresh(once: Callable[..., ReplayOutcome]) -> Callable[..., Path]:
    """The run folder of a request that was replayed in one go, once for all tests."""

    def run(*sets: str, **options: Any) -> Path:
        name = "-".join(("fresh", *sets, *(f"{key}={value}" for key, value in options.items())))
        return once(name, lambda runs: replay(ask(runs / "follow", *sets, **options), Silent())).run

    return run


@pytest.fixture
def walked(fresh: Callable[..., Path], tmp_path: Path) -> Path:
    """A finished run, and the results beside it."""
    shutil.copytree(fresh().parent, tmp_path / "runs")
    return tmp_path / "runs" / "follow"


def resumed(request: ReplayRequest) -> tuple[ReplayOutcome, tuple[str, ...]]:
    """The outcome, and the stages that run.json, stderr and the plan beforehand say were reused."""
    planned, kept = reusable_stages(request), Kept()
    outcome = replay(request, kept)
    assert tuple(json.loads((request.run / "run.json").read_text())["reused"]) == tuple(outcome.reused) == planned
    assert [line.partition(": ")[2] for line in kept.lines if line.startswith("reused")] == (
        [", ".join(planned)] if planned else []
    )
    return outcome, planned


@pytest.mark.parametrize(
    ("until", "then", "count"), [("ingest", "report", 0), ("map", "report", 3), ("filter", "map", 1)]
)
def test_a_longer_run_goes_on_where_a_shorter_one_ended(until, then, count, fresh, tmp_path):
    """But filter alone is no half of the map."""
    replay(ask(tmp_path / "run", until=until), Silent())
    outcome, reused = resumed(ask(tmp_path / "run", until=then))
    assert reused == ALL[:count]
    assert results_of(outcome.run) == results_of(fresh(until=then))


@pytest.mark.parametrize(
    "sets",
    [
        ("topics.position=odometry", "topics.target=/truth/person/pose"),  # in frames that have names, and differ
        ("topics.position=fixed", "topics.target=fixed", "topics.target_x_m=3.0"),
    ],
)
def test_a_recording_is_not_read_for_stages_that_need_nothing_of_it(sets, fresh, monkeypatch, tmp_path):
    replay(ask(tmp_path / "run", *sets, until="map"), Silent())
    monkeypatch.setattr(
        "quadlog.pipelines.stages.log.read_log", Mock(side_effect=AssertionError("the recording is read"))
    )
    outcome, reused = resumed(ask(tmp_path / "run", *sets, until="control"))
    assert reused == ALL[:3]
    monkeypatch.undo()
    assert results_of(outcome.run) == results_of(fresh(*sets, until="control"))


def test_a_run_that_went_further_is_done(walked):
    before = {path: path.stat().st_mtime_ns for path in walked.rglob("*")}
    outcome = replay(ask(walked, until="map"), kept := Kept())
    assert (outcome.reused, len(kept.lines)) == (ALL[:3], 1)
    assert {path: path.stat().st_mtime_ns for path in walked.rglob("*")} == before
    (walked / "report.html").unlink()
    assert finished_outcome(ask(walked, until="map")) is None
    assert resumed(ask(walked))[1] == ALL
    assert (walked / "report.html").is_file()


@pytest.mark.parametrize(
    ("sets", "count"),
    [
        (("topics.position=odometry", "topics.target=ahead"), 0),
        (("grid.memory=scan",), 1),
        (("grid.dilation_m=0.5",), 3),
        (("simulation.controller=none",), 4),
    ],
)
def test_another_configuration_starts_at_the_stage_it_concerns(sets, count, walked, fresh):
    """And what the other one had left is gone: fixes of UWB, a simulated walk, results that no run has."""
    outcome, reused = resumed(ask(walked, *sets))
    assert reused == ALL[:count]
    assert results_of(outcome.run) == results_of(fresh(*sets))
    store = Store(walked.parent)
    store.trim()
    keys = json.loads((outcome.run / "run.json").read_text())["results"]
    assert {path.name for path in store.folder.iterdir()} == {key for stage, key in keys.items() if stage != "run"}


def test_another_recording_is_known_by_its_content(tmp_path):
    """The run of another one is refused; a copy elsewhere is the same; other content of the same size starts anew."""
    recording, content = tmp_path / "follow.mcap", RECORDING.read_bytes()
    replay(ask(tmp_path / "run", until="position"), Silent())
    again = replace(ask(tmp_path / "run", until="position"), recording=recording)
    middle = len(content) // 2
    changed = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    recording.write_bytes(changed)
    with pytest.raises(RunOfAnother, match="--force replaces it"):
        replay(again, Silent())
    recording.write_bytes(content)
    assert replay(again, Silent()).exit_code == 0
    recording.write_bytes(changed)
    assert reusable_stages(again) == ()


def test_the_store_can_be_deleted_and_no_run_shares_a_file_with_it_or_with_another(fresh, tmp_path):
    run, other = (replay(ask(tmp_path / name, until="map"), Silent()).run for name in ("run", "other"))
    for path in filter(Path.is_file, other.iterdir()):
        path.chmod(0o644)
        path.write_bytes(b"mine")
    assert results_of(run) == results_of(fresh(until="map"))
    assert results_of(replay(ask(tmp_path / "third", until="map"), Silent()).run) == results_of(run)
    shutil.rmtree(tmp_path / ".stages")
    assert finished_outcome(ask(run, until="map")) is not None
    assert resumed(ask(run))[1] == ()
    assert results_of(run) == results_of(fresh())


def test_a_damaged_result_is_made_again_and_not_reported_as_reused(fresh, tmp_path):
    replay(ask(tmp_path / "run", until="map"), Silent())
    (damaged,) = (tmp_path / ".stages").glob("*/poses.parquet")
    content = damaged.read_bytes()
    for name, wrong, reused in (("shorter", content[:1000], ALL[1:3]), ("as-long", content[:-9] + bytes(9), ALL[1:])):
        damaged.chmod(0o644)
        damaged.write_bytes(wrong)
        outcome = replay(ask(tmp_path / name), Silent())
        assert (outcome.reused, results_of(outcome.run)) == (reused, results_of(fresh()))
        assert damaged.read_bytes() == content


def test_what_an_interrupted_replay_has_done_survives_other_replays(fresh, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("quadlog.pipelines.stages.report.finish", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            replay_alone(ask(tmp_path / "run", until="map"), Silent())
    replay_alone(ask(tmp_path / "other", "grid.memory=scan", until="position", seed=3, start_s=0.5), Silent())
    assert resumed(ask(tmp_path / "run"))[1] == ALL[:3]
    assert results_of(tmp_path / "run") == results_of(fresh())


def test_a_name_and_a_relative_path_make_no_recording_another(tmp_path, monkeypatch):
    """Two of one name from two folders, one after the other and at once: each run stays that of its own recording."""
    content = RECORDING.read_bytes()
    for day, more in (("one", b""), ("two", b"\0")):
        (tmp_path / day).mkdir()
        (tmp_path / day / "log.mcap").write_bytes(content + more)

    def planned(day: str, existing: Existing, begins: float = 0.0) -> ReplayRequest:
        monkeypatch.chdir(tmp_path / day)
        options = ReplayOptions(until="ingest", duration_s=0.5, start_s=begins)
        (request,) = plan_batch(["log.mcap"], tmp_path / "out", load_config(), options, existing, ())
        return request

    request = planned("one", Existing.REFUSE)
    assert (request.recording, replay(request, Silent()).run.name) == (Path("log.mcap"), "log")
    record = load_run(tmp_path / "out" / "log").record
    assert record.input.path == str(tmp_path / "one" / "log.mcap")
    for again in (planned("two", Existing.RESUME), planned("two", Existing.RESUME, 0.1)):
        assert preview_batch([again])[0]["action"] == "refuse"
        with pytest.raises(RunOfAnother, match=r"is the run of .*one/log\.mcap; --force replaces it"):
            replay(again, Silent())
    assert load_run(tmp_path / "out" / "log").record == record
    shutil.rmtree(tmp_path / "out")
    really_finish = report.finish

    def slowly(*arguments: Any) -> Any:
        with monkeypatch.context() as patch:
            patch.setattr(report, "finish", really_finish)
            replay(planned("one", Existing.REFUSE), Silent())
        monkeypatch.chdir(tmp_path / "two")
        return really_finish(*arguments)

    for existing, error in ((Existing.REFUSE, RunExists), (Existing.RESUME, RunOfAnother)):
        second = planned("two", existing)
        with monkeypatch.context() as patch:
            patch.setattr(report, "finish", slowly)
            with pytest.raises(error):
                replay(second, Silent())
        assert load_run(tmp_path / "out" / "log").record.input == record.input
        assert Store(tmp_path / "out").has(planned_keys(second)["ingest"])
        shutil.rmtree(tmp_path / "out")


def test_a_stage_that_fails_leaves_the_results_of_those_before_it(fresh, tmp_path):
    walks, model = "simulation.controller=fpmw", tmp_path / "broken.xml"
    model.write_text("<mujoco>")
    with pytest.raises(QuadlogError, match=r"broken\.xml"):
        replay(ask(tmp_path / "run", walks, f"robot.model={model}"), Silent())
    assert not (tmp_path / "run").exists()
    assert reusable_stages(ask(tmp_path / "run", walks, f"robot.model={model}")) == ALL[:4]
    assert results_of(replay(ask(tmp_path / "run", walks), Silent()).run) == results_of(fresh(walks))
    # What the body took is in no table: a report that is made again still has it.
    outcome, reused = resumed(ask(tmp_path / "again", walks))
    assert (reused, "cost_of_transport" in outcome.metrics) == (ALL, True)
    assert results_of(outcome.run) == results_of(fresh(walks))


def test_what_only_the_clouds_show_is_kept_where_they_are_not_read_again(tmp_path):
    """A cloud that cannot be decoded, and how long the recording is."""
    clouds = cut(
        *(RECORDING, tmp_path / "clouds.mcap", 1.0),
        keep=lambda schema, _: schema == "sensor_msgs/msg/PointCloud2",
        changed=lambda count, data: data[:100] if count == 2 else data,
    )
    config = load_config(settings={"topics.target": "fixed", "simulation.controller": "kinematic"})

    def go(name: str, until: str) -> ReplayOutcome:
        request = ask(tmp_path / name / "run", duration_s=None, until=until)
        return replay(replace(request, recording=clouds, config=config), Silent())

    one = go("one", "report")
    go("two", "plan")
    two = go("two", "report")
    assert (two.reused, two.exit_code, two.reason) == (ALL[:4], 3, one.reason)
    assert "1 messages could not be decoded" in two.reason
    assert results_of(two.run) == results_of(one.run)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("work", "most_bytes", "file", "count"),
    [
        ("positions.position:write_uwb", 5000, "ranges.parquet", 0),
        ("maps:_Tally", 20_000, "cloud_samples.npz", 1),
        ("plan:recorded_maps", 2000, "paths.parquet", 3),
        ("control:_write_walk", 2000, "control.parquet", 4),
        ("report:saved_metrics", 1000, "metrics.json", 5),
        ("report:write_run_page", 20_000, "report.html", 5),
    ],
)
def test_a_full_disk_ends_with_one_line_and_a_run_that_goes_on(work, most_bytes, file, count, tmp_path, monkeypatch):
    """No file gets larger: what the system then says is the same as on a full disk but for its number."""
    module, name = work.split(":")
    does = getattr(import_module(f"quadlog.pipelines.stages.{module}"), name)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def on_a_full_disk(*arguments: Any) -> Any:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, before[1]))
        return does(*arguments)

    request = ask(tmp_path / "runs" / "run")
    with monkeypatch.context() as patch:
        patch.setattr(f"quadlog.pipelines.stages.{module}.{name}", on_a_full_disk)
        try:
            with pytest.raises(CannotWrite) as raised:
                replay(request, Silent())
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert str(raised.value).startswith(f"{request.run / file}: cannot be written: ")
    assert str(raised.value).endswith("; --resume goes on")
    assert (request.run.exists(), list(request.run.parent.rglob("*.part"))) == (False, [])
    assert reusable_stages(request) == ALL[:count]
    assert replay(request, Silent()).reused == ALL[:count]
