"""What a shell gets when the tab key is pressed, through the installed command's own entry point."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from typing import get_args

import pytest

from quadlog.cli.main import COMMANDS
from quadlog.config.control import Simulation
from quadlog.config.file import PRESETS
from quadlog.config.planners import PLANNER_NAMES
from quadlog.config.plugins import PLANNERS as GROUP
from quadlog.results.stages import STAGES

HEAVY = ("numpy", "scipy", "pandas", "pyarrow", "numba", "pydantic", "rich", "rosbags", "mcap", "mujoco", "jinja2")
MAIN = ("-m", "quadlog")


def press_tab(typed: str, shell: str = "bash", python: Sequence[str] = MAIN) -> list[str]:
    """What the command answers to a line that ends where the cursor is; a space at its end begins another word."""
    words = ["quadlog", *typed.split()]
    if typed.endswith(" ") or not typed:
        words.append("")
    at = {"fish": words[-1], "bash": str(len(words) - 1), "zsh": str(len(words) - 1)}[shell]
    environment = {"_QUADLOG_COMPLETE": f"{shell}_complete", "COMP_WORDS": " ".join(words), "COMP_CWORD": at}
    done = subprocess.run(
        [sys.executable, *python], env=os.environ | environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()


def offered(typed: str) -> list[str]:
    """The words that bash is told."""
    return [line.partition(",")[2] for line in press_tab(typed) if line.startswith("plain,")]


def test_commands():
    assert set(offered("")) == set(COMMANDS)
    assert offered("compare") == ["compare-planners"]


@pytest.mark.parametrize(
    ("typed", "choices"),
    [
        ("replay --until ", STAGES),
        ("replay --preset ", PRESETS),
        ("replay --planner ", PLANNER_NAMES),
        ("replay --controller ", get_args(Simulation.model_fields["controller"].annotation)),
        ("compare-planners --planner ", PLANNER_NAMES),
        ("compare-planners --leader mt", ["mt_d_star_lite"]),
        ("synthesize f", ["follow", "forest"]),
        ("tables planning-e", ["planning-ea"]),
        ("replay --dry", ["--dry-run"]),
    ],
)
def test_choices(typed, choices):
    assert sorted(offered(typed)) == sorted(choices)


@pytest.mark.parametrize("typed", ["info wa", "replay wa", "replay -c wa", "compare-planners wa", "report wa"])
def test_files_are_left_to_the_shell(typed):
    assert press_tab(typed) in (["file,wa"], ["dir,wa"])


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ("compare-planners f", ["forest:"]),
        ("simulate ", ["line", "circle", "s-curve", "trot-32s"]),
        ("simulate line --terrain 3", ["3cm"]),
    ],
)
def test_words_beside_files(typed, words):
    assert press_tab(typed) == [*(f"plain,{each}" for each in words), f"file,{typed.rpartition(' ')[2]}"]


def test_planners_of_plugins_are_offered_and_not_imported(install):
    install("quadlog-zig", "1.0", {GROUP: {"zigzag": "zig:Zigzag"}}, {"zig": "raise SystemExit(9)"})
    assert offered("replay --planner z") == ["zigzag"]
    assert offered("compare-planners --planner z") == ["zigzag"]


@pytest.mark.parametrize("typed", ["", *(f"{command} --h" for command in COMMANDS), "replay --planner "])
def test_nothing_heavy_is_imported(typed):
    code = (
        "import atexit, sys\n"
        f"atexit.register(lambda: print([m for m in {HEAVY!r} if m in sys.modules], file=sys.stdout))\n"
        "from quadlog.cli.main import main; main()"
    )
    *offered, heavy = press_tab(typed, python=("-c", code))
    assert heavy == "[]"
    assert "plain,--help" in offered or not typed.endswith("--h")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_every_shell_asks_this_command(shell):
    done = subprocess.run(
        [sys.executable, *MAIN],
        env=os.environ | {"_QUADLOG_COMPLETE": f"{shell}_source"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0
    assert f"_QUADLOG_COMPLETE={shell}_complete" in done.stdout
    assert any("replay" in line for line in press_tab("repl", shell))


def test_bash_itself_completes(tmp_path):
    """The script is sourced and its function called as bash calls it; what it fills in is what a user sees."""
    command = tmp_path / "quadlog"
    command.write_text(f"#!/bin/sh\nexec {sys.executable} -m quadlog\n")
    command.chmod(0o755)
    script = (
        'eval "$(_QUADLOG_COMPLETE=bash_source quadlog)"\n'
        "COMP_WORDS=(quadlog replay --until f); COMP_CWORD=3\n"
        "complete -p quadlog >/dev/null && _quadlog_completion quadlog f --until 2>/dev/null\n"
        'echo "${COMPREPLY[@]}"'
    )
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "--norc", "-c", script], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout == "filter\n"
