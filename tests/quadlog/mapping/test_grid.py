from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.mapping.grid import Window, crop, window_around

cells_m = st.sampled_from([0.05, 0.1, 0.25, 1.0])
places = st.integers(-(10**6), 10**6)
metres = st.floats(-1e4, 1e4)


@given(places, places, cells_m, st.integers(-50, 250), st.integers(-50, 250))
def test_centre_of_a_cell_lies_in_that_cell(col0: int, row0: int, cell_m: float, col: int, row: int) -> None:
    window = Window(col0, row0, cell_m, (30, 200))
    cell = np.array([col, row])
    assert window.cell_of(window.centre_of(cell)).tolist() == [col, row]
    assert bool(window.contains(cell)) == (0 <= col < 200 and 0 <= row < 30)


@given(metres, metres, cells_m, st.integers(1, 300))
def test_a_point_lies_within_half_a_cell_of_its_cells_centre(x_m: float, y_m: float, cell_m: float, size: int) -> None:
    window = window_around(np.array([x_m, y_m]), cell_m, size)
    cell = window.cell_of(np.array([x_m, y_m]))
    assert window.contains(cell)
    assert cell.tolist() == [size // 2, size // 2]
    assert np.abs(window.centre_of(cell) - [x_m, y_m]).max() <= cell_m / 2 + 1e-9
    assert window.shape == (size, size)


def test_points_that_are_not_finite_are_refused_and_those_beyond_every_integer_lie_outside() -> None:
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="not finite"):
            window_around(np.array([bad, 0.0]), 0.1, 200)
    window = Window(0, 0, 0.1, (10, 10))
    assert not window.contains(window.cell_of(np.array([[1e300, 0.5], [0.5, -1e300]]))).any()


@given(st.integers(-15, 15), st.integers(-15, 15), st.integers(1, 9), st.integers(1, 9))
def test_crop_holds_the_cells_that_both_windows_have(col0, row0, rows, cols):
    grid = np.random.default_rng(0).random((6, 8)) < 0.5
    of, to = Window(-3, 2, 0.1, (6, 8)), Window(col0, row0, 0.1, (rows, cols))
    cropped = crop(grid, of, to)
    for row in range(rows):
        for col in range(cols):
            r, c = row + row0 - 2, col + col0 + 3
            inside = 0 <= r < 6 and 0 <= c < 8
            assert cropped[row, col] == (grid[r, c] if inside else False)
