from __future__ import annotations

import math

import pytest

from quadlog.planning.rules import COSTS, Rules


@pytest.mark.parametrize("costs", COSTS)
def test_what_steps_cost_in_cells(costs):
    """Ten tenths or a whole straight step; 1.4 or the root of 2 for a diagonal one, to the tenth digit."""
    straight, diagonal = Rules(costs).step_units
    wanted = 1.4 if costs == "integer" else math.sqrt(2)
    assert diagonal / straight == pytest.approx(wanted, rel=1e-10)
    assert Rules(costs).cost_of(3, 2) == pytest.approx((3 + 2 * wanted) * (10 if costs == "integer" else 1), rel=1e-15)
    assert isinstance(Rules("integer").cost_of(3, 2), int)


def test_exact_units_tell_paths_of_a_large_map_apart():
    """Two paths are as long only if they have as many steps of each kind, up to 55 000 diagonal ones more or less.

    The nearest miss is where a multiple of the root of 2 is nearest to a whole number.
    """
    straight, diagonal = Rules("exact").step_units
    for diagonals in range(1, 55_000):
        length = diagonals * math.sqrt(2)
        for straights in (math.floor(length), math.ceil(length)):
            assert (straights * straight > diagonals * diagonal) == (straights > length)
        assert abs(diagonals * diagonal - length * straight) < straight * abs(length - round(length))


@pytest.mark.parametrize("costs", COSTS)
@pytest.mark.parametrize(("heuristic", "steps"), [("octile", (4, 3)), ("manhattan", (10, 0)), ("zero", (0, 0))])
def test_heuristics_of_a_goal_seven_columns_and_three_rows_away(costs, heuristic, steps):
    """steps: straight and diagonal ones that it counts."""
    rules = Rules(costs, heuristic)
    along, across = rules.heuristic_units
    straight, diagonal = rules.step_units
    assert 7 * along + 3 * across == steps[0] * straight + steps[1] * diagonal
