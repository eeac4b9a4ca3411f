from __future__ import annotations

import numpy as np
import pytest

from quadlog.planning.search.grid_steps import FIRST_DIAGONAL, STEP_COL, STEP_COST, STEP_ROW, legal_steps, octile

STEPS = list(zip(STEP_COL.tolist(), STEP_ROW.tolist(), strict=True))


@pytest.mark.parametrize(("dcol", "drow"), [(0, 0), (3, 0), (0, -3), (2, 5), (-5, 2), (-4, -4)])
def test_octile_is_diagonal_steps_then_straight_ones(dcol, drow):
    across, along = abs(dcol), abs(drow)
    assert octile(dcol, drow) == 14 * min(across, along) + 10 * abs(across - along)


def test_steps_are_the_eight_around_a_cell_straight_ones_first():
    assert sorted(STEPS) == sorted((col, row) for col in (-1, 0, 1) for row in (-1, 0, 1) if col or row)
    for k, (dcol, drow) in enumerate(STEPS):
        assert (dcol != 0 and drow != 0) == (k >= FIRST_DIAGONAL)
        assert STEP_COST[k] == (14 if dcol and drow else 10)


@pytest.mark.parametrize("cutting", [False, True])
def test_legal_steps_of_all_surroundings(cutting):
    """All 256 of them: a step's end must be free, and unless corners may be cut so must the cells it passes."""
    for around in range(256):
        padded = np.zeros((3, 3), dtype=np.uint8)
        for k, (dcol, drow) in enumerate(STEPS):
            padded[1 + drow, 1 + dcol] = around >> k & 1
        legal = legal_steps.py_func(padded.reshape(-1), 4, 3, cutting)
        for k, (dcol, drow) in enumerate(STEPS):
            passes_blocked = padded[1, 1 + dcol] or padded[1 + drow, 1]
            wanted = not padded[1 + drow, 1 + dcol] and (cutting or not (dcol and drow and passes_blocked))
            assert bool(int(legal) >> k & 1) == wanted
