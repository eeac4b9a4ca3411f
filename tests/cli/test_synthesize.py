from __future__ import annotations

from quadlog.cli.main import run
from quadlog.cli.synthesize import command
from quadlog.simulation.synthetic.writer import WRITERS

SMALL = ["--duration", "0.2", "--azimuth-steps", "16"]


def test_writes_a_recording_and_says_what_is_in_it(tmp_path, capsys):
    path = tmp_path / "walk.mcap"
    assert run(["synthesize", "follow", "-o", str(path), *SMALL]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[0].startswith(f"{path}: ")
    assert "/lidar/points  2" in out
    assert path.exists()


def test_refuses_to_overwrite_in_one_line(tmp_path, capsys):
    path = tmp_path / "walk.mcap"
    path.touch()
    assert run(["synthesize", "follow", "-o", str(path), *SMALL]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "--force" in error
    assert run(["synthesize", "follow", "-o", str(path), *SMALL, "--force"]) == 0


def test_usage_errors_exit_with_2(tmp_path, capsys):
    path = str(tmp_path / "walk.mcap")
    assert run(["synthesize", "moon", "-o", path]) == 2
    assert run(["synthesize", "follow"]) == 2
    assert run(["synthesize", "follow", "-o", path, "--duration", "-1"]) == 2
    assert run(["synthesize", "follow", "-o", path, "--azimuth-steps", "999999"]) == 2
    assert run(["synthesize", "follow", "-o", str(tmp_path / "walk.txt"), *SMALL]) == 2
    assert run(["synthesize", "follow", "-o", path, "--format", "bag", *SMALL]) == 2
    capsys.readouterr()
    assert list(tmp_path.iterdir()) == []


def test_formats_offered_are_those_there_are():
    (formats,) = [each.type.choices for each in command.params if each.name == "container"]
    assert list(formats) == list(WRITERS)


def test_every_scenario_is_offered_and_made(tmp_path, capsys):
    for scenario in ("follow", "forest", "corridor"):
        assert run(["synthesize", scenario, "-o", str(tmp_path / f"{scenario}.mcap"), *SMALL]) == 0
        assert "/lidar/points  2" in capsys.readouterr().out
    (scenarios,) = [each.type.choices for each in command.params if each.name == "scenario"]
    assert set(scenarios) == {"follow", "forest", "corridor"}
    assert run(["synthesize", "--help"]) == 0
    described = capsys.readouterr().out
    assert all(f"\n  {scenario}: " in described for scenario in scenarios)
