from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from quadlog.mapping.grid import Window
from quadlog.mapping.lattice import GrowingLattice

windows = st.builds(
    lambda col0, row0, rows, cols: Window(col0, row0, 0.1, (rows, cols)),
    st.integers(-600, 600),
    st.integers(-600, 600),
    st.integers(1, 300),
    st.integers(1, 300),
)


@given(st.lists(windows, min_size=1, max_size=8))
def test_layers_keep_their_values_when_the_lattice_grows(added: list[Window]) -> None:
    lattice = GrowingLattice(0.1, {"count": np.int32})
    reference = np.zeros((1600, 1600), dtype=np.int32)
    for window in added:
        assert lattice.cover(window)
        lattice.view("count", window)[...] += 1
        (row0, col0), (rows, cols) = (window.row0 + 600, window.col0 + 600), window.shape
        reference[row0 : row0 + rows, col0 : col0 + cols] += 1
    covered = lattice.covered
    assert covered is not None
    row0, col0 = covered.row0 + 600, covered.col0 + 600
    expected = reference[row0 : row0 + covered.shape[0], col0 : col0 + covered.shape[1]]
    assert lattice.view("count", covered).tolist() == expected.tolist()
    assert expected.sum() == reference.sum()


def test_beyond_the_limit_nothing_changes() -> None:
    lattice = GrowingLattice(0.1, {"count": np.int32}, most_cells=100 * 100)
    near = Window(0, 0, 0.1, (50, 50))
    assert lattice.cover(near)
    assert not lattice.cover(Window(10**9, 0, 0.1, (50, 50)))
    assert lattice.covered == near
