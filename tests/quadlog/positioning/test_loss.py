from __future__ import annotations

import numpy as np
import pytest

from quadlog.positioning.loss import find_loss

ANCHORS_M = np.array([[0.0, 0.0, 1.0], [8.0, 0.0, 1.0], [8.0, 7.0, 1.0], [0.0, 7.0, 1.0]])


def ask(true_m, track_m, *, velocity=(0.0, 0.0), rate_hz=10.0, std_m=0.1, still_far=False, first=0, range_m=None):
    """F fixes and exact ranges of a tag that is at true_m (F, 2), while the track says track_m (F, 2)."""
    t_s = np.arange(len(true_m)) / rate_hz
    if range_m is None:
        range_m = np.linalg.norm(np.column_stack([true_m, np.ones(len(true_m))])[:, None] - ANCHORS_M, axis=2)
    state = np.column_stack([track_m, np.broadcast_to(velocity, track_m.shape)])
    return find_loss(
        t_s, true_m, 4 * np.arange(1, len(t_s) + 1), state, np.column_stack([track_m, np.ones(len(t_s))]),
        np.repeat(t_s, 4), np.tile(ANCHORS_M, (len(t_s), 1)), range_m.ravel(), std_m, still_far, first,
    )  # fmt: skip


@pytest.mark.parametrize("rate_hz", [2.0, 5.0, 50.0])
def test_a_jump_is_dated_to_its_first_fix_and_known_a_second_later(rate_hz):
    count = round(6 * rate_hz)
    jump = count // 2
    true_m = np.full((count, 2), 3.0)
    true_m[jump:, 0] += 2.0
    since, known = ask(true_m, np.full((count, 2), 3.0), rate_hz=rate_hz)
    assert since == jump
    assert jump + 0.8 * rate_hz <= known + 1 <= jump + max(rate_hz, 4) + 1


def test_what_comes_later_changes_nothing():
    true_m = np.full((60, 2), 3.0)
    true_m[30:, 0] += 2.0
    since, known = ask(true_m, np.full((60, 2), 3.0))
    assert ask(true_m[: known + 1], np.full((known + 1, 2), 3.0)) == (since, known)
    assert ask(true_m[:known], np.full((known, 2), 3.0)) == (-1, -1)


def test_a_track_that_found_back_counts_unless_asked_whether_it_is_still_far():
    true_m = np.full((60, 2), 3.0)
    true_m[30:, 0] += 2.0
    track_m = true_m.copy()
    track_m[30:36] = 3.0
    assert ask(true_m, track_m)[0] == 30
    assert ask(true_m, track_m, still_far=True) == (-1, -1)
    assert ask(true_m, np.full((60, 2), 3.0), still_far=True)[0] == 30


def test_what_is_no_loss():
    still_m = np.full((60, 2), 3.0)
    near_m = still_m + np.array([0.0, 0.9])  # nine std of a range
    assert ask(near_m, still_m) == (-1, -1)
    turn_m = still_m + np.stack([np.maximum(0, np.arange(60) - 30) * 0.3, np.zeros(60)], axis=1)  # 3 m/s, at once
    assert ask(turn_m, turn_m) == (-1, -1)
    disagreeing_m = still_m + 3.0 * np.random.default_rng(0).standard_normal((60, 2))
    assert ask(disagreeing_m, still_m) == (-1, -1)
    brief_m = still_m.copy()
    brief_m[30:36] += 2.0
    assert ask(brief_m, still_m) == (-1, -1)


def test_ranges_must_contradict_the_track_as_well():
    """One blocked path moves the fixes of few anchors, but the other ranges still fit."""
    jumped_m = np.full((60, 2), 3.0)
    jumped_m[30:, 0] += 2.0
    range_m = np.tile(np.linalg.norm(np.array([3.0, 3.0, 1.0]) - ANCHORS_M, axis=1), (60, 1))
    range_m[30:, 0] += 2.0
    assert ask(jumped_m, np.full((60, 2), 3.0), range_m=range_m) == (-1, -1)


def test_motion_goes_on_straight():
    walked_m = np.array([1.0, 1.0]) + np.arange(60)[:, None] * [0.08, 0.05]
    assert ask(walked_m, walked_m, velocity=(0.8, 0.5)) == (-1, -1)
    ran_m = np.array([1.0, 1.0]) + np.arange(60)[:, None] * [0.4, 0.0]
    carried_m = ran_m + np.where(np.arange(60)[:, None] >= 40, [0.0, 2.0], 0.0)
    assert ask(carried_m, ran_m, velocity=(4.0, 0.0))[0] == 40


def test_few_fixes_and_slow_ones_are_not_asked():
    assert ask(np.full((3, 2), 9.0), np.full((3, 2), 3.0)) == (-1, -1)
    assert ask(np.full((20, 2), 9.0), np.full((20, 2), 3.0), rate_hz=1.0) == (-1, -1)
    assert ask(np.empty((0, 2)), np.empty((0, 2))) == (-1, -1)


def test_asking_from_later_on():
    true_m = np.full((80, 2), 3.0)
    true_m[20:40, 0] += 2.0
    track_m = np.full((80, 2), 3.0)
    since, known = ask(true_m, track_m)
    assert since == 20
    later = ask(true_m, track_m, first=known + 5)
    assert later[1] == known + 5
