"""What users type as places: one line for all that cannot be had, and URLs where they make sense."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from quadlog.cli.main import run

FOLLOW = Path(__file__).parents[3] / "fixtures" / "follow.mcap"


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("{web}/", "cannot be listed"),
        ("{web}/gone.mcap?sig=SECRET", "no such file"),
        ("{web}/page?sig=SECRET", "none of a recording"),
        ("@{web}/gone.txt?sig=SECRET", "no such list"),
        ("http://me:SECRET@127.0.0.1:{closed}/x?sig=SECRET", "cannot be reached"),
        ("https://no-such-host.invalid/x?sig=SECRET", "no such host"),
        ("s3://{bucket}/gone.mcap", "no such file"),
        ("s3://{bucket}/*.mcap", "no recording matches"),
        ("xyz://a/b", "unknown protocol 'xyz'"),
        ("gs://a/b", "gcsfs"),
        ("s3://", "no URL"),
        ("file://other/b", "another machine"),
    ],
)
def test_a_recording_that_cannot_be_had_is_one_line(
    web: Any, bucket: Any, closed_port: int, tmp_path: Path, capsys: pytest.CaptureFixture, argument: str, words: str
) -> None:
    (web.folder / "page").write_text("<html>")
    typed = argument.format(web=web.url, bucket=bucket.name, closed=closed_port)
    assert run(["replay", typed, "-o", str(tmp_path / "runs")]) == 1
    captured = capsys.readouterr()
    (line,) = captured.err.splitlines()
    assert words in line
    assert "SECRET" not in line
    assert captured.out == ""
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["init", str(FOLLOW), "-o", "s3://lab/quadlog.toml"],
        ["report", "s3://lab/runs/walk"],
        ["simulate", "circle", "-o", "s3://lab/runs"],
        ["synthesize", "follow", "-o", "s3://lab/x.mcap"],
        ["tables", "-o", "s3://lab/tables"],
        ["export", "runs/x", "--to", "tum", "-o", "s3://lab/x.tum"],
    ],
)
def test_what_is_written_on_this_machine_alone_takes_no_url(
    arguments: list[str], capsys: pytest.CaptureFixture
) -> None:
    assert run(arguments) == 2
    assert "a path of this machine is needed here" in capsys.readouterr().err


def test_a_run_is_read_where_it_lies(
    web: Any, bucket: Any, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (web.folder / "follow.mcap").write_bytes(FOLLOW.read_bytes())
    recording, runs = f"{web.url}/follow.mcap?sig=SECRET", f"s3://{bucket.name}/runs"
    assert run(["replay", recording, "-o", runs, "--duration", "3", "--until", "position"]) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith(f"{runs}/follow\n")
    assert "SECRET" not in captured.out + captured.err
    for name in ("run.json", "report.html", "config.toml"):
        assert b"SECRET" not in bucket.cat(f"{bucket.name}/runs/follow/{name}")
    there = f"{runs}/follow"
    assert run(["metrics", runs, "--format", "json"]) == 0
    (metrics,) = json.loads(capsys.readouterr().out)
    assert metrics["realtime_factor"] > 0
    assert metrics["run"] == there
    assert run(["diff", there, there]) == 0
    assert f"A  {there}\n" in capsys.readouterr().out
    assert run(["export", there, "--to", "tum"]) == 0
    assert (tmp_path / "follow-trajectory.tum").stat().st_size > 0
    Path("bounds.toml").write_text("[default]\nrealtime_factor = { min = 0.0 }\n")
    assert run(["check", there, "--expect", "bounds.toml", "--json"]) == 0
    assert there in capsys.readouterr().out
    assert run(["info", recording]) == 0
    assert "SECRET" not in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [["metrics", ""], ["report", ""], ["replay", "x.mcap", "-o", ""]])
def test_a_variable_that_is_not_set_is_no_folder(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments) == 2
    assert "an empty text names no place" in capsys.readouterr().err
