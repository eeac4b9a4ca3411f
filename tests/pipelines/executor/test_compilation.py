from __future__ import annotations

import subprocess
import sys
import time

import pytest
from numba import njit

from quadlog.config.file import load_config
from quadlog.pipelines.executor import compilation as module
from quadlog.pipelines.executor.compilation import SAID, compilation, compiling_s, on_first_compilation
from quadlog.pipelines.executor.progress import StageClock

CONFIG = load_config(None, ["simulation.controller=fpmw"], {})


def compile_something() -> None:
    njit(lambda x: x + 1)(1)


def test_stages_are_timed_without_what_they_compile() -> None:
    clock, before_s, began_s = StageClock(), compiling_s(), time.perf_counter()
    with clock.stage("plan"):
        compile_something()
    compiled_s, whole_s = compiling_s() - before_s, time.perf_counter() - began_s
    assert 0.01 < compiled_s < whole_s
    assert clock.seconds["plan"] == pytest.approx(whole_s - compiled_s, abs=0.01)


@pytest.mark.parametrize(("cores", "parent", "helps"), [(2, None, True), (1, None, False), (2, "a batch", False)])
def test_the_first_compilation_is_said_once_and_a_second_process_helps_on_a_second_core(
    monkeypatch, cores: int, parent: str | None, helps: bool
) -> None:
    said, started = [], []
    monkeypatch.setattr(module, "cores", lambda: cores)
    monkeypatch.setattr(module, "parent_process", lambda: parent)
    monkeypatch.setattr(module.subprocess, "Popen", lambda command, **_: started.append(command[-1]) or Ended())
    with compilation(("position", "map", "control"), CONFIG, said.append) as before:
        before("map")
        compile_something()
        compile_something()
        before("control")
    assert said == [SAID]
    assert started == (["fpmw"] if helps else [])


class Ended:
    """A process that has ended."""

    def wait(self, _: float | None = None) -> None: ...
    def kill(self) -> None: ...


def test_what_has_begun_here_is_not_compiled_elsewhere_and_what_is_compiled_is_not_mentioned(monkeypatch) -> None:
    monkeypatch.setattr(module, "cores", lambda: 2)
    monkeypatch.setattr(module.subprocess, "Popen", pytest.fail)
    said: list[str] = []
    with compilation(("position", "control"), CONFIG, said.append) as before:
        before("control")
        assert said == []
        compile_something()
    assert said == [SAID]


def test_a_second_process_that_fails_is_not_waited_for(monkeypatch) -> None:
    monkeypatch.setattr(module, "cores", lambda: 2)
    monkeypatch.setattr(module, "sys", type("Own", (), {"executable": "/bin/false"}))
    with compilation(("control",), CONFIG, [].append) as before:
        compile_something()
        before("control")


def test_a_body_that_compiles_is_told_of_once() -> None:
    told: list[int] = []
    with on_first_compilation(lambda: told.append(1)):
        compile_something()
        compile_something()
    assert told == [1]


@pytest.mark.parametrize("controller", ["fpmw", "fpm"])
def test_the_module_itself_compiles_what_is_shared(controller) -> None:
    command = [sys.executable, "-P", "-m", module.__name__, controller]
    ran = subprocess.run(command, check=False, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
