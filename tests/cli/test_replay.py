from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from quadlog.results.record import is_finished

FIXTURES = Path(__file__).parents[2] / "fixtures"
FOLLOW = [str(FIXTURES / "follow.mcap"), "-c", str(FIXTURES / "follow.toml")]


def test_results_go_to_stdout_and_messages_to_stderr(tmp_path, quadlog, ok):
    arguments = ["replay", "--no-plots", *FOLLOW, "-o", tmp_path / "runs", "--until", "position", "--duration", "1"]
    rows = json.loads(ok(*arguments, "--dry-run", "--json"))
    assert rows[0]["action"] == "run"
    assert not (tmp_path / "runs").exists()
    code, out, err = quadlog(*arguments)
    assert code == 0
    first, *sentences, page = out.splitlines()
    assert first.startswith(f"{tmp_path / 'runs' / 'follow'}: usable, ")
    assert sentences[0].startswith("  Positions: ")  # the worst first
    assert any(line.startswith("  Recorded walk: The robot ") for line in sentences)
    assert page == str(tmp_path / "runs" / "follow" / "report.html")
    assert "robot position from uwb" in err
    assert "robot position" not in out
    (row,) = json.loads(ok(*arguments, "--json", "--force"))
    assert (row["run"], row["exit_code"]) == (str(tmp_path / "runs" / "follow"), 0)
    assert isinstance(row["uwb_residual_m"], float)
    assert "eta_m" not in row


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["--force", "--resume"], 2, "exclude each other"),
        (["--until", "mapp"], 2, "mapp"),
        (["--set", "uwb.tag_heigth_m=1"], 1, "did you mean uwb.tag_height_m"),
        (["--planner", "a_star"], 2, "'a_star' is not one of 'astar', "),
        (["--controller", "mpc"], 2, "'mpc' is not one of 'fpmw', 'fpm', 'pmw', 'kinematic', 'none'"),
        (["--preset", "papers"], 2, "'paper"),
        (["--planner", "astar", "--set", "planner.name=lpa_star"], 2, "--planner astar and --set planner."),
        (["--controller", "fpm", "--set", "simulation.controller=none"], 2, "--controller fpm and --set simulation."),
        (["--set", "topics.lidar=/points"], 1, "/lidar/points"),
        (["--set", "topics.lidar=/odom"], 1, "/odom is nav_msgs/msg/Odometry"),
    ],
)
def test_mistakes_name_the_remedy(tmp_path, refused, arguments, code, says):
    assert says in refused(code, "replay", *FOLLOW, "-o", tmp_path / "runs", *arguments)
    assert not (tmp_path / "runs" / "follow" / "run.json").exists()


def test_a_planner_of_a_plug_in_is_a_choice(tmp_path, install, ok, refused):
    install("quadlog-zig", "1.0", {"quadlog.planners": {"zigzag": "zig:Zigzag"}}, {"zig": "raise SystemExit(9)"})
    command = ["replay", *FOLLOW, "-o", tmp_path / "runs", "--dry-run", "--planner"]
    ok(*command, "zigzag")
    assert "'zigzag'" in refused(2, *command, "zagzig")


def test_a_preset_outranks_the_file_of_init_and_says_what_it_replaced(tmp_path, quadlog, ok):
    toml, output = tmp_path / "quadlog.toml", ["--until", "ingest", "--duration", "1", "--preset", "paper"]
    ok("init", FOLLOW[0], "-o", toml)
    records = []
    for name in ("defaults", "changed"):
        done = quadlog("replay", "--no-plots", FOLLOW[0], "-c", toml, "-o", tmp_path / name, *output)
        assert done.code == 0
        records.append(json.loads((tmp_path / name / "follow" / "run.json").read_text()))
        said = [line for line in done.err.splitlines() if line.startswith("preset paper")]
        assert [note for note in records[-1]["notes"] if note.startswith("preset paper")] == said
        toml.write_text(toml.read_text().replace('# method = "gauss_newton"', 'method = "huber"'))
    assert [each["config"]["uwb"]["method"] for each in records] == ["paper", "paper"]
    assert said == [f'preset paper replaces keys of {toml}: uwb.method = "paper" instead of "huber"']
    assert not any(note.startswith("preset") for note in records[0]["notes"])


def start(tmp_path, *arguments):
    command = [sys.executable, "-m", "quadlog", "replay", *FOLLOW, "-o", str(tmp_path / "runs"), *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(path: Path, process: subprocess.Popen) -> None:
    """Until a file is there: the process is in the middle of its work then. No clock decides anything."""
    while not any(path.parent.glob(path.name)):
        assert process.poll() is None, process.communicate()
        time.sleep(0.002)


@pytest.mark.parametrize(
    "blow",
    [signal.SIGINT, *(pytest.param(each, marks=pytest.mark.nightly) for each in (signal.SIGKILL, signal.SIGTERM))],
)
def test_a_stopped_run_leaves_nothing_half_written_and_resumes(tmp_path, blow, ok):
    process = start(tmp_path)
    run_folder = tmp_path / "runs" / "follow"
    wait_for(run_folder / "fixes.parquet", process)
    process.send_signal(blow)
    _, err = process.communicate()
    assert process.returncode == (-blow if blow is signal.SIGKILL else 1)
    assert "Traceback" not in err
    assert not is_finished(run_folder)
    visible = {path.name for path in run_folder.iterdir() if not path.name.startswith(".")}
    assert "maps.npz" not in visible
    if blow is not signal.SIGKILL:
        assert err.splitlines()[-1].startswith("quadlog: interrupted")
        assert visible == {path.name for path in run_folder.iterdir()}

    ok("replay", "--no-plots", *FOLLOW, "-o", tmp_path / "runs", "--until", "map", "--resume")
    assert is_finished(run_folder)
    assert not [path.name for path in run_folder.iterdir() if path.name.startswith(".")]
