from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.geometry import invert_transform, transform_from_quat
from quadlog.messages import Float
from quadlog.recordings.tf_tree import TransformTree


def pose(xyz: tuple[float, ...], yaw_rad: float = 0.0) -> Float:
    """(7,) position and quaternion."""
    return np.array([*xyz, 0.0, 0.0, np.sin(yaw_rad / 2), np.cos(yaw_rad / 2)])


def add(tree: TransformTree, parent: str, child: str, *poses: Float, step_ns: int = 1, static: bool = False) -> None:
    t_ns = np.arange(len(poses), dtype=np.int64) * step_ns
    tree.add("/tf", parent, child, t_ns, np.array(poses), static=static)


def matrix(each: Float) -> Float:
    return transform_from_quat(each[:3], each[3:])


def test_static_chains_compose_both_ways() -> None:
    mast, lidar = pose((0.2, 0.0, 0.5), 0.3), pose((0.0, 0.1, 0.2), -1.0)
    tree = TransformTree()
    add(tree, "base_link", "mast", mast, static=True)
    add(tree, "mast", "lidar", lidar, static=True)
    expected = matrix(mast) @ matrix(lidar)
    np.testing.assert_allclose(tree.static_transform("lidar", "base_link"), expected, atol=1e-12)  # type: ignore[arg-type]
    np.testing.assert_allclose(tree.static_transform("base_link", "lidar"), invert_transform(expected), atol=1e-12)  # type: ignore[arg-type]
    assert tree.base == "base_link"
    tree.configured = "lidar"
    assert tree.base == "lidar"


def test_frames_that_do_not_connect_have_no_transform() -> None:
    tree = TransformTree()
    add(tree, "base_link", "imu", pose((0, 0, 0)), static=True)
    add(tree, "other", "lidar", pose((0, 0, 0)), static=True)
    add(tree, "base_link", "other", pose((0, 0, 0)), pose((0, 0, 0), 0.1))
    assert tree.static_transform("lidar", "base_link") is None
    assert tree.static_transform("lidar", "unknown") is None
    assert tree.pose_series("imu", "map") is None


def test_moving_chain_at_the_times_of_its_busiest_part() -> None:
    """map->odom at 1 Hz, odom->base at 10 Hz, base->body static: compared with matrices, interpolated by hand."""
    tree = TransformTree()
    add(tree, "map", "odom", *(pose((float(i), 0.0, 0.0), 0.1 * i) for i in range(4)), step_ns=10**9)
    add(tree, "odom", "base", *(pose((0.0, 0.1 * i, 0.0), 0.02 * i) for i in range(25)), step_ns=10**8)
    mount = pose((0.0, 0.0, 0.3), 0.5)
    add(tree, "base", "body", mount, static=True)
    series = tree.pose_series("body", "map")
    assert series is not None
    assert series.t_ns.tolist() == [i * 10**8 for i in range(25)]
    assert (series.frame_id, series.child_frame_id) == ("map", "body")
    for i in range(25):
        to_map = matrix(pose((0.1 * i, 0.0, 0.0), 0.01 * i))
        expected = to_map @ matrix(pose((0.0, 0.1 * i, 0.0), 0.02 * i)) @ matrix(mount)
        np.testing.assert_allclose(series.position_m[i], expected[:3, 3], atol=1e-9)
        turn = Rotation.from_quat(series.quat_xyzw[i]).as_matrix()
        np.testing.assert_allclose(turn, expected[:3, :3], atol=1e-9)


CHAINS = {
    "the frame of that name": (["map>odom", "odom>base_link"], "base_link", "map"),
    "no map": (["odom>base_footprint", "base_footprint=base_link"], "base_footprint", "odom"),
    "a map elsewhere": (["map>goal", "odom>base_link"], "base_link", "odom"),
    "a map that hangs on nothing that moves": (["map=goal", "odom>base"], "base", "odom"),
    "prefixes": (["robot1/odom>robot1/base_link", "robot1/base_link=robot1/laser"], "robot1/base_link", "robot1/odom"),
    "several robots": (["b/odom>b/base_link", "a/odom>a/base_link"], "a/base_link", "a/odom"),
    "a base that moves before one that does not": (["camera_init>body", "base_link=laser"], "body", "camera_init"),
    "other names": (["world>trunk", "trunk>leg"], "trunk", "world"),
    "no usual name": (["world>firefly", "firefly=imu"], "firefly", "world"),
    "no usual name of the root": (["uwb_origin>torso"], "torso", "uwb_origin"),
    "a world that hangs on the robot": (["body>odom", "body=lidar"], "body", "odom"),
    "joints alone": (["base_link>wheel", "base_footprint=base_link"], "base_link", None),
    "a body that sways": (["base_footprint>base_link"], "base_link", None),
    "two frames that move, without a usual name": (["world>one", "world>two"], None, None),
}


@pytest.mark.parametrize("name", CHAINS)
def test_which_frames_are_the_robot_and_the_map(name: str) -> None:
    """a>b: b moves in a, a=b: it is fixed there."""
    edges, base, fixed = CHAINS[name]
    tree = TransformTree()
    for edge in edges:
        parent, child = edge.replace("=", ">").split(">")
        poses = [pose((0.1 * i, 0.0, 0.0)) for i in range(3 if ">" in edge else 1)]
        add(tree, parent, child, *poses, static="=" in edge)
    assert tree.base == base
    if base is not None:
        assert tree.fixed_frame(base) == fixed
        series = None if fixed is None else tree.pose_series(base, fixed)
        assert (series is not None) == (fixed is not None)


def test_one_sender_is_never_taken_for_two() -> None:
    """Noise, outliers, corrections of a localization that repeats its last one, and bursts."""
    rng = np.random.default_rng(1)
    t_s = np.arange(0.0, 30.0, 0.02)
    oval_m = np.column_stack([np.sin(0.3 * t_s), np.cos(0.3 * t_s), 0 * t_s])
    rough_m = rng.normal(0, 0.1, oval_m.shape)
    rare = rng.uniform(size=len(t_s)) < 0.03
    senders = {
        "noise": (t_s, oval_m + rough_m),
        "outliers": (t_s, oval_m + 10 * rough_m * rare[:, None]),
        "corrections": (t_s, np.cumsum(rough_m * rare[:, None], axis=0)),
        "bursts": (np.repeat(t_s[::10], 10) + np.tile(np.arange(10) * 1e-4, 150), oval_m),
    }
    for name, (at_s, place_m) in senders.items():
        tree = TransformTree()
        poses = np.column_stack([place_m, np.tile([0.0, 0.0, 0.0, 1.0], (len(at_s), 1))])
        tree.add("/tf", "odom", "base_link", (at_s * 1e9).astype(np.int64), poses)
        (edge,) = tree.chain("base_link")
        assert edge.keep_one_sender(None) is None, name
