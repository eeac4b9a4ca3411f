"""Commands that a signal ends, in processes of their own: one line, exit code 1, and no unfinished file."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

from quadlog.cli.main import run
from quadlog.results import planners as comparison_text
from quadlog.results.page import planners as comparison_page

# They would take hours.
ENDLESS = {
    "synthesize": ["synthesize", "follow", "-o", "walk.mcap", "--duration", "3600"],
    "compare-planners": ["compare-planners", "forest:0.2", "-o", "out", "--episodes", "100000"],
}
SHORT = {
    "synthesize": ["synthesize", "follow", "-o", "other.mcap", "--duration", "0.2", "--azimuth-steps", "16"],
    "compare-planners": ["compare-planners", "forest:0.1", "-o", "out", "--episodes", "1", "--planner", "ia_star"],
}


def ended(name, number, folder):
    """The exit code and the lines on stderr of an endless command, once it has begun to write and got the signal."""
    words = [sys.executable, "-m", "quadlog", *ENDLESS[name]]
    process = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not list(folder.iterdir()):
        assert process.poll() is None, process.communicate()
        time.sleep(0.005)
    process.send_signal(number)
    _, err = process.communicate()
    return process.returncode, err.splitlines()


@pytest.mark.parametrize(
    ("name", "number", "words"),
    [
        ("synthesize", signal.SIGTERM, "interrupted by SIGTERM"),
        ("synthesize", signal.SIGHUP, "interrupted by SIGHUP"),
        ("compare-planners", signal.SIGINT, "interrupted"),
    ],
)
def test_a_stopped_command_says_so_in_a_line_and_leaves_nothing(name, number, words, tmp_path):
    code, lines = ended(name, number, tmp_path)
    assert (code, lines) == (1, [f"quadlog: {words}; nothing half-written was left"])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.nightly
@pytest.mark.parametrize("name", ENDLESS)
def test_the_next_start_removes_what_a_killed_one_left(name, tmp_path, monkeypatch, capsys):
    assert ended(name, signal.SIGKILL, tmp_path) == (-signal.SIGKILL, [])
    monkeypatch.chdir(tmp_path)
    assert run(SHORT[name]) == 0, capsys.readouterr().err
    assert not list(tmp_path.rglob("*.part"))


def test_an_interrupt_after_the_last_file_says_that_the_result_is_complete(tmp_path, monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    assert comparison_page.format_rows is comparison_text.format_rows  # imported before it is replaced
    monkeypatch.setattr(comparison_text, "format_rows", interrupted)  # what is printed on stdout in the end
    assert run(SHORT["compare-planners"]) == 1
    assert capsys.readouterr().err == "quadlog: interrupted; the result in out is complete\n"
    assert (tmp_path / "out" / "report.html").is_file()


def test_a_signal_that_a_destructor_swallows_comes_again():
    code = """
import os, signal, click
from quadlog.cli import main
class Swallows:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
@click.command()
def command():
    Swallows()
    while True:
        signal.pause()
main.LazyGroup.get_command = lambda *_: command
main.main()
"""
    done = subprocess.run([sys.executable, "-c", code, "info"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "quadlog: interrupted by SIGTERM; nothing half-written was left\n"


def test_an_interrupt_within_generated_code_has_the_same_exit_code(tmp_path):
    """Python marks a plain KeyboardInterrupt that leaves `exec`, and then ends a `python -m` by SIGINT."""
    (tmp_path / "stopped.py").write_text(
        "import os, signal, sys\n"
        "from quadlog.pipelines.executor.machine import take_one_interrupt\n"
        "take_one_interrupt()\n"
        "try:\n"
        "    exec('os.kill(os.getpid(), signal.SIGTERM)\\nwhile True: pass')\n"
        "except KeyboardInterrupt as error:\n"
        "    sys.exit(f'{error}')\n"
    )
    found = subprocess.run([sys.executable, "-m", "stopped"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stderr) == (1, "SIGTERM\n")
