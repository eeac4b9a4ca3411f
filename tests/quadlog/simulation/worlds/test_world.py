from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.mapping.grid import Window
from quadlog.simulation.worlds.world import (
    World,
    body_clearance,
    body_gaps,
    discs_in,
    standing,
)

# No cell's centre lies on a rim that random numbers draw, so brute force needs no tolerance.
COORDINATES = st.floats(-2.0, 2.0).map(lambda x: round(x, 3) + 0.00037)
DISCS = st.lists(
    st.tuples(COORDINATES, COORDINATES, st.one_of(st.floats(0.001, 0.06), st.floats(0.06, 0.9))), max_size=6
)


def brute_force(window, covers):
    """covers(x, y) asked of the centre of every cell."""
    centres = [
        [((window.col0 + col + 0.5) * window.cell_m, (window.row0 + row + 0.5) * window.cell_m) for col in range(cols)]
        for row, cols in enumerate([window.shape[1]] * window.shape[0])
    ]
    return np.array([[covers(x, y) for x, y in row] for row in centres])


@given(DISCS)
def test_discs_cover_the_centres_in_them_and_the_cell_of_their_own(discs):
    window = Window(-17, -12, 0.1, (23, 31))

    def covers(x, y):
        in_disc = any(math.hypot(x - x0, y - y0) <= radius for x0, y0, radius in discs)
        return in_disc or any(max(abs(x - x0), abs(y - y0)) < 0.05 for x0, y0, _ in discs)

    np.testing.assert_array_equal(discs_in(window, np.array(discs).reshape(-1, 3)), brute_force(window, covers))


def somewhere(rng, moving=()):
    occupied = rng.random((30, 50)) < 0.3
    start_m = np.array([0.05, 0.05])
    return World(Window(-11, 7, 0.1, occupied.shape), occupied, start_m, standing(1.0, 1.0), moving)


@given(seed=st.integers(0, 2**32 - 1), col0=st.integers(-60, 60), row0=st.integers(-60, 60))
def test_a_window_shows_what_lies_at_its_places(seed, col0, row0):
    """Looked up by each cell's place in map; outside of the world nothing is occupied."""
    world = somewhere(np.random.default_rng(seed))
    window = Window(col0, row0, 0.1, (12, 17))
    seen = world.occupied_in(window, 0)
    for row in range(12):
        for col in range(17):
            there = world.window.cell_of(window.centre_of(np.array([col, row])))
            expected = bool(world.window.contains(there)) and world.occupied[there[1], there[0]]
            assert seen[row, col] == expected


def test_distances_from_the_sides_and_a_corner():
    def clearance(x, y):
        cells_m = np.array([[x, y]])
        found_m = body_clearance(0.0, 0.0, 0.0, 0.6, 0.2, cells_m, 0.1)
        assert body_gaps(np.zeros(3), 0.6, 0.2, cells_m, 0.1) == pytest.approx(found_m)
        return found_m

    assert clearance(1.0, 0.0) == pytest.approx(0.65)
    assert clearance(0.0, -0.5) == pytest.approx(0.35)
    assert clearance(0.6, 0.5) == pytest.approx(0.5 - 0.05)

    # Inside: the way out through the nearest side.
    assert clearance(0.2, 0.09) == pytest.approx(-0.01 - 0.05)
    assert clearance(0.2, 0.0) == pytest.approx(-0.1 - 0.05)
    assert clearance(-0.28, 0.0) == pytest.approx(-0.02 - 0.05)
