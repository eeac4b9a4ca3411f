from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from quadlog.metrics.planning import join_turn_rad, path_change_m, ratio_to_astar, search_samples
from quadlog.metrics.summary import metrics_of


def test_by_hand():
    replans = {
        "t_ns": np.arange(5),
        "found": np.array([True, True, False, True, True]),
        "expanded": np.array([100, 10, 500, 20, 1]),
        "generated": np.array([150, 20, 500, 40, 1]),
        "cost": np.array([100.0, 110.0, np.nan, 130.0, 0.0]),
        "optimal_cost": np.array([100.0, 100.0, np.nan, 104.0, 0.0]),
        "from_scratch": np.array([True, False, False, True, False]),
    }
    found = {name: (each.value, each.n) for name, each in metrics_of(search_samples(replans)).items()}
    # The first replan is always from scratch and is left out. Neither the failed one nor the robot at its goal can be
    # compared.
    assert found["fallback_share"] == (0.25, 4)
    assert found["suboptimality_mean"] == (pytest.approx((0 + 0.1 + 0.25) / 3), 3)
    assert (found["expanded_total"], found["generated_total"]) == ((631, 5), (711, 5))
    assert (found["expanded_mean"][0], found["success_rate"][0]) == pytest.approx((126.2, 0.8))
    assert ratio_to_astar(replans["expanded"], np.full(5, 631))["ratio_to_astar"].value == pytest.approx(5.0)
    assert ratio_to_astar(np.zeros(5, dtype=int), np.full(5, 631)) == {}


numbers = st.integers(-100, 100).map(lambda tenths: tenths / 10)
paths = st.lists(st.tuples(numbers, numbers), min_size=2, max_size=8, unique=True).map(np.array)


@given(paths, paths)
def test_the_change_is_the_distance_to_the_nearest_of_many_points(before: np.ndarray, after: np.ndarray) -> None:
    """Of those points of the new path that the old one reaches from where the new one begins."""
    dense = np.concatenate([np.linspace(a, b, 1001) for a, b in pairwise(before)])
    steps = np.hypot(*np.diff(before, axis=0).T)
    left = steps[int(np.hypot(*(before - after[0]).T).argmin()) :].sum()
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(after, axis=0).T))])
    wanted = cKDTree(dense).query(after[arc <= left + 1e-9])[0].mean()
    assert path_change_m(before, after) == pytest.approx(wanted, abs=steps.max() / 1000)
    beyond = np.vstack([before[1:], before[-1] + np.array([50.0, 0.0])])
    assert path_change_m(before, beyond) == pytest.approx(0.0, abs=1e-9), "a path that goes on as planned"


def test_the_turn_at_a_joint_by_hand() -> None:
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, -1.0], [2.0, -2.0]])
    assert [join_turn_rad(path, at) for at in range(4)] == pytest.approx([0.0, np.pi / 2, np.pi / 4, 0.0])
