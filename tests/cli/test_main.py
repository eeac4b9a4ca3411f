from __future__ import annotations

import shlex
import subprocess
import sys

import pytest
from click.testing import CliRunner

from quadlog.cli.main import COMMANDS, cli, run
from quadlog.version import __version__

HEAVY = ("numpy", "scipy", "pandas", "pyarrow", "matplotlib", "numba", "pydantic", "rich", "rosbags", "mcap", "open3d")


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)])
def test_help_imports_nothing_heavy(arguments):
    code = (
        "import sys\nfrom quadlog.cli.main import run\n"
        f"code = run({arguments!r})\n"
        f"assert code == 0, code\nprint([m for m in {HEAVY!r} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr == "[]\n"
    assert done.returncode == 0


def test_version(capsys):
    assert run(["--version"]) == 0
    assert __version__ in capsys.readouterr().out


def test_unknown_command_is_usage(capsys):
    assert run(["replya"]) == 2
    assert "replya" in capsys.readouterr().err


def test_missing_argument_is_usage():
    assert run(["replay"]) == 2


def test_a_known_error_is_one_line_and_the_exit_code_is_one(tmp_path, capsys):
    assert run(["info", str(tmp_path / "none.mcap")]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("quadlog: ")
    assert captured.err.count("\n") == 1
    assert "none.mcap" in captured.err


def test_every_command_says_what_it_does():
    for name in COMMANDS:
        command = cli.get_command(None, name)  # type: ignore[arg-type]
        assert command is not None
        assert command.name == name
        assert command.help


@pytest.mark.parametrize("name", COMMANDS)
def test_help_ends_with_examples_that_the_command_takes(name):
    command = cli.get_command(None, name)  # type: ignore[arg-type]
    assert command is not None
    shown = CliRunner().invoke(command, ["--help"]).output
    examples = shown[shown.index("\n  Examples:\n") :].splitlines()[2:]
    assert examples
    for example in examples:
        program, typed, *arguments = shlex.split(example)
        assert (program, typed) == ("quadlog", name)
        assert command.make_context(name, arguments).params


def test_a_closed_pipe_ends_quietly():
    script = f"{sys.executable} -c 'from quadlog.cli.main import main; main()' --help | head -n 1"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.stdout.startswith("Usage: quadlog")


@pytest.mark.parametrize("error", [MemoryError(), MemoryError("no room\nfor an array"), OSError(12, "no memory")])
def test_a_lack_of_memory_is_one_line(error, monkeypatch, capsys):
    def fail(*_arguments, **_options):
        raise error

    monkeypatch.setattr(cli, "main", fail)
    assert run(["info"]) == 1
    said = capsys.readouterr().err
    assert (said.startswith("quadlog: "), "memory" in said, said.count("\n")) == (True, True, 1)


def test_what_is_no_lack_of_memory_stays_a_traceback(monkeypatch):
    def fail(*_arguments, **_options):
        raise ValueError("a bug")

    monkeypatch.setattr(cli, "main", fail)
    with pytest.raises(ValueError, match="a bug"):
        run(["info"])


@pytest.mark.parametrize("name", COMMANDS)
def test_who_is_interrupted_is_told_how_to_go_on_where_that_can_be(name, monkeypatch, capsys):
    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "main", interrupted)
    assert run([name]) == 1
    said = capsys.readouterr().err
    assert said.startswith("quadlog: interrupted; nothing half-written was left")
    command = cli.get_command(None, name)  # type: ignore[arg-type]
    assert command is not None
    assert ("--resume" in said) == any("--resume" in option.opts for option in command.params)
