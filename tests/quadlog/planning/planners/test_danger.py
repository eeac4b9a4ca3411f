from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import distance_transform_cdt

from quadlog.planning.planners.ea_star import danger_levels


@settings(max_examples=100, deadline=None)
@given(
    arrays(bool, st.tuples(st.integers(1, 15), st.integers(1, 15)), elements=st.sampled_from([False] * 9 + [True])),
    st.integers(0, 5),
)
def test_one_less_for_each_ring_away(blocked, rings):
    """Against scipy's chessboard distance."""
    away = distance_transform_cdt(np.pad(~blocked, 1, constant_values=True), "chessboard")[1:-1, 1:-1]
    wanted = np.maximum(rings + 1 - away, 0) if blocked.any() else np.zeros(blocked.shape)
    levels = danger_levels(blocked, rings)
    assert levels.dtype == np.int8
    np.testing.assert_array_equal(levels[~blocked], wanted[~blocked])
    assert not levels[blocked].any()


@pytest.mark.parametrize("value", [False, True])
def test_all_free_and_all_blocked(value):
    assert not danger_levels(np.full((4, 6), value), 3).any()
