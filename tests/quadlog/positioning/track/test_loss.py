from __future__ import annotations

import numpy as np
import pytest

from quadlog.positioning.track.segments import Evidence, find_loss

ANCHORS_M = np.array([[0.0, 0.0, 1.0], [8.0, 0.0, 1.0], [8.0, 7.0, 1.0], [0.0, 7.0, 1.0]])


def ask(true_m, track_m, *, velocity=(0.0, 0.0), rate_hz=10.0, std_m=0.1, still_far=False, first=0, range_m=None):
    """F fixes and exact ranges of a tag that is at true_m (F, 2), while the track says track_m (F, 2)."""
    t_s = np.arange(len(true_m)) / rate_hz
    if range_m is None:
        range_m = np.linalg.norm(np.column_stack([true_m, np.ones(len(true_m))])[:, None] - ANCHORS_M, axis=2)
    state = np.column_stack([track_m, np.ones(len(t_s)), np.broadcast_to(velocity, track_m.shape)])
    evidence = Evidence(
        t_s, true_m, 4 * np.arange(1, len(t_s) + 1), state, np.repeat(t_s, 4), np.tile(ANCHORS_M, (len(t_s), 1)),
        range_m.ravel(),
    )  # fmt: skip
    return find_loss(evidence, std_m, still_far, first)


@pytest.mark.parametrize("rate_hz", [2.0, 5.0, 50.0])
def test_a_jump_is_dated_to_its_first_fix_and_known_a_second_later(rate_hz):
    count = round(6 * rate_hz)
    jump = count // 2
    true_m = np.full((count, 2), 3.0)
    true_m[jump:, 0] += 2.0
    since, known = ask(true_m, np.full((count, 2), 3.0), rate_hz=rate_hz)
    assert since == jump
    assert jump + 0.8 * rate_hz <= known + 1 <= jump + max(rate_hz, 4) + 1


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


def test_few_fixes_and_slow_ones_are_not_asked():
    assert ask(np.full((3, 2), 9.0), np.full((3, 2), 3.0)) == (-1, -1)
    assert ask(np.full((20, 2), 9.0), np.full((20, 2), 3.0), rate_hz=1.0) == (-1, -1)
    assert ask(np.empty((0, 2)), np.empty((0, 2))) == (-1, -1)


def test_a_long_log_is_searched_to_its_end():
    true_m = np.full((1300, 2), 3.0)
    true_m[1200:, 0] += 2.0
    assert ask(true_m, np.full((1300, 2), 3.0))[0] == 1200


@pytest.mark.parametrize(("std_m", "still_far"), [(0.1, False), (0.03, False), (0.03, True)])
def test_it_is_the_rule_one_fix_after_the_other(std_m, still_far):
    """The windows of a wild log, each looked at by itself, at uneven instants and from any first fix on."""
    rng = np.random.default_rng(7)
    for _ in range(30):
        count = 120
        t_s = np.cumsum(rng.uniform(0.02, 0.4, count))
        fix_m = np.cumsum(rng.normal(0, 0.1, (count, 2)), axis=0) + np.repeat(rng.normal(0, 2, (6, 2)), 20, axis=0)
        state = np.column_stack([rng.normal(0, 1, (count, 2)), np.ones(count), rng.normal(0, 0.5, (count, 2))])
        places_m = np.column_stack([fix_m, np.ones(count)])
        range_m = np.linalg.norm(places_m[:, None] - ANCHORS_M, axis=2).ravel()
        rows = (4 * np.arange(1, count + 1), state, np.repeat(t_s, 4), np.tile(ANCHORS_M, (count, 1)), range_m)
        evidence, first = Evidence(t_s, fix_m, *rows), int(rng.integers(0, 60))
        assert find_loss(evidence, std_m, still_far, first) == one_by_one(evidence, std_m, still_far, first)


def one_by_one(e: Evidence, std_m: float, still_far: bool, first: int) -> tuple[int, int]:
    for known in range(max(first, 4), len(e.fix_t_s)):
        before = known - 4
        while before > 0 and e.fix_t_s[known] - e.fix_t_s[before] < 1:
            before -= 1
        if not 1 <= e.fix_t_s[known] - e.fix_t_s[before] <= 2:
            continue
        ahead_s = e.fix_t_s[before + 1 : known + 1] - e.fix_t_s[before]
        off_m = e.fix_m[before + 1 : known + 1] - e.states[before, :2] - np.outer(ahead_s, e.states[before, 3:])
        far_m = np.linalg.norm(off_m.mean(axis=0))
        agree = np.sqrt(off_m.var(axis=0).sum()) <= far_m / 3
        away = np.linalg.norm(off_m[-1]) >= 10 * std_m and far_m >= 10 * std_m
        lost = not still_far or np.linalg.norm(e.fix_m[known] - e.states[known, :2]) >= 10 * std_m
        rows = slice(e.fix_end_row[before], e.fix_end_row[known])
        moved_m = np.outer(e.row_t_s[rows] - e.fix_t_s[before], e.states[before, 3:])
        place_m = e.states[before, :3] + np.column_stack([moved_m, np.zeros(len(moved_m))])
        bad = np.abs(e.range_m[rows] - np.linalg.norm(place_m - e.anchor_m[rows], axis=1)) > 4 * std_m
        if agree and away and lost and bad.mean() > 0.5:
            return before + 1 + int(np.argmax(np.linalg.norm(off_m, axis=1) > far_m / 2)), known
    return -1, -1
