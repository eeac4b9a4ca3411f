from __future__ import annotations

import numpy as np
import pytest

from quadlog.metrics.planning import Replans, ratio_to_astar, search_samples
from quadlog.metrics.summary import metrics_of


def replans(**columns):
    defaults = {
        "t_ns": np.arange(5),
        "found": np.array([True, True, False, True, True]),
        "expanded": np.array([100, 10, 500, 20, 1]),
        "generated": np.array([150, 20, 500, 40, 1]),
        "cost": np.array([100.0, 110.0, np.nan, 130.0, 0.0]),
        "optimal_cost": np.array([100.0, 100.0, np.nan, 104.0, 0.0]),
        "from_scratch": np.array([True, False, False, True, False]),
    }
    return Replans(**(defaults | columns))


def test_by_hand():
    metrics = metrics_of(search_samples(replans()))
    assert metrics["expanded_total"].value == 631
    assert metrics["generated_total"].value == 711
    assert metrics["expanded_mean"].value == pytest.approx(126.2)
    assert metrics["success_rate"].value == pytest.approx(0.8)
    # The first replan is always from scratch and is left out.
    assert (metrics["fallback_share"].value, metrics["fallback_share"].n) == (0.25, 4)
    # Neither the failed replan nor the robot at its goal can be compared.
    assert metrics["suboptimality_mean"].n == 3
    assert metrics["suboptimality_mean"].value == pytest.approx((0 + 0.1 + 0.25) / 3)


def test_the_ratio_is_that_of_the_totals():
    assert ratio_to_astar(replans().expanded, np.full(5, 631))["ratio_to_astar"].value == pytest.approx(5.0)
    assert ratio_to_astar(np.zeros(5, dtype=int), np.full(5, 631)) == {}


def test_nothing_from_nothing():
    empty = replans(**dict.fromkeys(Replans.__slots__, np.empty(0)))
    assert metrics_of(search_samples(empty)) == {}
    failed = replans(found=np.zeros(5, dtype=bool), optimal_cost=np.full(5, np.nan), expanded=np.zeros(5))
    metrics = metrics_of(search_samples(failed))
    assert metrics["success_rate"].value == 0.0
    assert "suboptimality_mean" not in metrics
