from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from quadlog.config import Planner as PlannerSection
from quadlog.errors import UnknownName
from quadlog.planning.registry import PLANNERS, make_planner


@pytest.mark.parametrize("name", sorted(PLANNERS))
def test_every_planner_plans_under_its_name(name):
    planner = make_planner(name)
    assert planner.name == name
    assert planner.plan(np.zeros((5, 5), dtype=bool), (0, 0), (4, 4)).cost == 56


@pytest.mark.parametrize("name", sorted(PLANNERS))
def test_corner_cutting_reaches_the_planner(name):
    blocked = np.array([[False, True], [True, False]])
    assert not make_planner(name).plan(blocked, (0, 0), (1, 1)).found
    assert make_planner(name, corner_cutting=True).plan(blocked, (0, 0), (1, 1)).cost == 14


def test_config_offers_what_there_is():
    """It lists the names itself: importing the planners would make every command wait for their compiled cores."""
    assert set(get_args(PlannerSection.model_fields["name"].annotation)) == set(PLANNERS)


def test_unknown_name_lists_the_choices():
    with pytest.raises(UnknownName, match="astar, d_star_lite, ia_star, lpa_star, mt_d_star_lite"):
        make_planner("a*")
