from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.geometry import transform_from_rpy
from quadlog.lidar.deskew import Skewed, deskew, sweep_instants
from quadlog.simulation.lidar_sensor import Lidar, PointClass, World, sweep
from quadlog.simulation.scene import Box, RayCaster
from quadlog.simulation.synthesized import START_NS
from quadlog.simulation.walk import Motion

T_NS = 1_767_225_600_123_456_789
SWEEP_NS = 100_000_000
MOUNT = transform_from_rpy(np.array([0.1, -0.05, 0.45]), 0.0, 0.0, 0.3)


def column_offsets(n: int, first_ns: int = 0) -> np.ndarray:
    """Of n points, 16 at a time."""
    return first_ns + np.repeat(np.arange(-(-n // 16)), 16)[:n].astype(np.int64) * SWEEP_NS // (-(-n // 16))


def upright(instants_ns: np.ndarray) -> np.ndarray:
    return np.tile(np.eye(3), (len(instants_ns), 1, 1))


def steady(instants_ns: np.ndarray, vx: float, vy: float, turn: float, yaw: float = 2.0) -> np.ndarray:
    """Poses of a robot with constant rates in map, at (3, -2) and heading yaw at T_NS."""
    t_s = (instants_ns - T_NS) * 1e-9
    return np.column_stack([3 + vx * t_s, -2 + vy * t_s, (yaw + turn * t_s + np.pi) % (2 * np.pi) - np.pi])


def exactly(xyz, offset_ns, vx, vy, turn, yaw, roll_rate, pitch_rate, mount):
    """Every point through map and back with its own pose, by scipy."""
    t_s = offset_ns * 1e-9

    def turned(at_s):
        yaws, pitches, rolls = yaw + turn * at_s, pitch_rate * at_s, roll_rate * at_s
        return Rotation.from_euler("ZYX", np.column_stack([yaws, pitches, rolls]))

    in_base = xyz.astype(np.float64) @ mount[:3, :3].T + mount[:3, 3]
    in_map = turned(t_s).apply(in_base) + np.column_stack([vx * t_s, vy * t_s, 0 * t_s])
    back = turned(np.zeros(1)).inv().apply(in_map)
    return (back - mount[:3, 3]) @ mount[:3, :3]


rate = st.floats(-1.5, 1.5)
angle = st.floats(-3.1, 3.1)


@settings(deadline=None, max_examples=60)
@given(rate, rate, rate, angle, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), angle, angle, st.sampled_from("sme"))
def test_every_point_moves_as_by_its_own_pose(vx, vy, turn, yaw, roll_rate, pitch_rate, mount_roll, mount_yaw, stamped):
    mount = transform_from_rpy(np.array([0.2, 0.1, 0.5]), mount_roll, 0.2, mount_yaw)
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(640, 3))
    xyz = (direction / np.linalg.norm(direction, axis=1, keepdims=True) * rng.uniform(0.5, 30, (640, 1))).astype("f4")
    first_ns = {"s": 0, "m": -SWEEP_NS // 2, "e": -SWEEP_NS}[stamped]
    offset_ns = rng.permutation(column_offsets(640, first_ns))
    instants = sweep_instants(T_NS, offset_ns, 640)
    t_s = (instants - T_NS) * 1e-9
    level = Rotation.from_euler("YX", np.column_stack([pitch_rate * t_s, roll_rate * t_s])).as_matrix()
    moved = deskew(xyz, offset_ns, instants, steady(instants, vx, vy, turn, yaw), level, mount)
    expected = exactly(xyz, offset_ns, vx, vy, turn, yaw, roll_rate, pitch_rate, mount)
    assert np.linalg.norm(moved - expected, axis=1).max() < 4e-3


def test_what_is_ahead_is_farther_from_where_the_robot_was_than_from_where_it_goes():
    """At 1 m/s ahead, a point 5 m away at the sweep's end was 5.1 m away at its start, and 5 m away at its end."""
    xyz = np.array([[8.0, 0, 0], [5.0, 0, 0]], dtype=np.float32)
    for first_ns, expected in ((0, (8.0, 5.1)), (-SWEEP_NS, (7.9, 5.0))):
        offset_ns = np.array([first_ns, first_ns + SWEEP_NS])
        instants = sweep_instants(T_NS, offset_ns, 2)
        moved = deskew(xyz, offset_ns, instants, steady(instants, 1.0, 0.0, 0.0, 0.0), upright(instants), np.eye(4))
        np.testing.assert_allclose(moved[:, 0], expected, atol=1e-5)
        assert moved.dtype == np.float32


def test_motion_may_change_while_the_scan_lasts():
    """A robot that starts in the middle of the sweep moves the second half of the points only."""
    offset_ns = column_offsets(320)
    instants = sweep_instants(T_NS, offset_ns, 320)
    pose = steady(instants, 0, 0, 0, 0.0)
    pose[:, 0] += np.maximum(0, (instants - T_NS) * 1e-9 - 0.05)
    xyz = np.tile(np.float32([4, 1, 0]), (320, 1))
    moved = deskew(xyz, offset_ns, instants, pose, upright(instants), np.eye(4))
    # Knots are 10 ms apart, and lie between the start's 50 ms and the next one here.
    np.testing.assert_allclose(moved[:, 0] - 4, np.maximum(0, offset_ns * 1e-9 - 0.05), atol=3e-3)
    np.testing.assert_array_equal(moved[offset_ns < 40_000_000], xyz[offset_ns < 40_000_000])


@dataclass(frozen=True)
class Curving:
    """0.8 m/s along x while turning at 1 rad/s."""

    def at(self, t_s):
        zero = np.zeros(len(t_s))
        place = np.column_stack([0.8 * t_s, zero])
        return Motion(place, t_s + 0.0, zero + 0.8, zero, zero + 1.0, zero, zero, zero)


@pytest.mark.parametrize("stamp_in_sweep_ns", [0, SWEEP_NS])
def test_a_simulated_wall_lies_where_it_stands(stamp_in_sweep_ns):
    wall = Box(8.1, 0.0, 0.2, 30.0, 3.0)
    mount = transform_from_rpy(np.array([0.1, 0.0, 0.45]), 0.0, 0.0, 0.0)
    lidar = Lidar(azimuth_steps=450, range_std_m=0.0, dropout_share=0.0, false_share=0.0, resolution_m=1e-6)
    scan = sweep(lidar, World(RayCaster((wall,)), Curving(), (), mount), START_NS, START_NS, np.random.default_rng(0))
    t_ns = START_NS + stamp_in_sweep_ns
    offset_ns = scan.cloud.offset_ns - stamp_in_sweep_ns
    instants = sweep_instants(t_ns, offset_ns, len(offset_ns))
    motion = Curving().at((instants - START_NS) * 1e-9)
    pose = np.column_stack([motion.position_m, motion.yaw_rad])
    moved = deskew(scan.cloud.xyz_m, offset_ns, instants, pose, upright(instants), mount)

    def off_the_wall(xyz):
        here = Rotation.from_euler("z", pose[0, 2]).apply(xyz + mount[:3, 3])
        return np.abs(here[:, 0] + pose[0, 0] - 8.0)[seen]

    from_here = np.linalg.norm(scan.cloud.xyz_m[:, :2], axis=1)
    seen = (scan.point_class == PointClass.OBSTACLE) & (from_here < 15)
    assert seen.sum() > 500
    assert np.median(off_the_wall(scan.cloud.xyz_m)) > 0.1
    assert off_the_wall(moved).max() < 3e-3


def test_a_robot_that_stands_still_gets_its_own_array_back():
    xyz = np.random.default_rng(1).normal(0, 5, (320, 3)).astype(np.float32)
    offset_ns = column_offsets(320)
    instants = sweep_instants(T_NS, offset_ns, 320)
    for speed, turn, same in ((0.0, 0.0, True), (0.002, 0.0, True), (0.1, 0.0, False), (0.0, 0.02, False)):
        moved = deskew(xyz, offset_ns, instants, steady(instants, speed, 0, turn), upright(instants), MOUNT)
        assert (moved is xyz) == same


def test_the_array_given_is_never_changed():
    xyz = np.random.default_rng(1).normal(0, 5, (320, 3)).astype(np.float32)
    before, offset_ns = xyz.copy(), column_offsets(320)
    instants = sweep_instants(T_NS, offset_ns, 320)
    pose = steady(instants, 1, 0, 1)
    moved = deskew(xyz, offset_ns, instants, pose, upright(instants), MOUNT)
    np.testing.assert_array_equal(xyz, before)
    strided = np.zeros((320, 6), np.float32)
    strided[:, 1:4] = xyz
    again = deskew(strided[:, 1:4], offset_ns, instants, pose, upright(instants), MOUNT)
    np.testing.assert_array_equal(again, moved)


def test_what_is_no_return_stays_none():
    xyz = np.float32([[2, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [1e30, 0, 0], [0, 0, 0]])
    offset_ns = np.arange(5, dtype=np.int64) * SWEEP_NS // 5 - SWEEP_NS // 2
    instants = sweep_instants(T_NS, offset_ns, 5)
    moved = deskew(xyz, offset_ns, instants, steady(instants, 1.0, 0.5, 1.0), upright(instants), MOUNT)
    np.testing.assert_array_equal(moved[4], 0)
    assert not np.isfinite(moved[1:3]).all(axis=1).any()
    assert np.linalg.norm(moved[3].astype(float)) > 1e29
    assert 0.05 < np.linalg.norm(moved[0] - xyz[0]) < 0.5


def test_a_map_whose_origin_is_far_away_costs_no_millimetre():
    xyz = np.random.default_rng(2).normal(0, 8, (640, 3)).astype(np.float32)
    offset_ns = column_offsets(640)
    instants = sweep_instants(T_NS, offset_ns, 640)
    pose = steady(instants, 0.7, -0.2, 1.0)
    near = deskew(xyz, offset_ns, instants, pose, upright(instants), MOUNT)
    far = deskew(xyz, offset_ns, instants, pose + np.array([5e5, 5e6, 0]), upright(instants), MOUNT)
    np.testing.assert_allclose(far, near, atol=1e-5)


@settings(deadline=None)
@given(st.integers(2, 40), st.integers(-SWEEP_NS, 0), st.integers(1, 10**9 - SWEEP_NS), st.randoms())
def test_instants_are_the_scans_own_and_evenly_those_of_its_points(n, first_ns, lasts_ns, random):
    first_ns = max(first_ns, -2 * lasts_ns)
    offsets = [first_ns, first_ns + lasts_ns, *(first_ns + random.randrange(lasts_ns + 1) for _ in range(n))]
    random.shuffle(offsets)
    instants = sweep_instants(T_NS, np.array(offsets, dtype=np.int64), len(offsets))
    assert not isinstance(instants, Skewed)
    assert instants.dtype == np.int64
    assert instants[0] == T_NS
    assert (instants[1], instants[-1]) == (T_NS + first_ns, T_NS + first_ns + lasts_ns)
    gaps = np.diff(instants[1:])
    assert gaps.max() <= 10_000_000
    assert np.ptp(gaps) <= 1


@pytest.mark.parametrize(
    ("offset_ns", "why"),
    [
        (None, Skewed.NO_TIMES),
        ([0] * 4, Skewed.NO_TIMES),
        ([50_000_000] * 4, Skewed.NO_TIMES),
        ([0, 1, 2], Skewed.ABSURD_TIMES),
        ([0, 5, 9, 1_000_000_001], Skewed.ABSURD_TIMES),
        ([-1_000_000_001, 0, 0, 0], Skewed.ABSURD_TIMES),
        ([-600_000_000, 600_000_000, 0, 0], Skewed.ABSURD_TIMES),
        ([300_000_000, 350_000_000, 400_000_000, 400_000_000], Skewed.ABSURD_TIMES),
        ([-400_000_000, -350_000_000, -300_000_000, -300_000_000], Skewed.ABSURD_TIMES),
        ([-(2**63), 2**63 - 1, 0, 0], Skewed.ABSURD_TIMES),
    ],
)
def test_times_that_tell_nothing_are_refused(offset_ns, why):
    offsets = None if offset_ns is None else np.array(offset_ns, dtype=np.int64)
    assert sweep_instants(T_NS, offsets, 4) is why


def test_an_empty_scan_has_no_times():
    assert sweep_instants(T_NS, np.empty(0, dtype=np.int64), 0) is Skewed.NO_TIMES


def test_poses_that_are_not_known_or_jump_are_refused():
    xyz, offset_ns = np.ones((320, 3), np.float32), column_offsets(320)
    instants = sweep_instants(T_NS, offset_ns, 320)
    level = upright(instants)

    def with_pose(row, column, value):
        pose = steady(instants, 0.5, 0.0, 0.5)
        pose[row:, column] += value
        return deskew(xyz, offset_ns, instants, pose, level, MOUNT)

    for row in (0, 1, len(instants) - 1):
        assert with_pose(row, 0, np.nan) is Skewed.NO_POSE
    assert with_pose(5, 0, 0.15) is Skewed.JUMP
    assert with_pose(5, 1, -0.15) is Skewed.JUMP
    assert with_pose(5, 2, 0.1) is Skewed.JUMP
    assert with_pose(1, 2, 0.1) is Skewed.JUMP  # of the scan's own pose alone
    assert isinstance(with_pose(5, 0, 0.05), np.ndarray)


def test_a_yaw_that_passes_behind_is_no_jump():
    xyz, offset_ns = np.ones((320, 3), np.float32), column_offsets(320)
    instants = sweep_instants(T_NS, offset_ns, 320)
    behind, ahead = (
        deskew(xyz, offset_ns, instants, steady(instants, 0.0, 0.0, 1.0, yaw), upright(instants), MOUNT)
        for yaw in (np.pi - 0.05, 1.0)
    )
    np.testing.assert_allclose(behind, ahead, atol=1e-5)
