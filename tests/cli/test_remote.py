"""URLs as places: one line for all that cannot be had, and runs that are read where they lie."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.conftest import FIXTURES


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("{web}/", "cannot be listed"),
        ("{web}/gone.mcap?sig=SECRET", "no such file"),
        ("http://me:SECRET@127.0.0.1:{closed}/x?sig=SECRET", "cannot be reached"),
        ("s3://{bucket}/gone.mcap", "no such file"),
        ("xyz://a/b", "unknown protocol 'xyz'"),
    ],
)
def test_a_recording_that_cannot_be_had_is_one_line(web, bucket, closed_port, tmp_path, refused, argument, words):
    typed = argument.format(web=web.url, bucket=bucket.name, closed=closed_port)
    line = refused(1, "replay", typed, "-o", tmp_path / "runs")
    assert words in line
    assert "SECRET" not in line
    assert not (tmp_path / "runs").exists()


def test_a_run_is_read_where_it_lies(web, bucket, tmp_path, quadlog, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (web.folder / "follow.mcap").write_bytes((FIXTURES / "follow.mcap").read_bytes())
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
