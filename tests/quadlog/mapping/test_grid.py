from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.mapping.grid import Window, window_around

metres = st.floats(-1e4, 1e4)


@given(
    metres,
    metres,
    st.sampled_from([0.05, 0.1, 0.25, 1.0]),
    st.integers(1, 300),
    st.tuples(*[st.integers(-50, 350)] * 2),
)
def test_points_lie_within_half_a_cell_of_their_cells_centres(x_m, y_m, cell_m, size, cell) -> None:
    window = window_around(np.array([x_m, y_m]), cell_m, size)
    assert window.shape == (size, size)
    middle = window.cell_of(np.array([x_m, y_m]))
    assert middle.tolist() == [size // 2, size // 2]
    assert np.abs(window.centre_of(middle) - [x_m, y_m]).max() <= cell_m / 2 + 1e-9
    assert window.cell_of(window.centre_of(np.array(cell))).tolist() == list(cell)
    assert bool(window.contains(np.array(cell))) == (min(cell) >= 0 and max(cell) < size)


def test_points_that_are_not_finite_are_refused_and_those_beyond_every_integer_lie_outside() -> None:
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="not finite"):
            window_around(np.array([bad, 0.0]), 0.1, 200)
    window = Window(0, 0, 0.1, (10, 10))
    assert not window.contains(window.cell_of(np.array([[1e300, 0.5], [0.5, -1e300]]))).any()
