"""`quadlog replay` of one recording and of several, as typed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import FIXTURES, FOLLOW


@pytest.fixture
def two(tmp_path):
    """Arguments that replay two copies of the committed recording."""
    for name in ("a", "b"):
        shutil.copy(FOLLOW[0], tmp_path / f"{name}.mcap")
    recordings = [str(tmp_path / f"{name}.mcap") for name in "ab"]
    return [*recordings, "--no-plots", *FOLLOW[1:], "-o", str(tmp_path / "runs"), "--until", "ingest"]


def test_results_go_to_stdout_and_messages_to_stderr(tmp_path, quadlog, ok):
    arguments = ["replay", "--no-plots", *FOLLOW, "-o", tmp_path / "runs", "--until", "position", "--duration", "1"]
    rows = json.loads(ok(*arguments, "--dry-run", "--json"))
    assert (rows[0]["action"], (tmp_path / "runs").exists()) == ("run", False)
    code, out, err = quadlog(*arguments)
    assert code == 0
    first, *sentences, page = out.splitlines()
    assert first.startswith(f"{tmp_path / 'runs' / 'follow'}: usable, ")
    assert {"Positions", "Recording", "Recorded walk"} <= {line.split(":")[0].strip() for line in sentences}
    assert any(line.startswith("  Recorded walk: The robot ") for line in sentences)
    assert page == str(tmp_path / "runs" / "follow" / "report.html")
    first = [line for line in err.splitlines() if not line.startswith("warning: ")]
    assert [line.split(" from ")[0] for line in first if "compiling" not in line][-1:] == ["robot position"]
    assert len(first) <= 3
    assert "ranges corrected by" in quadlog(*arguments, "-v", "--force").err
    (row,) = json.loads(ok(*arguments, "--json", "--force"))
    assert (row["run"], row["exit_code"]) == (str(tmp_path / "runs" / "follow"), 0)
    assert (type(row["uwb_residual_m"]), "eta_m" in row) == (float, False)


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        ("--force --resume", 2, "exclude each other"),
        ("--set uwb.tag_heigth_m=1", 1, "did you mean uwb.tag_height_m"),
        ("--controller mpc", 2, "'mpc' is not one of 'fpmw', 'fpm', 'pmw', 'kinematic', 'command', 'none'"),
        ("--planner astar --set planner.name=lpa_star", 2, "--planner astar and --set planner."),
        ("--set topics.lidar=/points", 1, "/lidar/points"),
        ("--scheduler tcp://127.0.0.1:1 --jobs 2", 2, "--scheduler and --jobs exclude each other"),
    ],
)
def test_mistakes_name_the_remedy(tmp_path, refused, arguments, code, says):
    assert says in refused(code, "replay", *FOLLOW, "-o", tmp_path / "runs", *arguments.split())
    assert not (tmp_path / "runs" / "follow" / "run.json").exists()


def test_of_a_batch_failures_are_the_last_lines_and_a_dry_run_says_what_is_left(tmp_path, two, quadlog, ok):
    out = ok("replay", *two, "--dry-run")
    assert "2 of 2 to replay, " in out.splitlines()[-1]
    bad = [str(tmp_path / f"{name}.bag") for name in ("broken", "empty")]
    for path in bad:
        Path(path).write_text("no bag")
    done = quadlog("replay", *bad, two[0], *two[2:], "--jobs", "1")
    assert done.code == 3
    first, *last = done.err.splitlines()[-3:]
    assert first == "2 of 3 recordings failed:"
    assert [line.split(": ")[0].strip() for line in last] == bad
    run, page = done.out.splitlines()
    assert (run.split(": ")[0], page) == (str(tmp_path / "runs" / "a"), str(tmp_path / "runs" / "report.html"))
    first, second, third, stored = ok("replay", *two, "--dry-run", "--resume", "--jobs", "2").splitlines()
    assert (first.split()[0], second.split()[0], third[:18]) == ("skip", "run", "1 of 2 to replay, ")
    assert stored.startswith(f"{tmp_path / 'runs' / '.stages'}: ")
    done = quadlog("replay", *two, "--dry-run", "--resume", "--json")
    assert json.loads(done.out)[1]["size_bytes"] == (FIXTURES / "follow.mcap").stat().st_size
