from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.metrics.clock_offset import estimate_clock_offset
from quadlog.metrics.positioning import Trajectory

S = 1_000_000_000


def walk(first_s=0.0, last_s=60.0, hz=20, clock_s=0.0, seed=3):
    """Part of one minute of a robot that stops and goes, on a clock that shows clock_s at its start."""
    speed_mps = np.repeat(np.clip(np.random.default_rng(seed).normal(0.5, 0.4, 31), 0, None), 2)
    at_s = np.arange(first_s, last_s, 1 / hz)
    path_m = np.interp(at_s, np.arange(61), np.concatenate([[0], np.cumsum(speed_mps[:60])]))
    position_m = np.column_stack([path_m, np.sin(path_m), np.zeros(len(path_m))])
    return Trajectory(
        np.int64(clock_s * S) + (at_s * S).astype(np.int64), position_m, np.tile([0.0, 0, 0, 1], (len(at_s), 1))
    )


@settings(max_examples=25)
@given(
    st.floats(0, 15),
    st.floats(40, 60),
    st.sampled_from([5, 20, 100]),
    st.floats(-1e9, 1e9),
    st.floats(-3, 3),
    st.integers(0, 9),
)
def test_the_offset_is_found_in_whatever_frame(first_s, last_s, hz, clock_s, turn_rad, seed):
    part = walk(first_s, last_s, hz, clock_s, seed)
    turn = Rotation.from_euler("z", turn_rad)
    noise_m = np.random.default_rng(1).normal(0, 0.005, part.position_m.shape)
    moved = Trajectory(part.t_ns, turn.apply(part.position_m) + np.array([3.0, -2, 1]) + noise_m, part.quat_xyzw)
    found = estimate_clock_offset(walk(seed=seed), moved)
    assert found.offset_s == pytest.approx(-clock_s, abs=0.15)
    assert found.correlation > 0.9
    back = estimate_clock_offset(moved, walk(seed=seed))
    assert back.offset_s == pytest.approx(clock_s, abs=0.15)


def test_speeds_that_tell_nothing_leave_the_starts():
    steady = np.arange(400) * S // 20
    line = Trajectory(steady, np.outer(np.arange(400), [0.03, 0, 0]), np.tile([0.0, 0, 0, 1], (400, 1)))
    for other in (line, Trajectory(line.t_ns, 0 * line.position_m, line.quat_xyzw), walk()):
        later = Trajectory(other.t_ns + 7 * S, other.position_m, other.quat_xyzw)
        found = estimate_clock_offset(line, later)
        assert (found.offset_s, found.correlation) == (-7.0, None)


def test_different_walks_do_not_correlate():
    assert estimate_clock_offset(walk(seed=1), walk(seed=2, last_s=59)).correlation is None


@pytest.mark.parametrize("n", [1, 2, 3, 12])
def test_few_poses(n):
    short = walk().rows(np.arange(n))
    found = estimate_clock_offset(walk(clock_s=5.0), short)
    assert np.isfinite(found.offset_s)


def test_a_day_is_no_burden():
    day = Trajectory(np.array([0, 86_400 * S]), np.zeros((2, 3)), np.tile([0.0, 0, 0, 1], (2, 1)))
    far = Trajectory(day.t_ns + 10**18, day.position_m, day.quat_xyzw)
    assert estimate_clock_offset(day, far).offset_s == -1e9
