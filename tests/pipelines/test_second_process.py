"""Stage `control` in a second process: the same run, whatever becomes of it, and nothing of it is left."""

from __future__ import annotations

import json
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from quadlog.pipelines.batch.batch import replay_alone
from quadlog.pipelines.executor import second_process as module
from quadlog.pipelines.executor.progress import Progress
from quadlog.pipelines.request import ReplayOutcome
from tests.pipelines.conftest import results_of, undrawn


class Steps(Progress):
    """Counts the steps of each stage; does something when the first of one is done."""

    def __init__(self, stage, do) -> None:
        self.totals, self.counts, self._when, self._do = {}, {}, stage, do

    def begin(self, stage: str, total: int | None) -> None:
        self.totals[stage], self.counts[stage] = total, 0

    def advance(self, recorded_s: float | None = None) -> None:
        stage = next(reversed(self.totals))
        self.counts[stage] += 1
        if (stage, self.counts[stage]) == (self._when, 1):
            self._do()


@pytest.mark.parametrize("killed_at", [None, "plan", "control"])
def test_a_run_is_the_same_whether_its_second_process_lives_or_is_killed_and_nothing_of_that_is_left(
    short_run: ReplayOutcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, killed_at: str | None
) -> None:
    started, scratches, begin = [], [], module.SecondProcess.__init__

    def start(second, request, scratch, progress):
        begin(second, request, scratch, progress)
        started.append(second._process)
        scratches.append(scratch)

    monkeypatch.setattr(module.SecondProcess, "__init__", start)
    monkeypatch.setattr(module, "cores", lambda: 2)
    shown = Steps(killed_at, lambda: started[0].kill())
    (run,) = replay_alone(undrawn(tmp_path / "follow"), shown).runs
    expected = {name: each for name, each in results_of(short_run.run).items() if not name.startswith("plots/")}
    assert results_of(run.run) == expected
    assert started[0].returncode == (0 if killed_at is None else -signal.SIGKILL)
    assert shown.totals["control"] == shown.totals["plan"] == shown.counts["plan"]
    assert shown.counts["control"] > 0
    assert not scratches[0].exists()
    kept = json.loads((run.run / "run.json").read_text())["results"]
    assert {each.name for each in (tmp_path / ".stages").iterdir()} <= set(kept.values())
    assert run.reused == ()


@pytest.mark.parametrize(
    ("cores", "controller", "parent"),
    [(1, "fpmw", None), (2, "kinematic", None), (2, "command", None), (2, "of_a_plugin", None), (2, "fpmw", "a batch")],
)
def test_there_is_none_on_one_core_for_what_is_not_its_own_and_in_a_batch(monkeypatch, cores, controller, parent):
    monkeypatch.setattr(module, "cores", lambda: cores)
    monkeypatch.setattr(module, "parent_process", lambda: parent)
    request = undrawn(Path("run"))
    simulation = request.config.simulation.model_copy(update={"controller": controller})
    request = replace(request, config=request.config.model_copy(update={"simulation": simulation}))
    with module.second_process(("plan", "control"), request, Progress()) as second:
        assert second is None


def test_it_imports_what_this_process_would_and_an_error_of_its_own_ends_it_without_an_abort(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['quadlog.pipelines.stages.maps'] = None\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(module, "cores", lambda: 2)
    with module.second_process(("plan", "control"), undrawn(Path("run")), Progress()) as second:
        assert second._process.wait(20) == 1
