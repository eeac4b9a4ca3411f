"""The example script, as a newcomer runs it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "examples" / "compare_two_planners.py"


@pytest.mark.nightly
def test_the_script_compares_two_replays_of_the_committed_recording(tmp_path):
    done = subprocess.run([sys.executable, SCRIPT], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines()}
    assert rows["metric"] == ["astar", "ia_star"]
    assert float(rows["expanded_mean"][0]) > float(rows["expanded_mean"][1]) > 0
    assert rows["collisions"] == ["0", "0"]
    assert (tmp_path / "planners.png").read_bytes().startswith(b"\x89PNG")
    assert all((tmp_path / "runs" / planner / "follow" / "report.html").is_file() for planner in rows["metric"])
