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
