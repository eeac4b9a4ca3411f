from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.lidar.deskew import MOST_TIME_SLOTS, Skewed, slot_poses, sweep_slots, sweep_span
from quadlog.messages import PointTimes

T_NS = 1_767_225_600_123_456_789
SWEEP_NS = 100_000_000


@given(st.integers(2, 40), st.integers(-SWEEP_NS, 0), st.integers(1000, 10**9 - SWEEP_NS), st.randoms())
def test_every_point_lies_in_the_slot_about_its_time(n, first_ns, lasts_ns, random):
    first_ns = max(first_ns, -lasts_ns)
    offsets = [first_ns, first_ns + lasts_ns, *(first_ns + random.randrange(lasts_ns + 1) for _ in range(n))]
    random.shuffle(offsets)
    slot, middle_ns = sweep_slots(PointTimes.of_offsets(np.array(offsets, dtype=np.int64)), len(offsets))
    assert len(middle_ns) == MOST_TIME_SLOTS
    apart_ns = np.abs(middle_ns[slot] - np.array(offsets))
    assert apart_ns.max() <= lasts_ns / (2 * MOST_TIME_SLOTS) * 1.001 + 1


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
        ([-(2**63), 2**63 - 1, 0, 0], Skewed.ABSURD_TIMES),
        ([], Skewed.NO_TIMES),
    ],
)
def test_unusable_times_are_refused(offset_ns, why):
    offsets = None if offset_ns is None else PointTimes.of_offsets(np.array(offset_ns, dtype=np.int64))
    n = 0 if offset_ns == [] else 4
    slot, middle_ns = sweep_slots(offsets, n)
    assert (sweep_span(offsets, n), slot.tolist(), middle_ns.tolist()) == (why, [0] * n, [0])


@pytest.mark.parametrize(
    ("row", "column", "change", "why"),
    [
        (0, 0, np.nan, Skewed.NO_POSE), (1, 0, np.nan, Skewed.NO_POSE), (32, 0, np.nan, Skewed.NO_POSE),
        (5, 0, 0.15, Skewed.JUMP), (5, 1, -0.15, Skewed.JUMP), (5, 2, 0.1, Skewed.JUMP), (5, 0, 0.02, None),
    ],
)  # fmt: skip
def test_unknown_or_jumping_poses_disable_deskewing(row, column, change, why):
    """Of a robot at 0.5 m/s that turns at 0.5 rad/s, past half a turn, where the yaw wraps, which is no jump."""
    slot_ns = T_NS + np.arange(MOST_TIME_SLOTS) * 3_000_000
    t_ns = np.array([T_NS, *slot_ns])
    t_s = (t_ns - T_NS) * 1e-9
    poses = np.column_stack([0.5 * t_s, np.zeros(len(t_s)), (0.5 * t_s - 0.02) % (2 * np.pi) - np.pi])
    poses[row:, column] += change
    found, skewed = slot_poses(t_ns[None], poses[None])
    assert skewed == [why]
    np.testing.assert_array_equal(found[0], poses[1:] if why is None else np.tile(poses[0], (len(slot_ns), 1)))
