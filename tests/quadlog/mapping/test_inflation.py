from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage
from scipy.spatial.distance import cdist

from quadlog.mapping.inflation import inflate, inflate_square

grids = arrays(np.bool_, st.tuples(st.integers(1, 30), st.integers(1, 30)))


@given(grids, st.one_of(st.floats(0, 12), st.integers(0, 12).map(float)))
def test_euclidean_is_the_distance_to_the_nearest_occupied_cell(occupied: np.ndarray, radius_cells: float) -> None:
    apart = cdist(np.argwhere(np.ones_like(occupied)), np.argwhere(occupied)).min(axis=1, initial=np.inf)
    assert (inflate(occupied, radius_cells).ravel() == (apart <= radius_cells + 1e-9)).all()


@given(grids, st.integers(0, 12))
def test_square_agrees_with_scipy(occupied: np.ndarray, radius_cells: int) -> None:
    expected = ndimage.binary_dilation(occupied, np.ones((2 * radius_cells + 1,) * 2))
    assert (inflate_square(occupied, radius_cells) == expected).all()


def test_a_radius_in_metres_reaches_the_cells_it_names() -> None:
    occupied = np.zeros((9, 9), dtype=np.bool_)
    occupied[4, 4] = True
    grown = inflate(occupied, 0.3 / 0.1)  # a little less than 3
    assert grown[4].tolist() == grown[:, 4].tolist() == [False, True, True, True, True, True, True, True, False]


@pytest.mark.parametrize("radius", [-1.0, float("nan")])
def test_negative_radius_is_refused(radius: float) -> None:
    with pytest.raises(ValueError, match="inflation radius"):
        inflate(np.zeros((3, 3), dtype=np.bool_), radius)
