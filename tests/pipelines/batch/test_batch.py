"""Many recordings: what is done, what is left of those that fail, and what a second command makes of it."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal

import pyarrow.parquet as pq
import pytest

from quadlog.errors import CannotWrite, RecordingNotFound
from quadlog.pipelines import replay as replay_module
from quadlog.pipelines.batch import batch as batch_module
from quadlog.pipelines.batch.batch import BatchOutcome, replay_alone, replay_batch
from quadlog.pipelines.batch.plan import existing_runs, plan_batch, preview_batch
from quadlog.pipelines.batch.summary import rebuild_summary
from quadlog.pipelines.executor.progress import BatchLines, Silent
from quadlog.pipelines.replay import replay as really_replay
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayOutcome
from quadlog.results.tables import COST_NAMES
from tests.lab.kept import Kept
from tests.pipelines.conftest import results_of


def replay_all(batch, jobs=1, lines=None):
    return replay_batch(batch, jobs, None, BatchLines([].append if lines is None else lines.append))


def summary_of(output):
    return pq.read_table(output / "summary.parquet").to_pandas().set_index("recording")


def actions(batch):
    return sorted(each["action"] for each in preview_batch(batch))


class Assassin(BatchLines):
    """Kills the worker of a run when it says that it is amid a stage, so many times."""

    def __init__(self, victim, times):
        self.lines, self.killed = [], []
        super().__init__(self.lines.append)
        self._victim, self._times = victim, times

    def hear(self, step):
        pid = int(step["worker"].rpartition(":")[2])
        amid = step["stage"] == "position" and step["run"] == self._victim
        if amid and pid not in self.killed and len(self.killed) < self._times:
            self.killed.append(pid)
            os.kill(pid, signal.SIGKILL)


@pytest.fixture(scope="module")
def finished(planned, tmp_path_factory):
    """All of the season by two processes, of which one is killed on the way: folder, outcome, what was said."""
    output, assassin = tmp_path_factory.mktemp("out") / "runs", Assassin("walk.db3", 1)
    outcome = replay_batch(planned(output, until="position"), 2, None, assassin)
    assert len(assassin.killed) == 1
    return output, outcome, assassin.lines


def test_neither_a_failure_nor_a_killed_worker_stops_the_rest_and_a_reason_is_left(finished, season):
    output, outcome, lines = finished
    assert not list(output.rglob("*.part"))
    assert outcome.exit_code == 3
    assert [run.failed for run in outcome.runs] == [True, False, False, False]
    summary = summary_of(output)
    assert set(summary.index) == {"broken", "walk.mcap", "walk.bag", "walk.db3"}
    assert summary.loc["broken", "exit_code"] == 1
    assert summary.loc["broken", "reason"].startswith("not a recording: unknown file format")
    assert [path.name for path in (output / "broken").iterdir()] == ["failed.json"]
    assert "not a recording: unknown file format" in (output / "report.html").read_text()
    assert summary.drop("broken")[list(COST_NAMES)].gt(0).all().all()
    assert summary.loc["walk.bag", "input_bytes"] == (season / "walk.bag").stat().st_size
    ended = [line for line in lines if re.match(r"\[[1-4]/4\] [^:]*: (done|not a|failed)", line)]
    assert sorted({line[:6] for line in lines if line.startswith("[")}) == [f"[{number}/4] " for number in range(1, 5)]
    assert sum(": done" in line for line in ended) == 3


def test_neither_processes_nor_a_kill_nor_the_container_change_a_result(finished, replayed_season):
    for name in ("walk.mcap", "walk.bag", "walk.db3"):
        assert results_of(finished[0] / name) == results_of(replayed_season / name), name
        for path in sorted((finished[0] / "walk.mcap").glob("*.parquet")):
            assert pq.read_table(path).equals(pq.read_table(finished[0] / name / path.name)), path.name


def test_what_would_happen_is_known_before_and_a_failure_counts_as_absent(planned, finished, tmp_path, monkeypatch):
    output = finished[0]
    with monkeypatch.context() as patch:
        patch.setattr(replay_module, "describe_input", lambda path: pytest.fail(f"{path} is hashed"))
        assert actions(planned(tmp_path / "runs")) == ["run"] * 4
    assert not (tmp_path / "runs").exists()
    assert actions(planned(output, until="position", existing=Existing.RESUME)) == ["run", "skip", "skip", "skip"]
    assert actions(planned(output)) == ["refuse", "refuse", "refuse", "run"]
    assert actions(planned(output, existing=Existing.FORCE)) == ["replace", "replace", "replace", "run"]
    assert actions(planned(output, until="map", existing=Existing.RESUME)) == ["resume"] * 3 + ["run"]
    assert len(existing_runs(planned(output))) == 3
    with pytest.raises(RecordingNotFound):
        planned(tmp_path / "runs", str(tmp_path))
    (tmp_path / "file").write_text("mine")
    with pytest.raises(CannotWrite, match="is no folder"):
        planned(tmp_path / "file")


def test_the_same_again_reuses_or_refuses_and_the_summary_stays(planned, finished):
    output, before, lines = finished[0], summary_of(finished[0]), []
    again = replay_all(planned(output, until="position", existing=Existing.RESUME), lines=lines)
    assert again.exit_code == 3
    assert sum("; reused 1 of 1 stages: position" in line for line in lines) == 3
    refused = replay_all(planned(output, "walk.bag", "walk.db3"))
    assert refused.exit_code == 1
    assert all("--resume to continue" in run.reason for run in refused.runs)
    assert summary_of(output).equals(before)
    assert rebuild_summary(output) == output / "report.html"
    assert summary_of(output).equals(before)


@pytest.mark.usefixtures("in_this_process")
def test_a_failure_stays_in_the_summary_until_the_recording_is_replayed(planned, season, season_config, tmp_path):
    def replayed(name, existing=Existing.REFUSE):
        arguments = (tmp_path / "runs", season_config, ReplayOptions(until="ingest"), existing, ())
        replay_all(plan_batch([str(tmp_path / name)], *arguments))
        return dict(summary_of(tmp_path / "runs")["exit_code"])

    for name in ("one.bag", "two.bag"):
        shutil.copy(season / "walk.bag", tmp_path / name)
    assert replayed("one.bag") == {"one": 0}
    (tmp_path / "one.bag").write_text("damaged since")
    assert replayed("one.bag", Existing.FORCE) == {"one": 1}
    assert replayed("two.bag") == {"one": 1, "two": 0}
    assert "not a recording" in summary_of(tmp_path / "runs").loc["one", "reason"]
    shutil.copy(season / "walk.bag", tmp_path / "one.bag")
    assert replayed("one.bag", Existing.RESUME) == {"one": 0, "two": 0}
    shutil.rmtree(tmp_path / "runs" / "one")
    assert replayed("two.bag", Existing.FORCE) == {"two": 0}


@pytest.mark.usefixtures("in_this_process")
def test_a_run_that_somebody_finishes_meanwhile_is_not_touched(planned, tmp_path):
    class Racing(BatchLines):
        """Finishes the second recording, asked for less, while the first one is replayed."""

        def expect(self, tally):
            replay_alone(planned(tmp_path / "runs", "walk.bag", "walk.db3")[1], Silent())

    batch = planned(tmp_path / "runs", "walk.bag", "walk.db3", until="position")
    outcome = replay_batch(batch, 1, None, Racing([].append))
    assert [run.failed for run in outcome.runs] == [False, True]
    assert "--force to replace it or --resume to continue" in outcome.runs[1].reason
    assert json.loads((tmp_path / "runs" / "walk.db3" / "run.json").read_text())["options"]["until"] == "ingest"


def test_somebody_elses_report_and_folder_are_left_alone(planned, tmp_path):
    (tmp_path / "report.html").write_text("my thesis")
    assert replay_alone(planned(tmp_path, "walk.bag")[0], kept := Kept()).exit_code == 0
    assert ((tmp_path / "report.html").read_text(), (tmp_path / "summary.parquet").exists()) == ("my thesis", False)
    assert any("is left alone" in line for line in kept.lines)
    thesis = tmp_path / "runs" / "walk" / "thesis.tex"
    thesis.parent.mkdir(parents=True)
    thesis.write_text("mine")
    assert replay_all(planned(tmp_path / "runs", "walk.bag", existing=Existing.FORCE)).exit_code == 1
    assert list(thesis.parent.iterdir()) == [thesis]


def test_thousands_of_failures_are_counted_and_some_of_them_named(tmp_path):
    runs = tuple(ReplayOutcome(tmp_path / f"r{n}", tmp_path / f"{n}", 1 if n else 0, f"why {n}") for n in range(1000))
    lines = BatchOutcome(runs).failure_lines()
    assert (lines[0], len(lines), lines[-1][:14]) == ("999 of 1000 recordings failed:", 22, "  and 979 more")
    assert BatchOutcome(runs[:1]).failure_lines() == []


@pytest.mark.nightly
def test_a_recording_whose_worker_is_killed_twice_fails_and_is_resumed(planned, replayed_season, tmp_path):
    batch = planned(tmp_path / "runs", "walk.bag", until="position")
    outcome = replay_batch(batch, 1, None, Assassin("walk", 2))
    assert outcome.runs[0].reason.startswith("its worker was killed, and so was the next one, ")
    assert outcome.runs[0].reason.endswith(" MB at its peak; out of memory is the usual cause; --resume goes on")
    again = planned(tmp_path / "runs", "walk.bag", until="position", existing=Existing.RESUME)
    assert replay_alone(again[0], Silent()).exit_code == 0
    assert results_of(tmp_path / "runs" / "walk") == results_of(replayed_season / "walk.bag")
    assert not list((tmp_path / "runs").rglob("*.part"))


def instead(monkeypatch, raised):
    """replay, but for recordings of which there is something else to raise; returns the runs begun."""
    begun = []

    def replay(request, progress):
        begun.append(request.run.name)
        if request.run.name in raised:
            raise raised[request.run.name]
        return really_replay(request, progress)

    monkeypatch.setattr(batch_module, "replay", replay)
    return begun


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ImportError("a.so: failed to map segment from shared object"), r"out of memory, \d+ MB .*"),
        (ZeroDivisionError("by 0"), "a bug in quadlog: ZeroDivisionError: by 0"),
    ],
    ids=repr,
)
def test_an_error_is_one_recordings_and_only_a_bug_has_a_traceback(
    planned, tmp_path, monkeypatch, capsys, error, words
):
    instead(monkeypatch, {"walk.bag": error})
    outcome = replay_all(planned(tmp_path / "runs"))
    assert [run.failed for run in outcome.runs] == [True, True, False, False]
    assert re.fullmatch(words, outcome.runs[1].reason)
    assert ("Traceback" in capsys.readouterr().err) == words.startswith("a bug")
