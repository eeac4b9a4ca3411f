from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.mapping.grid import window_around
from quadlog.results.scenes import CAUSES
from quadlog.simulation.contacts import Footprint, PlanInUse, TouchableCells, cause_of
from quadlog.simulation.worlds.world import body_clearance

BODY = Footprint(0.6, 0.3)
WINDOW = window_around(np.zeros(2), 0.1, 40)


def grid(*places_m, window=WINDOW):
    occupied = np.zeros(window.shape, dtype=bool)
    for place_m in places_m:
        col, row = window.cell_of(np.array(place_m, dtype=float))
        occupied[row, col] = True
    return occupied


def at(x_m, y_m=0.0, yaw_rad=0.0):
    return np.array([x_m, y_m, yaw_rad])


def renewed(cells, solid, pose, window=WINDOW):
    touchable_m, appeared_m = cells.renew(window, solid, pose)
    return len(touchable_m), len(appeared_m)


def test_a_cell_that_appears_inside_the_body_is_none_to_touch_until_the_body_has_left_it():
    cells, point = TouchableCells(BODY), grid((0.05, 0.05))
    assert renewed(cells, grid(), at(0.0)) == (0, 0)
    assert renewed(cells, point, at(0.0)) == (0, 1)
    # It stays one, and is not new, as long as the body is over it.
    assert renewed(cells, point, at(0.2)) == (0, 0)
    assert renewed(cells, point, at(1.0)) == (1, 0)
    assert renewed(cells, point, at(0.0)) == (1, 0)


def test_a_cell_that_was_there_before_the_body_came_is_touched():
    cells, wall = TouchableCells(BODY), grid((0.55, 0.05))
    assert renewed(cells, wall, at(0.0)) == (1, 0)
    assert renewed(cells, wall, at(0.5)) == (1, 0)
    # Also where the window has moved on between the maps.
    moved = window_around(np.array([0.7, 0.3]), 0.1, 40)
    assert renewed(cells, grid((0.55, 0.05), window=moved), at(0.5), moved) == (1, 0)


@given(seed=st.integers(0, 2**32 - 1))
def test_standing_still_nothing_is_ever_touched(seed):
    """Whatever maps say: everything inside the body has appeared there, and all else is out of reach."""
    rng = np.random.default_rng(seed)
    cells, pose = TouchableCells(BODY), np.array([*rng.uniform(-1, 1, 2), rng.uniform(-4, 4)])
    for share in rng.uniform(0, 0.4, 6):
        window = window_around(rng.uniform(-1, 1, 2), 0.1, 40)
        touchable_m, _ = cells.renew(window, rng.random(window.shape) < share, pose)
        assert body_clearance(*pose.tolist(), BODY.length_m, BODY.width_m, touchable_m, 0.1) > 0


PATH = np.column_stack([np.linspace(0, 2, 41), np.zeros(41)])
GOOD = PlanInUse(PATH, is_newest=True, remaining_m=1.0, chord_m=PATH[[0, 20]])


@pytest.mark.parametrize(
    ("cause", "given"),
    [
        ("fell", {"fallen": True}),
        ("no_plan", {"plan": None}),
        ("old_plan", {"plan": GOOD._replace(is_newest=False)}),
        ("unseen", {"is_mapped": False}),
        ("beyond_plan", {"plan": GOOD._replace(remaining_m=0.0)}),
        ("planned", {"cell_m": np.array([1.0, 0.1])}),
        ("cut_corner", {"plan": GOOD._replace(chord_m=np.array([[0.5, 0.0], [1.5, 0.5]]))}),
        ("unseen", {"cell_m": np.array([1.0, 0.1]), "is_mapped": False}),
        ("turning", {}),
    ],
)
def test_causes(cause, given):
    usual = {"cell_m": np.array([1.0, 0.25]), "is_mapped": True, "fallen": False, "plan": GOOD, "width_m": 0.3}
    assert cause_of(**(usual | given)) == cause
    assert cause in CAUSES
