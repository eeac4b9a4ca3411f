from __future__ import annotations

import pytest

SMALL = ["--duration", "0.2", "--azimuth-steps", "16"]


@pytest.mark.parametrize("scenario", ["follow", "forest", "corridor"])
def test_writes_a_recording_lists_it_and_never_overwrites(tmp_path, scenario, ok, refused):
    arguments = ["synthesize", scenario, "-o", tmp_path / "walk.mcap", *SMALL]
    out = ok(*arguments)
    assert out.splitlines()[0].startswith(f"{tmp_path / 'walk.mcap'}: ")
    assert "/lidar/points  2" in out
    assert "--force" in refused(1, *arguments)
    ok(*arguments, "--force")


@pytest.mark.parametrize("arguments", ["--duration -1", "--azimuth-steps 999999", "-o walk.txt", "--format bag"])
def test_wrong_usage(tmp_path, monkeypatch, refused, arguments):
    monkeypatch.chdir(tmp_path)
    refused(2, "synthesize", "follow", "-o", "walk.mcap", *SMALL, *arguments.split())
    assert list(tmp_path.iterdir()) == []


def test_with_a_body_the_same_seed_gives_the_same_bytes_and_joints(tmp_path, ok):
    for name in ("one", "two"):
        assert "/joint_states  100" in ok("synthesize", "follow", "--body", "-o", tmp_path / f"{name}.mcap", *SMALL)
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "two.mcap").read_bytes()
