from __future__ import annotations

import numpy as np
import pytest

from quadlog.messages import Float
from quadlog.positioning.anchors.check import (
    SurveyFaults,
    TagEpochs,
    check_survey,
)
from quadlog.positioning.epochs import Epochs, group_epochs

ANCHORS_M = np.array(
    [[0.0, 0.0, 1.2], [8.0, 1.0, 2.2], [7.0, 7.0, 1.2], [1.0, 5.0, 2.2], [4.0, -1.5, 1.2], [3.0, 8.0, 1.8]]
)
IRREGULAR_M = ANCHORS_M[:5] * [1, 1, 0] + [0, 0, 1.2]
BIAS_M = np.array([0.25, 0.0, 0.1, 0.18, 0.3, 0.12])
NO_FAULT = SurveyFaults()


def log_of(lab, seed: int, walk=None, anchors_m=ANCHORS_M, **options) -> TagEpochs:
    options = {"duration_s": 30, "rate_hz": 8, "bursts": True, "bias_m": BIAS_M[: len(anchors_m)]} | options
    simulated = lab.simulate(walk or lab.walk_figure_eight, anchors_m, seed, **options)
    return TagEpochs(Epochs(simulated.t_ns, simulated.t_ns, simulated.range_m), lab.TAG_HEIGHT_M)


def stand(t_s):
    return np.tile([3.0, 3.0], (len(t_s), 1))


def check(anchors_m: Float, *logs: TagEpochs) -> SurveyFaults:
    return check_survey(logs, anchors_m, 0.1, 1.0)


def moved(anchors_m: Float, anchor: int, x_m: float, y_m: float) -> Float:
    """Configured so far from where it is."""
    other_m = anchors_m.copy()
    other_m[anchor, :2] += x_m, y_m
    return other_m


def swapped(anchors_m: Float, pair: tuple[int, int]) -> Float:
    order = np.arange(len(anchors_m))
    order[list(pair)] = pair[::-1]
    return anchors_m[order]


@pytest.mark.parametrize("pair", [(0, 1), (0, 4), (2, 3)])
def test_a_swapped_pair_is_named_before_any_shift_and_true_anchors_raise_no_alarm(lab, pair):
    log = log_of(lab, 0, anchors_m=IRREGULAR_M)
    assert check(IRREGULAR_M, log) == NO_FAULT
    assert check(swapped(IRREGULAR_M, pair), log) == SurveyFaults(swapped=(pair,))


def test_symmetry_hides_what_it_must(lab):
    """A swap across a square's diagonal mirrors it. In a rectangle that of one side looks like that of the other."""
    square_m = np.array([[0.0, 0.0, 1.2], [7.0, 0.0, 1.2], [7.0, 7.0, 1.2], [0.0, 7.0, 1.2]])
    assert check(swapped(square_m, (0, 2)), log_of(lab, 2, anchors_m=square_m)) == NO_FAULT
    silent = log_of(lab, 6, anchors_m=IRREGULAR_M)
    silent.epochs.range_m[:, 4] = np.nan
    found = check(swapped(IRREGULAR_M, (0, 1)), silent).swapped
    assert found[0] == (0, 1)
    assert all(4 not in pair for pair in found)
    oblong_m = square_m * [1.6, 1.0, 1.0]
    assert sorted(check(swapped(oblong_m, (0, 1)), log_of(lab, 3, anchors_m=oblong_m)).swapped) == [(0, 1), (2, 3)]


@pytest.mark.parametrize(("anchor", "x_m", "y_m"), [(0, 0.7, 0.0), (3, 0.0, -0.7), (4, 1.5, 2.0)])
def test_a_shifted_anchor_is_named_and_placed(lab, anchor, x_m, y_m):
    got = check(moved(ANCHORS_M, anchor, x_m, y_m), log_of(lab, 1))
    assert ([each.anchor for each in got.shifted], got.swapped) == ([anchor], ())
    error_m = np.add(got.shifted[0].shift_m, [x_m, y_m])
    assert np.hypot(*error_m) < 0.3
    assert error_m @ np.linalg.solve(got.shifted[0].covariance_m2, error_m) < 9.2  # 99 % of two degrees of freedom
    assert got.shifted[0].distance_m == pytest.approx(np.hypot(x_m, y_m), abs=4 * got.shifted[0].distance_std_m)


@pytest.mark.parametrize(
    ("n_anchors", "duration_s", "walks"), [(3, 30, True), (6, 4, True), (6, 12, True), (6, 30, False)]
)
def test_few_anchors_short_logs_and_standing_tags_accuse_nobody(lab, n_anchors, duration_s, walks):
    log = log_of(lab, 7, None if walks else stand, duration_s=duration_s)
    log.epochs.range_m[:, n_anchors:] = np.nan
    for anchors_m in (ANCHORS_M, moved(ANCHORS_M, 3, 0.5, -0.5)):
        assert check(anchors_m, log) == check(anchors_m) == NO_FAULT


@pytest.fixture(scope="module")
def trolley_logs(trolley) -> list[TagEpochs]:
    return [TagEpochs(group_epochs(trolley.series, tag, np.arange(8), 0.05)[0], 0.97) for tag in range(3)]


def test_the_trolleys_survey_is_right(trolley, trolley_logs):
    """Real biases of 0.1 to 0.3 m and real reflections: each tag and all together find nothing."""
    for logs in (trolley_logs, *([log] for log in trolley_logs)):
        assert check(trolley.anchors_m, *logs) == NO_FAULT


@pytest.mark.parametrize("anchor", [0, 3, 6])
def test_half_a_metre_on_a_real_anchor_is_named(trolley, trolley_logs, anchor):
    off_m = 0.5 * np.array([np.cos(np.radians(77 * anchor)), np.sin(np.radians(77 * anchor))])
    (shifted,) = check(moved(trolley.anchors_m, anchor, *off_m), trolley_logs[0]).shifted
    assert shifted.anchor == anchor
    assert np.hypot(*(shifted.shift_m + off_m)) < 0.2


@pytest.mark.parametrize("pair", [(0, 1), (2, 6)])
def test_two_real_anchors_swapped_are_named_by_one_tag(trolley, trolley_logs, pair):
    assert check(swapped(trolley.anchors_m, pair), trolley_logs[1]) == SurveyFaults(swapped=(pair,))
