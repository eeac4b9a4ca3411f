"""`quadlog survey` on the committed recording and on the real trolley, and what it refuses."""

from __future__ import annotations

import json
import os
import tomllib
from pathlib import Path

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.pipelines.tables.real.recordings import LIAS_ANCHORS_M, LIAS_LEVERS_M, LIAS_TAG_HEIGHT_M
from quadlog.storage.formats.tum import read_tum

TABLE = '[[uwb.tags]]\nid = {}\nrole = "robot"\nx_m = {}\ny_m = {}\n'


@pytest.fixture(scope="module")
def lias() -> Path:
    folder = Path(os.environ.get("QUADLOG_DATASETS", "/nowhere")) / "uwb_lias"
    if not folder.exists():
        pytest.skip("QUADLOG_DATASETS is not set")
    return folder


def test_the_trolley_finds_its_anchors(lias, tmp_path, quadlog):
    """Motion capture as odometry, three tags. Measured 0.08 m from the places that its authors surveyed."""
    tags = "".join(TABLE.format(tag, *lever) for tag, lever in enumerate(LIAS_LEVERS_M))
    (tmp_path / "c.toml").write_text(
        f'[topics]\nposition = "/mocap/trolley/pose"\n[uwb]\ntag_height_m = {LIAS_TAG_HEIGHT_M}\n{tags}'
    )
    output = tmp_path / "anchors.toml"
    arguments = ["survey", lias / "lias_fast.mcap", "-c", tmp_path / "c.toml", "-o", output, "--json"]
    done = quadlog(*arguments)
    assert done.code == 0, done.err
    found = json.loads(done.out)
    rows = found["anchors"]
    place_m, bound_m = (
        np.array([[row[f"{axis}{end}"] for axis in "xy"] for row in rows]) for end in ("_m", "_bound_m")
    )
    first = read_tum(lias / "lias_fast_mocap.tum")
    yaw = 2 * np.arctan2(first.quat_xyzw[0, 2], first.quat_xyzw[0, 3])
    off = (np.array(LIAS_ANCHORS_M)[:, :2] - first.position_m[0, :2]) @ [1, 1j] * np.exp(-1j * yaw)
    error_m = place_m - np.column_stack([off.real, off.imag])
    assert np.median(np.hypot(*error_m.T)) <= 0.12
    assert np.mean(np.abs(error_m) <= bound_m) >= 0.85

    config = load_config(output)
    assert [each.id for each in config.uwb.anchors] == list(range(8))
    assert [each.role for each in config.uwb.tags] == ["robot"] * 3
    assert "position" not in tomllib.loads(output.read_text()).get("topics", {})
    assert "--force" in quadlog(*arguments).err


def test_without_ranges_or_odometry_it_says_what_is_missing(lias, refused):
    datasets = lias.parent
    assert "no topic is fit to be the uwb" in refused(1, "survey", datasets / "odometry" / "jackal_odom_imu.bag")
    assert "nothing tells how the robot moves" in refused(1, "survey", lias / "lias_fast.mcap")


@pytest.mark.parametrize("height", ["high", "=2", "a=2", "nan", "0=inf"])
def test_wrong_heights_are_usage(tmp_path, refused, height):
    assert "--anchor-height" in refused(2, "survey", tmp_path / "walk.mcap", "--anchor-height", height)
