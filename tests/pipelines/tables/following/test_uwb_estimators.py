from __future__ import annotations

import numpy as np
import pytest

from quadlog.pipelines.tables.following import uwb_estimators as uwb_tracking
from quadlog.pipelines.tables.following.uwb_estimators import (
    _draw_walk,
    score_all,
    tracking_group,
)
from quadlog.pipelines.tables.following.uwb_ranges import METHODS


@pytest.fixture(scope="module")
def scores():
    return score_all(10_000, seed=0)


def pick(scores, anchors, nlos, method):
    (found,) = [s for s in scores if (s.anchors, s.nlos, s.method) == (anchors, nlos, method)]
    return found


@pytest.mark.parametrize(("anchors", "bound_m"), [(3, 0.135), (4, 0.101), (5, 0.090), (8, 0.071)])
def test_efficient_methods_reach_the_bound(scores, anchors, bound_m):
    direct = pick(scores, anchors, False, "gauss_newton")
    assert direct.bound_m == pytest.approx(bound_m, abs=0.0006)
    assert direct.ratio == pytest.approx(1.0, abs=0.03)
    low, high = direct.ratio_interval
    assert low < direct.ratio < high
    assert high - low < 0.06
    if anchors > 3:
        assert pick(scores, anchors, False, "weighted").ratio == pytest.approx(1.0, abs=0.03)
        assert pick(scores, anchors, False, "linear").ratio > 1.05


def test_late_ranges_hurt_and_robust_weights_help_where_anchors_are_many(scores):
    for method in METHODS:
        assert pick(scores, 8, True, method).ratio > pick(scores, 8, False, method).ratio
    # To first order a direct fit among many anchors around it passes on the variance of noise and delay together:
    # 0.1^2 + (0.1 x 2 x 0.5^2 - (0.1 x 0.5)^2); their common mean cancels.
    assert pick(scores, 8, True, "gauss_newton").ratio == pytest.approx((0.0575 / 0.01) ** 0.5, rel=0.05)
    assert pick(scores, 8, True, "huber").ratio < 0.7 * pick(scores, 8, True, "gauss_newton").ratio


def test_the_reported_covariance_is_honest_in_line_of_sight(scores):
    for anchors in (5, 8):
        for method in ("gauss_newton", "weighted"):
            score = pick(scores, anchors, False, method)
            assert 0.94 <= score.covered <= 0.96
            assert score.covered_interval[0] < score.covered < score.covered_interval[1]


STILL_M = np.full((600, 2), [2.0, 0.0])


def test_a_lost_track_is_called_lost(monkeypatch):
    def away(t_s, position_m, range_m, *_):
        off_m = np.full(len(t_s), 2.0)
        return {"fix by fix": off_m, "causal track": off_m, "smoothed track": np.append(off_m[:-1], 0.5)}

    monkeypatch.setattr(uwb_tracking, "_errors", away)
    rows = {row.quantity: row.ours for row in tracking_group(3, seed=0).rows}
    assert rows["line of sight: share of runs lost, causal track"] == 1
    assert rows["line of sight: share of runs lost, smoothed track"] == 0
    assert rows["line of sight: RMSE, fix by fix (m)"] == 2


def test_a_burst_is_late_for_a_whole_slot_and_one_in_ten_slots_is():
    late = []
    for seed in range(40):
        clear_m = _draw_walk(STILL_M, False, np.random.default_rng(seed))
        extra_m = _draw_walk(STILL_M, True, np.random.default_rng(seed)) - clear_m
        slots_m = extra_m.reshape(20, 30, 3)
        np.testing.assert_allclose(slots_m, slots_m[:, :1].repeat(30, axis=1), atol=1e-12)
        late.append(slots_m[:, 0])
    extra_m = np.array(late)
    hidden = extra_m > 1e-9
    assert extra_m.min() > -1e-9
    assert hidden.mean() == pytest.approx(0.1, abs=0.02)
    assert extra_m[hidden].mean() == pytest.approx(0.5, abs=0.1)
