"""Commands that a signal ends, in processes of their own: one line, exit code 1, and no unfinished file."""

from __future__ import annotations

import glob
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

from quadlog.results.record import is_finished
from tests.cli.conftest import FOLLOW

# They would take hours.
ENDLESS = {
    "synthesize": "synthesize follow -o walk.mcap --duration 3600",
    "compare-planners": "compare-planners forest:0.2 -o out --episodes 100000",
}
REPLAY = ["replay", *FOLLOW, "-o", "runs", "--no-plots"]
NIGHTLY = pytest.mark.nightly


def ended(words, number, place, begun, group=False):
    """Exit code and lines on stderr of a command that gets the signal once there is such a file. No clock decides."""
    command = [sys.executable, "-m", "quadlog", *words]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, cwd=place, text=True, start_new_session=True, **pipes)
    while not glob.glob(f"{place}/**/{begun}", recursive=True, include_hidden=True):  # noqa: PTH207 - folders come and go
        assert process.poll() is None, process.communicate()
        time.sleep(0.005)
    (os.killpg if group else os.kill)(process.pid, number)
    _, err = process.communicate()  # ends when the last process that could write has ended
    assert "Traceback" not in err
    return process.returncode, err.splitlines()


@pytest.mark.parametrize(
    ("name", "number", "words"),
    [("synthesize", signal.SIGHUP, "interrupted by SIGHUP"), ("compare-planners", signal.SIGINT, "interrupted")],
)
def test_a_stopped_command_says_so_in_a_line_and_leaves_nothing(name, number, words, tmp_path):
    code, lines = ended(ENDLESS[name].split(), number, tmp_path, "*")
    assert (code, lines) == (1, [f"quadlog: {words}; nothing half-written was left"])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "number", [signal.SIGINT, *(pytest.param(each, marks=NIGHTLY) for each in (signal.SIGKILL, signal.SIGTERM))]
)
def test_a_stopped_replay_leaves_nothing_half_written_and_resumes(tmp_path, number, ok):
    code, lines = ended([*REPLAY, "--until", "map"], number, tmp_path, "fixes.parquet")
    assert code == (-number if number is signal.SIGKILL else 1)
    here = tmp_path / "runs" / "follow"
    assert not here.exists()
    if number is not signal.SIGKILL:
        assert lines[-1].startswith("quadlog: interrupted")
        assert not list(tmp_path.rglob("*.part"))
    resumed = ["--until", "position", "--resume", "-o", tmp_path / "runs"]
    ok(*REPLAY, *resumed)
    assert is_finished(here)
    assert not [path.name for path in here.iterdir() if path.name.startswith(".")]


@pytest.fixture
def two(tmp_path):
    for name in ("a", "b"):
        shutil.copy(FOLLOW[0], tmp_path / f"{name}.mcap")
    return ["replay", "a.mcap", "b.mcap", *REPLAY[2:]]


@pytest.mark.parametrize("number", [pytest.param(signal.SIGTERM, marks=NIGHTLY), signal.SIGINT])
def test_a_signal_stops_all_workers_and_leaves_what_resume_goes_on_from(tmp_path, two, ok, number, monkeypatch):
    """Ctrl-C as a terminal sends it: to the workers, too."""
    words = [*two, "--jobs", "2", "--until", "map"]
    code, lines = ended(words, number, tmp_path, "fixes.parquet", group=number is signal.SIGINT)
    assert code == 1
    assert any("interrupted with 0 of 2 recordings done" in line for line in lines)
    assert lines[-1].endswith("nothing half-written was left, and --resume goes on")
    assert not [*(tmp_path / "runs").rglob("*.part"), *(tmp_path / "runs").rglob("run.json")]
    monkeypatch.chdir(tmp_path)
    ok(*two, "--jobs", "1", "--until", "ingest", "--resume")
