from __future__ import annotations

import os
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.errors import AlreadyExists
from quadlog.geometry import transform_from_rpy
from quadlog.pipelines.info import mount_of, propose_config, write_new


def test_mount_gives_the_transform_back() -> None:
    mount = mount_of(transform_from_rpy(np.array([0.2, -0.1, 0.45]), 0.02, -0.3, 1.5))
    assert (mount["x_m"], mount["y_m"], mount["z_m"]) == (0.2, -0.1, 0.45)
    back = Rotation.from_euler("ZYX", [mount["yaw_deg"], mount["pitch_deg"], mount["roll_deg"]], degrees=True)
    expected = Rotation.from_euler("ZYX", [1.5, -0.3, 0.02])
    assert (back * expected.inv()).magnitude() < 2e-5
    Config.model_validate({"lidar": {"mount": mount}})


def test_files_are_not_replaced_unless_forced(tmp_path: Path) -> None:
    path = tmp_path / "quadlog.toml"
    write_new(path, "a", force=False)
    with pytest.raises(AlreadyExists, match="--force"):
        write_new(path, "b", force=False)
    assert path.read_text() == "a"
    write_new(path, "c", force=True)
    assert path.read_text() == "c"
    assert [each.name for each in tmp_path.iterdir()] == ["quadlog.toml"]


@pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")
def test_a_real_uwb_log(tmp_path: Path) -> None:
    """What init writes can be read, and with its comments lifted is a config with every radio of the log."""
    text = propose_config(Path(os.environ["QUADLOG_DATASETS"]) / "uwb_lias" / "lias_fast.mcap").text
    path = tmp_path / "quadlog.toml"
    path.write_text(text)
    config = load_config(path)
    assert config.topics.uwb == ["/nlink_linktrack_tagframe0"]
    assert config.topics.reference == "/mocap/trolley/pose"
    head, skeleton = text.split("# The radios")
    filled = skeleton.replace("_m = \n", "_m = 1.0\n").splitlines()
    lifted = [
        line[2:]
        for line in filled
        if line.startswith(("# [[", "# id", "# x_m", "# y_m", "# z_m", "# role", "# height_m"))
    ]
    table = tomllib.loads(head + "\n" + "\n".join(lifted))
    config = Config.model_validate(table)
    assert [anchor.id for anchor in config.uwb.anchors] == list(range(8))
    assert [(tag.id, tag.role) for tag in config.uwb.tags] == [(0, "robot"), (1, "person"), (2, "none")]
    assert [tag.height_m for tag in config.uwb.tags] == [0.6, 1.3, 0.6]
    # The README's example is pasted below what init wrote.
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    path.write_text(text + readme.split("```toml\n")[1].split("```")[0])
    assert len(load_config(path).uwb.anchors) == 1


@pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")
def test_ambiguous_topics_are_listed_as_comments() -> None:
    text = propose_config(Path(os.environ["QUADLOG_DATASETS"]) / "uwb_tiers" / "rosbag2_2022_09_07-17_25_41").text
    assert "# several could be it: /turtle01/odom  or  /turtle03/odom" in text
    assert "odometry" not in tomllib.loads(text)["topics"]


@pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")
def test_only_sections_that_the_log_can_use_are_written_unless_all_are_asked_for() -> None:
    odometry_only = Path(os.environ["QUADLOG_DATASETS"]) / "odometry" / "jackal_odom_imu.bag"
    text = propose_config(odometry_only).text
    assert set(tomllib.loads(text)) == {"topics", "results"}
    assert text.splitlines()[-1].startswith("# This log cannot use [uwb] [lidar]")
    assert set(tomllib.loads(propose_config(odometry_only, everything=True).text)) == set(Config.model_fields)
