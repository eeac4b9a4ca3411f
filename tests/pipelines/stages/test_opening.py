from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.messages import ImuSeries, Pose
from quadlog.pipelines.stages.mount import imu_in_base, moved_mounts
from quadlog.recordings.tf_tree import TransformTree

T_NS = np.arange(5, dtype=np.int64)


def tree_with(mount: Rotation, *, static: bool = True) -> TransformTree:
    """The mount once, or again and again on a topic of moving transforms, with a quaternion of either sign."""
    tree = TransformTree()
    for t_ns, sign in enumerate([1] if static else [1, -1, 1]):
        tree.add(t_ns, Pose(t_ns, "base_link", "imu", np.array([0.1, 0.0, 0.2]), sign * mount.as_quat()), static=static)
    return tree


@pytest.mark.parametrize("static", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_orientation_and_rates_become_those_of_base(seed: int, static: bool) -> None:
    """Against two poses of base: the rate in base is what turns one into the other."""
    random = np.random.default_rng(seed)
    mount, base_in_world = Rotation.random(rng=random), Rotation.random(5, rng=random)
    rate_in_base = random.normal(0, 1, (5, 3))
    seen = ImuSeries(T_NS, mount.inv().apply(rate_in_base), (base_in_world * mount).as_quat(), "imu")
    found = imu_in_base(seen, tree_with(mount, static=static))
    assert found.quat_xyzw is not None
    assert (Rotation.from_quat(found.quat_xyzw) * base_in_world.inv()).magnitude() == pytest.approx(0, abs=1e-9)
    assert found.angular_radps == pytest.approx(rate_in_base)
    assert found.frame_id == "base_link"


def test_an_imu_upside_down_turns_the_other_way_round() -> None:
    seen = ImuSeries(T_NS, np.tile([0.0, 0.0, 0.3], (5, 1)), None, "imu")
    found = imu_in_base(seen, tree_with(Rotation.from_euler("x", 180, degrees=True)))
    assert found.angular_radps == pytest.approx(np.tile([0.0, 0.0, -0.3], (5, 1)))
    assert found.quat_xyzw is None


@pytest.mark.parametrize("frame_id", ["imu", "elsewhere", ""])
def test_without_a_mount_that_turns_it_stays_as_it_came(frame_id: str) -> None:
    seen = ImuSeries(T_NS, np.ones((5, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (5, 1)), frame_id)
    assert imu_in_base(seen, tree_with(Rotation.identity())) is seen
    assert imu_in_base(seen, TransformTree()) is seen


def test_messages_without_an_orientation_keep_none() -> None:
    quat_xyzw = np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))
    quat_xyzw[2] = 0.0
    found = imu_in_base(ImuSeries(T_NS, np.ones((5, 3)), quat_xyzw, "imu"), tree_with(Rotation.from_rotvec([0, 1, 0])))
    assert found.quat_xyzw is not None
    assert np.flatnonzero(~found.quat_xyzw.any(axis=1)).tolist() == [2]


def test_a_mount_that_changes_after_all_is_told() -> None:
    tree = tree_with(Rotation.identity(), static=False)
    assert moved_mounts([("imu", "base_link")], tree) == []
    tree.add(9, Pose(9, "base_link", "imu", np.array([0.1, 0.0, 0.3]), np.array([0, 0, 0, 1.0])), static=False)
    (warning,) = moved_mounts([("imu", "base_link")], tree)
    assert warning.startswith("the transform from base_link to imu changes")
