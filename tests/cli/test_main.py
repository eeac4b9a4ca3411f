from __future__ import annotations

import os
import shlex
import subprocess
import sys
from importlib.metadata import version

import click
import numpy
import pytest
from click.testing import CliRunner

from quadlog.cli.main import COMMANDS, cli, print_versions, run
from quadlog.config.plugins import DECODERS, PLANNERS
from quadlog.version import __version__

HEAVY = ("numpy", "scipy", "pandas", "pyarrow", "matplotlib", "numba", "pydantic", "rich", "rosbags", "mcap", "open3d")
HEAVY += ("mujoco", "foxglove")
BUILT_ON = ("daqp", "foxglove-sdk", "mcap", "mujoco", "numba", "numpy", "pandas", "pyarrow", "quadprog", "scipy")


LINES = 40
"""Of a terminal: longer help scrolls off."""


def command_of(name: str) -> click.Command:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    return command


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)])
def test_help_imports_nothing_heavy(arguments):
    code = (
        "import sys\nfrom quadlog.cli.main import run\n"
        f"code = run({arguments!r})\n"
        f"assert code == 0, code\nprint([m for m in {HEAVY!r} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stderr, done.returncode) == ("[]\n", 0)


def test_versions_are_quadlogs_and_those_of_its_packages(ok):
    first, *rest = ok("--version").splitlines()
    assert first == f"quadlog, version {__version__}"
    told = dict(line.split() for line in rest)
    assert told["python"] == sys.version.split()[0]
    assert told["numpy"] == numpy.__version__
    assert {name: told[name] for name in BUILT_ON} == {name: version(name) for name in BUILT_ON}


def test_plugins_are_listed_and_not_imported(install, ok):
    points = {PLANNERS: {"zigzag": "zig:Zigzag", "astar": "zig:A"}, DECODERS: {"a.B": "zig:b"}}
    install("quadlog-zig", "0.7", points, {"zig": "raise SystemExit(9)"})
    assert ok("--version").splitlines()[-3:] == [
        "planner astar: quadlog-zig 0.7",
        "planner zigzag: quadlog-zig 0.7",
        "decoder a.B: quadlog-zig 0.7",
    ]


def test_completing_asks_for_no_version(capsys):
    """The option's callback also runs while a command line is completed."""
    context = click.Context(click.Command("quadlog"), resilient_parsing=True)
    print_versions(context, click.Option(["--version"]), True)
    assert capsys.readouterr() == ("", "")


def test_unknown_commands_and_missing_arguments_are_usage(refused):
    assert "replya" in refused(2, "replya")
    refused(2, "replay")


def test_standard_streams_that_the_shell_closed_are_no_bug():
    command = f"{shlex.quote(sys.executable)} -m quadlog"
    script = f"{command} --help >&- && {command} --help <&- >&- 2>&- && {command} --nothing >&-"
    done = subprocess.run(["sh", "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == "Error: No such option '--nothing'."


@pytest.mark.parametrize("arguments", [["synthesize", "follow"], ["simulate", "line", "--controller", "kinematic"]])
def test_an_output_whose_name_is_not_utf_8_is_one_line(tmp_path, refused, arguments):
    assert "its name is not UTF-8" in refused(1, *arguments, "-o", os.fsdecode(os.fsencode(tmp_path) + b"/q\xff.mcap"))
    assert list(tmp_path.iterdir()) == []


def test_code_that_cannot_be_kept_is_compiled_in_memory(tmp_path):
    """A read-only installation without a writable home: numba finds no folder."""
    (tmp_path / "file").touch()
    places = {
        "NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator",
        "NUMBA_CACHE_DIR": str(tmp_path / "file" / "in"),
    }
    code = (
        "import numpy as np\nfrom quadlog.compiled import kernel\n"
        "@kernel\ndef double(x):\n    return 2 * x\n@kernel\ndef half(x):\n    return x / 2\nprint(half(double(3)))"
    )
    (tmp_path / "kernels.py").write_text(code)
    command = [sys.executable, str(tmp_path / "kernels.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **places})
    assert done.stdout == "3.0\n"
    assert done.stderr.count("\n") == 1
    assert "NUMBA_CACHE_DIR" in done.stderr


def test_a_known_error_is_one_line_and_the_exit_code_is_one(tmp_path, refused):
    assert "none.mcap" in refused(1, "info", tmp_path / "none.mcap")


@pytest.mark.parametrize("name", COMMANDS)
def test_help_fits_a_screen_and_ends_with_examples_that_the_command_takes(name):
    command = command_of(name)
    assert command.name == name
    assert command.help
    shown = CliRunner().invoke(cli, [name, "--help"], terminal_width=80).output
    assert len(shown.splitlines()) <= LINES
    assert max(map(len, shown.splitlines())) <= 80
    examples = shown[shown.index("\n  Examples:\n") :].splitlines()[2:]
    assert examples
    for example in examples:
        program, typed, *arguments = shlex.split(example)
        assert (program, typed) == ("quadlog", name)
        assert command.make_context(name, arguments).params


def test_options_of_one_meaning_are_declared_alike():
    """The same flag has the same short form, type and default wherever a command has it; help may differ."""
    options = [each for name in COMMANDS for each in command_of(name).params if isinstance(each, click.Option)]
    for flag in ("--seed", "--set", "--config", "--json", "--msg-path", "--force", "--jobs", "--seeds", "--resume"):
        alike = [each for each in options if flag in each.opts]
        assert len(alike) > 1
        kinds = {(*each.opts, str(each.type), str(each.default), each.multiple, each.is_flag) for each in alike}
        assert len(kinds) == 1, kinds


def test_a_closed_pipe_ends_quietly():
    script = f"{sys.executable} -m quadlog --help | head -n 1"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.stdout.startswith("Usage: quadlog")


def failing(monkeypatch, error):
    def fail(*_arguments, **_options):
        raise error

    monkeypatch.setattr(cli, "main", fail)


@pytest.mark.parametrize("error", [MemoryError(), MemoryError("no room\nfor an array"), OSError(12, "no memory")])
def test_a_lack_of_memory_is_one_line(error, monkeypatch, refused):
    failing(monkeypatch, error)
    assert "memory" in refused(1, "info")


def test_what_is_no_lack_of_memory_stays_a_traceback(monkeypatch):
    failing(monkeypatch, ValueError("a bug"))
    with pytest.raises(ValueError, match="a bug"):
        run(["info"])


@pytest.mark.parametrize("name", COMMANDS)
def test_an_interrupted_command_says_how_to_go_on_where_that_can_be(name, monkeypatch, refused):
    failing(monkeypatch, KeyboardInterrupt())
    said = refused(1, name)
    assert said.startswith("quadlog: interrupted; nothing half-written was left")
    assert ("--resume" in said) == any("--resume" in option.opts for option in command_of(name).params)
