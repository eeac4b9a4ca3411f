"""What users type as places: one line for all that cannot be had, and URLs where they make sense."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

FOLLOW = Path(__file__).parents[3] / "fixtures" / "follow.mcap"


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("{web}/", "cannot be listed"),
        ("{web}/gone.mcap?sig=SECRET", "no such file"),
        ("{web}/page?sig=SECRET", "page"),
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
    web: Any, bucket: Any, closed_port: int, tmp_path: Path, refused: Callable[..., str], argument: str, words: str
) -> None:
    (web.folder / "page").write_text("<html>")
    typed = argument.format(web=web.url, bucket=bucket.name, closed=closed_port)
    line = refused(1, "replay", typed, "-o", tmp_path / "runs")
    assert words in line
    assert "SECRET" not in line
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
def test_files_that_are_written_locally_only_take_no_url(arguments: list[str], refused: Callable[..., str]) -> None:
    assert "a local path is required here" in refused(2, *arguments)


def test_a_run_is_read_where_it_lies(
    web: Any, bucket: Any, tmp_path: Path, quadlog: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (web.folder / "follow.mcap").write_bytes(FOLLOW.read_bytes())
    recording, runs = f"{web.url}/follow.mcap?sig=SECRET", f"s3://{bucket.name}/runs"
    there = f"{runs}/follow"
    done = quadlog("replay", recording, "-o", runs, "--duration", "3", "--until", "position", "--no-plots")
    assert done.code == 0
    assert done.out.startswith(f"{there}: ")
    assert "SECRET" not in done.out + done.err
    for name in ("run.json", "report.html", "config.toml"):
        assert b"SECRET" not in bucket.cat(f"{bucket.name}/runs/follow/{name}")
    (metrics,) = json.loads(quadlog("metrics", runs, "--format", "json").out)
    assert metrics["realtime_factor"] > 0
    assert metrics["run"] == there
    assert f"A  {there}\n" in quadlog("diff", there, there).out
    assert quadlog("export", there, "--to", "tum").code == 0
    assert (tmp_path / "follow-trajectory.tum").stat().st_size > 0
    Path("bounds.toml").write_text("[default]\nrealtime_factor = { min = 0.0 }\n")
    done = quadlog("check", there, "--expect", "bounds.toml", "--json")
    assert (done.code, there in done.out) == (0, True)
    done = quadlog("info", recording)
    assert (done.code, "SECRET" in done.out) == (0, False)


@pytest.mark.parametrize("arguments", [["metrics", ""], ["report", ""], ["replay", "x.mcap", "-o", ""]])
def test_an_unset_variable_is_no_folder(arguments: list[str], refused: Callable[..., str]) -> None:
    assert "the path is empty" in refused(2, *arguments)
