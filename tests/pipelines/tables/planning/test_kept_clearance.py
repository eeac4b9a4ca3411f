from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.pipelines.tables.planning.ea_star import clearance_cells, clearance_m, draw_crossings
from quadlog.simulation.worlds.scenes import SCENES


@given(st.integers(0, 2**32 - 1))
def test_clearance_is_the_least_of_all_pairs(seed):
    rng = np.random.default_rng(seed)
    occupied = rng.random((9, 12)) < 0.1
    occupied[0, 0] = True
    cells = np.argwhere(~occupied)[:, ::-1][rng.integers(0, (~occupied).sum(), size=5)].astype(np.int32)
    apart = np.abs(cells[:, None] - np.argwhere(occupied)[None, :, ::-1])
    assert clearance_cells(occupied, cells) == apart.max(axis=2).min()
    centres_m = 0.1 * np.hypot(apart[..., 0], apart[..., 1]).min()
    assert clearance_m(occupied, cells) == pytest.approx(centres_m - 0.05)


def test_crossings_lie_outside_of_all_rings_with_the_square_between_them():
    world = SCENES["single-obstacle"]()
    crossings = draw_crossings(world, 50, np.random.default_rng(0))
    assert len(set(crossings)) > 45
    for crossing in crossings:
        for col, row in (crossing.start, crossing.goal):
            assert clearance_cells(world.occupied, np.array([[col, row]])) > 4
        line = np.rint(np.linspace(crossing.start, crossing.goal, 2000)).astype(int)
        assert world.occupied[line[:, 1], line[:, 0]].any()
    assert crossings == draw_crossings(world, 50, np.random.default_rng(0))
