from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.messages import PoseSeries
from quadlog.metrics.alignment import estimate_clock_offset

S = 1_000_000_000


def trajectory(at_s, x_m, y_m, clock_s=0.0, noise_m=0.0, seed=5):
    position_m = np.column_stack([x_m, y_m, 0 * at_s])
    position_m[:, :2] += np.random.default_rng(seed).normal(0, noise_m, (len(at_s), 2))
    # In integers: float64 holds an epoch to 0.2 microseconds only.
    t_ns = round(clock_s * S) + np.round(at_s * S).astype(np.int64)
    return PoseSeries(t_ns, position_m, np.tile([0.0, 0, 0, 1], (len(at_s), 1)))


def walk(first_s=0.0, last_s=60.0, hz=20, clock_s=0.0, seed=3, noise_m=0.0):
    """Part of one minute of a robot that stops and goes, on a clock that shows clock_s at its start."""
    speed_mps = np.repeat(np.clip(np.random.default_rng(seed).normal(0.5, 0.4, 31), 0, None), 2)
    at_s = np.arange(first_s, last_s, 1 / hz)
    path_m = np.interp(at_s, np.arange(61), np.concatenate([[0], np.cumsum(speed_mps[:60])]))
    return trajectory(at_s, path_m, np.sin(path_m), clock_s, noise_m)


TILT = Rotation.from_rotvec([0.3, -1.2, 2.0])


def in_another_frame(poses, turn=TILT):
    return PoseSeries(poses.t_ns, turn.apply(poses.position_m) + np.array([3.0, -2, 1]), poses.quat_xyzw)


@given(
    st.floats(0, 10),
    st.floats(45, 60),
    st.sampled_from([1, 5, 20, 100]),
    st.floats(-1e9, 1e9),
    st.floats(-3, 3),
    st.integers(0, 9),
)
def test_the_offset_is_found_in_whatever_frame(first_s, last_s, hz, clock_s, turn_rad, seed):
    part = walk(first_s, last_s, hz, clock_s, seed, noise_m=0.005)
    moved = in_another_frame(part, Rotation.from_euler("zx", [turn_rad, 0.5]))
    for one, other, expected_s in ((walk(seed=seed), moved, -clock_s), (moved, walk(seed=seed), clock_s)):
        found = estimate_clock_offset(one, other)
        assert found.offset_s == pytest.approx(expected_s, abs=0.05)
        assert found.rival_s is None
        assert found.residual_m < 0.02


@given(st.floats(-1e6, 1e6), st.integers(0, 9))
def test_a_steady_walk_is_told_by_its_turns_though_its_speed_tells_nothing(clock_s, seed):
    """With noise of which speeds are mostly made: 0.2 m/s of its 0.6."""
    at_s = np.arange(0, 60, 0.02)
    turn_radps = np.interp(at_s, np.arange(0, 63, 3), np.random.default_rng(seed).normal(0, 0.4, 21))
    course_rad = np.cumsum(turn_radps) * 0.02
    x_m, y_m = np.cumsum(0.012 * np.cos(course_rad)), np.cumsum(0.012 * np.sin(course_rad))
    found = estimate_clock_offset(
        trajectory(at_s, x_m, y_m, clock_s), in_another_frame(trajectory(at_s, x_m, y_m, noise_m=0.08, seed=seed))
    )
    assert found.offset_s == pytest.approx(clock_s, abs=0.1)
    assert 0.08 < found.residual_m < 0.115  # 0.08 of both, less what lines between poses even out


@pytest.mark.parametrize("every", [1, 7, 50, 100])
def test_a_reference_of_few_poses_is_enough(every):
    sparse, run = walk(clock_s=3600.0).rows(np.arange(11, 1200, every)), walk(hz=50, noise_m=0.02)
    assert estimate_clock_offset(sparse, run).offset_s == pytest.approx(3600, abs=0.05)
    assert estimate_clock_offset(run, sparse).offset_s == pytest.approx(-3600, abs=0.05)


def test_a_gap_counts_for_nothing():
    """Most of the robot's way lies in it, where a straight line would not be."""
    whole = walk(clock_s=50.0)
    seconds = whole.t_ns / S - 50
    holed = whole.rows(np.flatnonzero((seconds < 15) | (seconds > 45)))
    assert estimate_clock_offset(holed, walk()).offset_s == pytest.approx(50, abs=0.02)
    assert estimate_clock_offset(holed, walk()).residual_m < 1e-3


AT_S = np.arange(0, 60, 0.05)
TRIANGLE_M = np.abs((AT_S / 10) % 2 - 1) * 5  # to and fro, 20 s a turn


@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.1])
@pytest.mark.parametrize(
    ("x_m", "y_m"),
    [
        (0.6 * AT_S, 0 * AT_S),
        (0.6 * AT_S, 0.3 * AT_S),
        (3 * np.cos(0.2 * AT_S), 3 * np.sin(0.2 * AT_S)),
        (TRIANGLE_M, 0 * AT_S),
        (3 * np.sin(0.5 * AT_S), np.sin(AT_S)),
    ],
    ids=["straight", "slanted", "circle", "to and fro", "figure of eight"],
)
def test_what_repeats_itself_is_ambiguous(x_m, y_m, noise_m):
    one, other = trajectory(AT_S, x_m, y_m, 40.0, noise_m), trajectory(AT_S, x_m, y_m, 0, noise_m, seed=6)
    found = estimate_clock_offset(one, other)
    assert abs(found.rival_s - found.offset_s) > 1


def told(found):
    return found is not None and found.rival_s is None


def test_standing_still_tells_nothing():
    still = trajectory(AT_S, 0 * AT_S, 0 * AT_S)
    trembling = trajectory(AT_S, 0 * AT_S, 0 * AT_S, noise_m=0.05)
    for other in (still, trembling, walk()):
        assert estimate_clock_offset(still, other) is None
        assert estimate_clock_offset(other, still) is None
    assert not told(estimate_clock_offset(trembling, walk()))
