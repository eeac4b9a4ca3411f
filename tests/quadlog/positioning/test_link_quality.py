from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadlog.messages import RangeSeries
from quadlog.positioning.links import AnchorBias, RangeRows, link_quality, weak_first_path_share

IDS = np.array([7, 3, 5])


def rows(anchor, residual_m) -> RangeRows:
    n = len(anchor)
    predicted_m = np.where(np.isnan(residual_m), np.nan, 4.0)
    return RangeRows(np.arange(n), np.array(anchor), np.nan_to_num(residual_m) + 4.0, predicted_m, np.ones(n))


def test_every_link_in_the_order_of_its_anchors():
    residual_m = np.array([0.1, -0.1, 0.1, 0.5, 0.0, 0.2, np.nan])
    quality = link_quality(rows([7, 7, 7, 7, 3, 3, 3], residual_m), IDS, None, 0.1)
    assert quality.n.tolist() == [4, 2, 0]
    assert_allclose(quality.residual_rms_m, [np.sqrt(0.28 / 4), np.sqrt(0.02), np.nan])
    assert_allclose(quality.residual_median_m, [0.1, 0.1, np.nan])
    assert_allclose(quality.nlos_share, [0.25, 0.0, np.nan])
    assert quality.bias_applied.tolist() == [False] * 3
    assert np.isnan(quality.bias_m).all()
    assert np.isnan(quality.bias_std_m).all()
    assert set(quality.why_not) == {"calibration is off"}


@pytest.mark.parametrize(("residual_m", "late"), [(0.299, False), (0.301, True), (-0.9, False)])
def test_nlos_is_late_by_more_than_three_std_and_never_early(residual_m, late):
    quality = link_quality(rows([3], np.array([residual_m])), np.array([3]), None, 0.1)
    assert quality.nlos_share.tolist() == [float(late)]


def test_an_estimate_goes_with_its_std_and_whether_it_is_used():
    bias = AnchorBias(np.array([0.2, 0.01, 0.1]), np.array([0.03, 0.03, 0.16]), np.array([90, 80, 0]), np.eye(4)[3])
    quality = link_quality(rows([7], np.array([0.0])), IDS, bias, 0.1)
    assert_allclose(quality.bias_m, [0.2, 0.01, 0.1])
    assert_allclose(quality.bias_std_m, [0.03, 0.03, 0.16])
    assert quality.bias_applied.tolist() == [True, True, False]
    assert quality.why_not == ("", "", "no ranges")
    assert bias.reason == "the ranges favour a bias of each link (100%)"


def test_weak_first_paths_are_counted_where_the_radio_tells():
    series = RangeSeries(np.arange(6), np.array([0, 0, 0, 0, 1, 0]), np.array([7, 7, 7, 3, 3, 7]), np.ones(6))
    gap_db = np.array([5.9, 6.1, 20.0, np.nan, 9.0, np.nan])
    assert_allclose(weak_first_path_share(series, gap_db, 0, IDS), [2 / 3, np.nan, np.nan])
    assert_allclose(weak_first_path_share(series, gap_db, 1, IDS), [np.nan, 1.0, np.nan])
    assert np.isnan(weak_first_path_share(series, None, 0, IDS)).all()
