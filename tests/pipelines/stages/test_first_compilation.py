from __future__ import annotations

import subprocess
import sys

import pytest
from numba import njit

from quadlog.pipelines.stages import first_compilation
from quadlog.pipelines.stages.first_compilation import SAID, compiled_elsewhere, python
from quadlog.pipelines.stages.warm_up import ALIKE, warm_up


def compile_something() -> None:
    njit(lambda x: x + 1)(1)


@pytest.fixture
def marks(tmp_path):
    """A file, and the command that makes it."""
    return tmp_path / "mark", python("-c", f"open({str(tmp_path / 'mark')!r}, 'w')")


@pytest.mark.parametrize(("cores", "is_run"), [(2, True), (1, False)])
def test_the_first_compilation_is_said_once_and_another_process_helps_on_a_second_core(
    marks, monkeypatch, cores: int, is_run: bool
) -> None:
    mark, command = marks
    monkeypatch.setattr(first_compilation, "cores", lambda: cores)
    said: list[str] = []
    with compiled_elsewhere(command, said.append):
        compile_something()
        compile_something()
    assert said == [SAID]
    assert mark.exists() == is_run, "the command is through when the body is"


def test_where_all_is_compiled_nothing_is_said_or_run(marks) -> None:
    mark, command = marks
    said: list[str] = []
    with compiled_elsewhere(command, said.append):
        pass
    assert said == []
    assert not mark.exists()


def test_a_command_that_fails_or_hangs_harms_nothing(monkeypatch) -> None:
    monkeypatch.setattr(first_compilation, "cores", lambda: 2)
    monkeypatch.setattr(first_compilation, "LONGEST_S", 0.01)
    for code in ("raise SystemExit(3)", "import threading; threading.Event().wait()"):
        said: list[str] = []
        with compiled_elsewhere(python("-c", code), said.append):
            compile_something()
        assert said == [SAID]


def test_the_folder_it_is_started_in_is_no_place_for_modules(tmp_path, monkeypatch) -> None:
    (tmp_path / "numba.py").write_text("raise SystemExit(1)")
    monkeypatch.chdir(tmp_path)
    command = python("-c", "import sys; sys.exit('' in sys.path or '.' in sys.path)")
    assert subprocess.run(command, check=False).returncode == 0
    assert command[0] == sys.executable


def test_the_parts_are_compiled_by_the_module_itself() -> None:
    ran = subprocess.run(python("-m", warm_up.__module__, *ALIKE), check=False, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
