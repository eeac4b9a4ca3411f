from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from quadlog.cli.main import run

FIXTURES = Path(__file__).parents[2] / "fixtures"
FOLLOW = [str(FIXTURES / "follow.mcap"), "-c", str(FIXTURES / "follow.toml")]


def test_metrics_go_to_stdout_and_talk_to_stderr(tmp_path, capsys):
    code = run(["replay", *FOLLOW, "-o", str(tmp_path / "runs"), "--until", "position", "--duration", "1"])
    captured = capsys.readouterr()
    assert code == 0
    assert "uwb_rmse_m" in captured.out
    assert str(tmp_path / "runs" / "follow" / "report.html") in captured.out
    assert "robot position from uwb" in captured.err
    assert "robot position" not in captured.out


def test_json_is_a_list_of_flat_objects(tmp_path, capsys):
    arguments = ["--until", "position", "--duration", "1", "--json"]
    assert run(["replay", *FOLLOW, "-o", str(tmp_path / "runs"), *arguments]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert len(rows) == 1
    assert rows[0]["run"] == str(tmp_path / "runs" / "follow")
    assert rows[0]["exit_code"] == 0
    assert isinstance(rows[0]["uwb_residual_m"], float)
    assert "eta_m" not in rows[0]


def test_dry_run_writes_nothing(tmp_path, capsys):
    assert run(["replay", *FOLLOW, "-o", str(tmp_path / "runs"), "--dry-run", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert rows[0]["action"] == "run"
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["--force", "--resume"], 2, "exclude each other"),
        (["--until", "mapp"], 2, "mapp"),
        (["--set", "uwb.tag_heigth_m=1"], 1, "did you mean uwb.tag_height_m"),
        (["--planner", "a_star"], 2, "'a_star' is not one of 'astar', "),
        (["--controller", "mpc"], 2, "'mpc' is not one of 'fpmw', 'fpm', 'pmw', 'kinematic', 'none'"),
        (["--preset", "papers"], 2, "'paper"),
        (
            ["--planner", "astar", "--set", "planner.name=lpa_star"],
            2,
            "--planner astar and --set planner.name=lpa_star",
        ),
        (["--controller", "fpm", "--set", "simulation.controller=none"], 2, "--controller fpm and --set simulation."),
        (["--set", "topics.lidar=/points"], 1, "/lidar/points"),
        (["--set", "topics.lidar=/odom"], 1, "/odom is nav_msgs/msg/Odometry"),
    ],
)
def test_mistakes_are_one_line_that_names_the_remedy(tmp_path, capsys, arguments, code, says):
    assert run(["replay", *FOLLOW, "-o", str(tmp_path / "runs"), *arguments]) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert says in captured.err
    assert "Traceback" not in captured.err
    assert not (tmp_path / "runs" / "follow" / "run.json").exists()


def test_a_planner_of_a_plug_in_is_a_choice(tmp_path, install, capsys):
    install("quadlog-zig", "1.0", {"quadlog.planners": {"zigzag": "zig:Zigzag"}}, {"zig": "raise SystemExit(9)"})
    output = ["-o", str(tmp_path / "runs"), "--dry-run"]
    assert run(["replay", *FOLLOW, *output, "--planner", "zigzag"]) == 0
    assert run(["replay", *FOLLOW, *output, "--planner", "zagzig"]) == 2
    assert "'zigzag'" in capsys.readouterr().err


def test_a_preset_outranks_the_file_of_init_and_says_what_it_replaced(tmp_path, capsys):
    toml, output = tmp_path / "quadlog.toml", ["--until", "ingest", "--duration", "1", "--preset", "paper"]
    assert run(["init", FOLLOW[0], "-o", str(toml)]) == 0
    capsys.readouterr()
    records = []
    for name in ("defaults", "changed"):
        assert run(["replay", FOLLOW[0], "-c", str(toml), "-o", str(tmp_path / name), *output]) == 0
        records.append(json.loads((tmp_path / name / "follow" / "run.json").read_text()))
        said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("preset paper")]
        assert [note for note in records[-1]["notes"] if note.startswith("preset paper")] == said
        toml.write_text(toml.read_text().replace('# method = "gauss_newton"', 'method = "huber"'))
    assert [each["config"]["uwb"]["method"] for each in records] == ["paper", "paper"]
    assert said == [f'preset paper replaces keys of {toml}: uwb.method = "paper" instead of "huber"']
    assert not any(note.startswith("preset") for note in records[0]["notes"])


def start(tmp_path, *arguments):
    script = "from quadlog.cli.main import main; main()"
    command = [sys.executable, "-c", script, "replay", *FOLLOW, "-o", str(tmp_path / "runs"), *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(path: Path, process: subprocess.Popen) -> None:
    """Until a file is there: the process is in the middle of its work then. No clock decides anything."""
    while not any(path.parent.glob(path.name)):
        assert process.poll() is None, process.communicate()
        os.sched_yield()
        time.sleep(0)


@pytest.mark.parametrize("blow", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_a_stopped_run_leaves_nothing_half_written_and_resumes(tmp_path, blow, capsys):
    process = start(tmp_path)
    run_folder = tmp_path / "runs" / "follow"
    wait_for(run_folder / "fixes.parquet", process)
    process.send_signal(blow)
    _, err = process.communicate()
    assert process.returncode == (-blow if blow is signal.SIGKILL else 1)
    assert "Traceback" not in err
    assert not (run_folder / "run.json").exists()
    visible = {path.name for path in run_folder.iterdir() if not path.name.startswith(".")}
    assert "maps.npz" not in visible
    if blow is not signal.SIGKILL:
        assert err.splitlines()[-1].startswith("quadlog: interrupted")
        assert visible == {path.name for path in run_folder.iterdir()}

    capsys.readouterr()
    assert run(["replay", *FOLLOW, "-o", str(tmp_path / "runs"), "--until", "map", "--resume"]) == 0
    assert (run_folder / "run.json").exists()
    assert not [path.name for path in run_folder.iterdir() if path.name.startswith(".")]
