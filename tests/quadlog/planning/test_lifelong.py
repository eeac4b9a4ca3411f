from __future__ import annotations

import numpy as np
import pytest

from quadlog.planning.lifelong import _slid
from quadlog.planning.lifelong_core import FAR, RHS, G, empty_field


@pytest.mark.parametrize("shift", [(0, 0), (1, -2), (-3, 2), (4, 4), (-30, 0), (0, 30)])
@pytest.mark.parametrize("to_shape", [(8, 9), (5, 12), (3, 3)])
def test_slid_cells_keep_what_is_known_but_on_the_border(shift, to_shape):
    """Cell by cell: (c, r) is what (c + dcol, r + drow) was; nothing is known of what was outside."""
    shape, (dcol, drow) = (8, 9), shift
    field = empty_field(shape)
    field.padded.reshape(shape)[1:-1, 1:-1] = 0
    field.records[:, G], field.records[:, RHS] = np.arange(72), np.arange(72) + 100
    slid, before = _slid(field, shape, to_shape, shift)
    for row in range(to_shape[0]):
        for col in range(to_shape[1]):
            old_row, old_col = row + drow, col + dcol
            was_inside = 0 <= old_row < 8 and 0 <= old_col < 9
            was_free = was_inside and 0 < old_row < 7 and 0 < old_col < 8
            is_border = row in (0, to_shape[0] - 1) or col in (0, to_shape[1] - 1)
            old = old_row * 9 + old_col
            wanted = (old, old + 100) if was_inside and not is_border else (FAR, FAR)
            assert tuple(slid.records[row * to_shape[1] + col, : RHS + 1]) == wanted
            assert before[row, col] == (not was_free)
    assert slid.padded.all()
