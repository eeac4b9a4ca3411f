from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from quadlog.pipelines.tables.following.uwb_estimators import (
    ANCHORS,
    CHI_SQUARE_95,
    coverage_group,
    efficiency_group,
    score_all,
)
from quadlog.pipelines.tables.following.uwb_ranges import METHODS


@pytest.fixture(scope="module")
def scores():
    return score_all(10_000, seed=0)


def pick(scores, anchors, nlos, method):
    (found,) = [s for s in scores if (s.anchors, s.nlos, s.method) == (anchors, nlos, method)]
    return found


def test_the_ellipse_is_scipys():
    assert pytest.approx(stats.chi2(2).ppf(0.95), abs=1e-12) == CHI_SQUARE_95


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


def test_with_three_anchors_weights_change_nothing(scores):
    linear, weighted, paper = (pick(scores, 3, False, method).ratio for method in ("linear", "weighted", "paper"))
    assert linear == pytest.approx(weighted, rel=1e-9)
    assert linear == pytest.approx(paper, rel=1e-9)


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


def test_the_groups_hold_every_method_and_number_of_anchors(scores):
    clear, late = (efficiency_group(scores, nlos=nlos) for nlos in (False, True))
    per_number = len(METHODS)
    assert len(clear.rows) == len(ANCHORS) * (per_number + 1)
    assert len(late.rows) == len(ANCHORS) * per_number
    assert len(coverage_group(scores).rows) == len(ANCHORS) * per_number
    assert len({row.quantity for row in (*clear.rows, *late.rows)}) == len(clear.rows) + len(late.rows)
    row = next(row for row in clear.rows if row.quantity == "4 anchors: RMSE / bound, gauss_newton")
    assert row.ours == pick(scores, 4, False, "gauss_newton").ratio
    assert row.note.startswith("RMSE 0.10")


def test_epochs_without_a_fix_are_counted(scores):
    for score in scores:
        rows = (*efficiency_group(scores, nlos=score.nlos).rows,)
        where = f"{score.anchors} anchors{', NLOS' if score.nlos else ''}: RMSE / bound, {score.method}"
        row = next(row for row in rows if row.quantity == where)
        assert ("have no fix" in row.note) == (score.n_unsolved > 0)
        assert score.n_unsolved < 0.002 * score.n_fixes


def test_the_seed_decides(scores):
    again = score_all(200, seed=3)
    assert again == score_all(200, seed=3)
    assert again != score_all(200, seed=4)
    assert np.isfinite([score.ratio for score in again]).all()
