from __future__ import annotations

import subprocess
import sys

import pytest
from numba import njit

from quadlog.pipelines.executor import compilation as first_compilation
from quadlog.pipelines.executor.compilation import SAID, Compilation, on_first_compilation, python
from quadlog.pipelines.stages import warm_up

ELSEWHERE = python(
    "-c", "import sys; open(sys.argv[1], 'w').write(' '.join(sys.argv[2:])); print(*sys.argv[2:], sep='\\n')"
)


def compile_something() -> None:
    njit(lambda x: x + 1)(1)


def compilation(parts, said, elsewhere) -> Compilation:
    return Compilation(parts, ("b", "d"), elsewhere, said.append)


@pytest.mark.parametrize(("cores", "given"), [(2, "b d"), (1, None)])
def test_the_first_compilation_is_said_once_and_another_process_helps_on_a_second_core(
    tmp_path, monkeypatch, cores: int, given: str | None
) -> None:
    monkeypatch.setattr(first_compilation, "cores", lambda: cores)
    mark, said, run = tmp_path / "mark", [], []
    parts = {name: lambda name=name: (run.append(name), compile_something()) for name in "abcd"}
    with compilation(parts, said, [*ELSEWHERE, str(mark)]) as compiled:
        compiled.before("a", "b", "c")
        assert (mark.read_text() if mark.exists() else None) == given, "what is shared is waited for"
        compiled.before("b", "d", "not needed here")
    assert said == [SAID]
    assert run == ["a", "b", "c", "d"]
    assert compiled.seconds > 0


def test_what_has_begun_here_is_not_compiled_elsewhere(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(first_compilation, "cores", lambda: 2)
    mark = tmp_path / "mark"
    with compilation({"b": compile_something}, [], [*ELSEWHERE, str(mark)]) as compiled:
        compiled.before("b")
    assert not mark.exists()


def test_a_worker_of_a_batch_compiles_alone(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(first_compilation, "cores", lambda: 2)
    monkeypatch.setattr(first_compilation, "parent_process", lambda: "the batch")
    mark = tmp_path / "mark"
    with compilation({"a": compile_something, "b": int}, [], [*ELSEWHERE, str(mark)]) as compiled:
        compiled.before("a", "b")
    assert not mark.exists()


def test_where_all_is_compiled_nothing_is_said_or_run(tmp_path) -> None:
    said: list[str] = []
    with compilation({"a": int, "b": int}, said, [*ELSEWHERE, str(tmp_path / "mark")]) as compiled:
        compiled.before("a", "b")
    assert said == []
    assert not (tmp_path / "mark").exists()


@pytest.mark.parametrize("code", ["raise SystemExit(3)", "import threading; threading.Event().wait()"])
def test_a_command_that_fails_or_hangs_harms_nothing(monkeypatch, code) -> None:
    monkeypatch.setattr(first_compilation, "cores", lambda: 2)
    monkeypatch.setattr(first_compilation, "LONGEST_S", 0.01)
    done: list[str] = []
    parts = {"a": compile_something, "b": lambda: done.append("b")}
    with compilation(parts, [], python("-c", code)) as compiled:
        compiled.before("a", "b")
    assert done == ["b"]


def test_a_body_that_compiles_is_told_of_once() -> None:
    told: list[int] = []
    with on_first_compilation(lambda: told.append(1)):
        compile_something()
        compile_something()
    assert told == [1]


def test_the_folder_it_is_started_in_is_no_place_for_modules(tmp_path, monkeypatch) -> None:
    (tmp_path / "numba.py").write_text("raise SystemExit(1)")
    monkeypatch.chdir(tmp_path)
    command = python("-c", "import sys; sys.exit('' in sys.path or '.' in sys.path)")
    assert subprocess.run(command, check=False).returncode == 0
    assert command[0] == sys.executable


@pytest.mark.parametrize("controller", ["fpmw", "fpm"])
def test_the_module_itself_compiles_what_is_shared(controller) -> None:
    ran = subprocess.run(
        python("-m", warm_up.__name__, controller, "position", "control"), check=False, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.split() == ["position", "control"]
