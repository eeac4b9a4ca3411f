from __future__ import annotations

import numpy as np
import pytest

from quadlog.pipelines.tables.planning.planner_walks import CELL_RATIO, CELLS, LENGTH_M, PRINTED_RATIO, TIME_S
from quadlog.simulation.worlds.world import SPEED_MPS


def test_the_printed_ratios_follow_from_the_printed_totals_but_for_their_last_digit():
    assert CELL_RATIO[6] == pytest.approx(23180 / 4177) == pytest.approx(5.5494, abs=1e-4)
    assert np.abs(CELL_RATIO - PRINTED_RATIO).max() < 0.05
    np.testing.assert_allclose(np.delete(CELL_RATIO, 6), np.delete(PRINTED_RATIO, 6), atol=0.01)
    assert np.flatnonzero(np.round(CELL_RATIO, 2) != PRINTED_RATIO).tolist() == [3, 4, 5, 6]


def test_sums_by_hand():
    """Added up on paper, so that a mistyped digit shows."""
    assert CELLS.sum(axis=1).tolist() == [337176, 45531]
    np.testing.assert_allclose(LENGTH_M.sum(axis=1), [203.86, 201.10])
    np.testing.assert_allclose(TIME_S.sum(axis=1), [715.60, 739.07])
    assert LENGTH_M[0].sum() / TIME_S[0].sum() == pytest.approx(SPEED_MPS, abs=5e-4)


def test_ia_star_is_shorter_in_eight_of_ten_and_slower_in_eight():
    assert (LENGTH_M[1] < LENGTH_M[0]).sum() == 8
    assert (TIME_S[1] > TIME_S[0]).sum() == 8
