from __future__ import annotations

import json
import shutil

import pyarrow.parquet as pq
import pytest

from quadlog.errors import CannotWrite
from quadlog.pipelines.batch.batch import BatchOutcome, replay_alone, replay_batch
from quadlog.pipelines.batch.plan import plan_batch, preview_batch
from quadlog.pipelines.batch.progress import BatchLines
from quadlog.pipelines.executor.progress import Kept, Silent
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayOutcome
from quadlog.results.tables import COST_NAMES


def replay_all(batch, jobs=1, lines=None, scheduler=None):
    return replay_batch(batch, jobs, scheduler, BatchLines([].append if lines is None else lines.append))


def summary_of(output):
    return pq.read_table(output / "summary.parquet").to_pandas().set_index("recording")


@pytest.fixture(scope="module")
def finished(planned, tmp_path_factory):
    """Replayed one by one in this process: the folder, the outcome, and what was said."""
    output, lines = tmp_path_factory.mktemp("out") / "runs", []
    return output, replay_all(planned(output, until="control"), lines=lines), lines


def test_a_failure_never_stops_the_rest_and_stands_in_the_summary(finished):
    output, outcome, _ = finished
    assert outcome.exit_code == 3
    assert [run.failed for run in outcome.runs] == [True, False, False, False]
    summary = summary_of(output)
    assert set(summary.index) == {"broken", "walk.mcap", "walk.bag", "walk.db3"}
    assert summary.loc["broken", "exit_code"] == 1
    assert summary.loc["broken", "reason"].startswith("not a recording: unknown file format")
    assert summary["eta_m"].notna().sum() == 3
    assert "not a recording: unknown file format" in (output / "report.html").read_text()


def test_the_summary_tells_what_each_recording_cost(finished, season):
    summary = summary_of(finished[0])
    assert list(summary.columns[-5:]) == [*COST_NAMES, "worker"]
    done = summary.drop("broken")
    assert (done[["wall_s", "cpu_s"]] > 0).all().all()
    assert done["peak_memory_mb"].between(50, 5000).all()
    assert all(done.loc[f"walk.{kind}", "input_bytes"] == (season / f"walk.{kind}").stat().st_size for kind in ("bag",))
    assert done["worker"].nunique() == 1


def test_there_is_one_line_for_each_recording_and_one_for_each_warning(finished):
    lines = [line for line in finished[2] if ": warning: " not in line]
    assert [line.split(":")[0] for line in lines[:-1]] == [
        f"[{i}/4] walk.{k}" for i, k in zip((1, 2, 3), order(finished), strict=True)
    ]
    assert lines[-1].startswith("[4/4] broken: not a recording")


def order(finished):
    """The containers, the largest recording first."""
    sizes = {run.run.name: run.cost["input_bytes"] for run in finished[1].runs if not run.failed}
    return [name.removeprefix("walk.") for name in sorted(sizes, key=sizes.__getitem__, reverse=True)]


@pytest.mark.parametrize("other", ["bag", "db3"])
def test_the_same_messages_in_three_containers_give_identical_tables(finished, other):
    output, _, _ = finished
    for path in sorted((output / "walk.mcap").glob("*.parquet")):
        one, two = (pq.read_table(path), pq.read_table(output / f"walk.{other}" / path.name))
        kept = [name for name in one.column_names if name not in ("ms", "us")]
        assert one.select(kept).equals(two.select(kept)), path.name
    for name in ("maps.npz", "cloud_samples.npz", "ground.npz", "trajectory.tum", "map.pgm"):
        assert (output / "walk.mcap" / name).read_bytes() == (output / f"walk.{other}" / name).read_bytes(), name


def test_processes_do_not_change_a_byte(planned, finished, saved, tmp_path):
    outcome = replay_all(planned(tmp_path / "runs", until="control"), jobs=2)
    assert [run.failed for run in outcome.runs] == [True, False, False, False]
    for name in ("walk.mcap", "walk.bag", "walk.db3"):
        assert saved(tmp_path / "runs" / name) == saved(finished[0] / name), name
    assert {run.reason for run in outcome.runs} == {run.reason for run in finished[1].runs}


def test_what_is_done_already_keeps_its_row_and_what_it_cost(planned, finished):
    before = summary_of(finished[0])
    lines = []
    again = replay_all(planned(finished[0], until="control", existing=Existing.RESUME), lines=lines)
    assert again.exit_code == 3
    after = summary_of(finished[0])
    assert after.drop("broken").equals(before.drop("broken"))
    assert sum("; reused 5 of 5 stages: position, filter, map" in line for line in lines) == 3


def test_a_failure_stays_in_the_summary_though_the_earlier_run_is_still_there(planned, season, season_config, tmp_path):
    def replayed(name, existing=Existing.REFUSE):
        arguments = (tmp_path / "runs", season_config, ReplayOptions(until="ingest"), existing, ())
        return replay_all(plan_batch([str(tmp_path / name)], *arguments))

    for name in ("one.bag", "two.bag"):
        shutil.copy(season / "walk.bag", tmp_path / name)
    replayed("one.bag")
    (tmp_path / "one.bag").write_text("damaged since")
    replayed("one.bag", Existing.FORCE)
    replayed("two.bag")
    summary = summary_of(tmp_path / "runs")
    assert dict(summary["exit_code"]) == {"one": 1, "two": 0}
    assert "not a recording" in summary.loc["one", "reason"]


def test_a_refused_run_keeps_its_row(planned, finished):
    before = summary_of(finished[0])
    lines = []
    outcome = replay_all(planned(finished[0], "walk.bag", "walk.db3"), lines=lines)
    assert outcome.exit_code == 1
    assert all("--resume to continue" in run.reason for run in outcome.runs)
    assert summary_of(finished[0]).loc["walk.bag"].equals(before.loc["walk.bag"])


def test_a_run_that_somebody_finishes_meanwhile_is_not_touched(planned, tmp_path):
    class Racing(BatchLines):
        """Finishes the second recording, asked for less, while the first one is replayed."""

        def expect(self, tally, workers):
            replay_alone(planned(tmp_path / "runs", "walk.bag", "walk.db3")[1], Silent())

    batch = planned(tmp_path / "runs", "walk.bag", "walk.db3", until="position")
    outcome = replay_batch(batch, 1, None, Racing([].append))
    assert [run.failed for run in outcome.runs] == [False, True]
    assert "--force to replace it or --resume to continue" in outcome.runs[1].reason
    assert json.loads((tmp_path / "runs" / "walk.db3" / "run.json").read_text())["options"]["until"] == "ingest"


def test_the_run_of_another_recording_keeps_its_place_and_row(planned, season, season_config, tmp_path):
    output = tmp_path / "runs"
    replay_alone(planned(output, "walk.bag")[0], Silent())
    before = summary_of(output).loc["walk"]
    shutil.copy(season / "walk.db3", tmp_path / "walk.db3")
    arguments = (output, season_config, ReplayOptions(until="ingest"), Existing.RESUME, ())
    batch = plan_batch([str(tmp_path / "walk.db3")], *arguments)
    assert [each.action for each in preview_batch(batch)] == ["refuse"]
    outcome = replay_all(batch)
    assert f"is the run of {season / 'walk.bag'}" in outcome.runs[0].reason
    assert summary_of(output).loc["walk"].equals(before)


def test_one_recording_alone_costs_something_too(planned, tmp_path):
    (again,) = planned(tmp_path, "walk.bag", existing=Existing.FORCE)
    replay_alone(again, Silent())
    first = summary_of(tmp_path).loc["walk"]
    assert first["wall_s"] > 0
    assert first["worker"]
    replay_alone(again, Silent())
    assert summary_of(tmp_path).loc["walk", "wall_s"] != first["wall_s"]


def test_an_output_that_is_no_folder_is_refused_before_anything_runs(planned, tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(CannotWrite, match="is no folder"):
        planned(tmp_path / "file")


def test_rows_of_earlier_commands_stay_while_their_runs_do(season, season_config, tmp_path):
    for name in ("first", "second", "third"):
        shutil.copy(season / "walk.bag", tmp_path / f"{name}.bag")
        recording, options = str(tmp_path / f"{name}.bag"), ReplayOptions(until="ingest")
        batch = plan_batch([recording], tmp_path / "runs", season_config, options, Existing.REFUSE, ())
        replay_alone(batch[0], Silent())
        if name == "first":
            shutil.rmtree(tmp_path / "runs" / name)
    assert list(summary_of(tmp_path / "runs").index) == ["second", "third"]


def test_somebody_elses_report_is_left_alone(planned, tmp_path):
    (tmp_path / "report.html").write_text("my thesis")
    kept = Kept()
    assert replay_alone(planned(tmp_path, "walk.bag")[0], kept).exit_code == 0
    assert (tmp_path / "report.html").read_text() == "my thesis"
    assert not (tmp_path / "summary.parquet").exists()
    assert any("is left alone" in line for line in kept.lines)


def test_thousands_of_failures_are_counted_and_some_of_them_named(tmp_path):
    runs = tuple(ReplayOutcome(tmp_path / f"r{n}", tmp_path / f"{n}", 1 if n else 0, f"why {n}") for n in range(1000))
    lines = BatchOutcome(runs).failure_lines()
    assert lines[0] == "999 of 1000 recordings failed:"
    assert lines[1] == f"  {tmp_path / 'r1'}: why 1"
    assert len(lines) == 22
    assert lines[-1].startswith("  and 979 more")
    assert len(BatchOutcome(runs[:21]).failure_lines()) == 21
    assert BatchOutcome(runs[:1]).failure_lines() == []
