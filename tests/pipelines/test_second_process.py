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


class Stages(Progress):
    """The steps that each stage has; `at_plan` is called when that begins, and the second process has its order."""

    def __init__(self, at_plan) -> None:
        self.totals, self._at_plan = {}, at_plan

    def begin(self, stage: str, total: int | None) -> None:
        self.totals[stage] = total
        if stage == "plan":
            self._at_plan()


@pytest.mark.parametrize("killed", [False, True])
def test_a_run_is_the_same_whether_its_second_process_lives_or_is_killed_and_nothing_of_that_is_left(
    short_run: ReplayOutcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, killed: bool
) -> None:
    started, scratches, begin = [], [], module.SecondProcess.__init__

    def start(second, request, scratch, progress):
        begin(second, request, scratch, progress)
        started.append(second._process)
        scratches.append(scratch)

    monkeypatch.setattr(module.SecondProcess, "__init__", start)
    monkeypatch.setattr(module, "cores", lambda: 2)
    shown = Stages(lambda: started[0].kill() if killed else None)
    (run,) = replay_alone(undrawn(tmp_path / "follow"), shown).runs
    expected = {name: each for name, each in results_of(short_run.run).items() if not name.startswith("plots/")}
    assert results_of(run.run) == expected
    assert started[0].returncode == (-signal.SIGKILL if killed else 0)
    assert shown.totals["control"] == shown.totals["plan"]
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
