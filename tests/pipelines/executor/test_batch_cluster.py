"""A batch on a real Dask cluster."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from quadlog.pipelines.batch import batch
from quadlog.pipelines.batch.batch import replay_batch
from quadlog.pipelines.batch.progress import BatchLines


class Watching(BatchLines):
    """Kills the worker that says first that it is amid a recording; keeps where each was replayed."""

    def __init__(self, pids=None):
        self.lines, self.pids, self.killed = [], pids or {}, []
        super().__init__(self.lines.append)

    def hear(self, step):
        if self.pids and not self.killed:
            self.killed.append(step["worker"])
            os.kill(self.pids[step["worker"]], signal.SIGKILL)


@pytest.fixture
def scheduler(cluster) -> str:
    return cluster.scheduler_address


@pytest.fixture
def pids(scheduler):
    from distributed import Client

    with Client(scheduler, set_as_default=False) as client:
        return client.run(os.getpid)


def test_a_cluster_gives_the_same_bytes_also_when_a_worker_is_killed(
    planned, replayed_season, saved, scheduler, pids, tmp_path
):
    watching = Watching(pids)
    outcome = replay_batch(planned(tmp_path / "runs", until="position"), 1, scheduler, watching)
    assert watching.killed
    assert outcome.exit_code == 3
    assert [run.failed for run in outcome.runs] == [True, False, False, False]
    for run in outcome.runs:
        assert run.failed or saved(run.run) == saved(replayed_season / run.run.name)
    assert watching.lines[0] == "2 workers"
    assert {run.cost["worker"].split(":")[0] for run in outcome.runs if not run.failed} == {"tcp"}
    assert not list((tmp_path / "runs").rglob(".*"))


def test_a_folder_that_workers_do_not_see_is_each_recordings_failure(planned, scheduler, tmp_path, monkeypatch):
    task = batch._task

    def elsewhere(*given):
        made = task(*given)
        request = replace(made.request, recording=Path("/nowhere/walk.bag"))
        return replace(made, request=request) if made.number == 0 else replace(made, shared=Path("/nowhere/shared"))

    monkeypatch.setattr(batch, "_task", elsewhere)
    two = planned(tmp_path / "runs", "walk.bag", "walk.db3")
    outcome = replay_batch(two, 1, scheduler, Watching())
    first, second = (run.reason for run in outcome.runs)
    assert first.startswith("is not to be seen from worker tcp://127.0.0.1:")
    assert second.startswith("/nowhere: cannot be written: the folder is another one, or none, on worker tcp://127.0")
    assert outcome.exit_code == 1


def test_relative_paths_are_found_by_workers_and_told_as_they_were_given(planned, scheduler, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (only,) = planned(Path("runs"), "walk.bag")
    recording = Path(os.path.relpath(only.request.recording))
    only = replace(only, request=replace(only.request, recording=recording))
    outcome = replay_batch([only], 1, scheduler, Watching())
    assert outcome.exit_code == 0
    assert (outcome.runs[0].recording, outcome.runs[0].run) == (recording, Path("runs/walk"))
    assert (tmp_path / "runs" / "walk" / "run.json").is_file()
