from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from quadlog.compiled import kernel
from quadlog.planning.search import grid_steps
from quadlog.planning.search.grid_steps import REANCHOR_CELLS

UNITS = (10, 14)
# As they are compiled into the searches: in Python, sums of numpy's int32 would overflow.
kept_route = kernel(grid_steps.kept_route)


def is_open(blocked, at, to, cutting):
    """The rule of a legal step between neighbouring cells."""
    (col, row), (to_col, to_row) = at, to
    if not (0 <= to_row < blocked.shape[0] and 0 <= to_col < blocked.shape[1]) or blocked[to_row, to_col]:
        return False
    return cutting or not (blocked[row, to_col] or blocked[to_row, col])


def cost_of(cells, units=UNITS):
    """Of a way (col, row) of single steps."""
    return sum(units[a[0] != b[0] and a[1] != b[1]] for a, b in pairwise(cells))


def octile(a, b, units=UNITS):
    across, along = abs(a[0] - b[0]), abs(a[1] - b[1])
    return units[0] * abs(across - along) + units[1] * min(across, along)


def direct_ways(at, to):
    """Both ways with all diagonal steps at one end: the diagonal ones first, then last."""
    signs = np.sign(np.subtract(to, at))
    away = np.abs(np.subtract(to, at))
    straight = np.where(away == away.max(), signs, 0) if away[0] != away[1] else signs
    steps = [signs] * min(away) + [straight] * (max(away) - min(away))
    for each in (steps, steps[::-1]):
        yield [tuple((np.array(at) + sum(each[:k], np.zeros(2, dtype=int))).tolist()) for k in range(len(each) + 1)]


def free_way(blocked, at, to, cutting):
    """The first direct way that is free, None when neither is."""
    for way in direct_ways(at, to):
        if all(is_open(blocked, a, b, cutting) for a, b in pairwise(way)):
            return way
    return None


def reference(blocked, route, start, goal, cutting, units, from_end):
    """(kept cells, those of them that are new), by the rules taken one at a time."""
    inside = [0 <= c < blocked.shape[1] and 0 <= r < blocked.shape[0] for c, r in route]
    if start in route:
        first, way = route.index(start), [start]
    else:
        ways = {
            i: free_way(blocked, start, cell, cutting)
            for i, cell in enumerate(route)
            if inside[i] and max(abs(cell[0] - start[0]), abs(cell[1] - start[1])) <= REANCHOR_CELLS
        }
        lengths = {i: octile(start, route[i], units) + cost_of(route[i:], units) for i, way in ways.items() if way}
        if not lengths:
            return [], 0
        first = min(i for i, length in lengths.items() if length == min(lengths.values()))
        way = ways[first]
    end = next((i for i in range(first, len(route)) if not inside[i]), len(route))
    path = way[:-1] + route[first:end]
    if blocked[path[0][1], path[0][0]] or not all(is_open(blocked, a, b, cutting) for a, b in pairwise(path)):
        return [], 0
    f = [
        cost_of(path[: i + 1], units) + units[0] * (abs(c - goal[0]) + abs(r - goal[1]))
        for i, (c, r) in enumerate(path)
    ]
    waypoint = max(i for i in range(len(path)) if f[i] == min(f))
    if from_end:
        waypoint = len(path) - 1
        while waypoint > 0 and f[waypoint - 1] < f[waypoint]:
            waypoint -= 1
    return path[: waypoint + 1], len(way) - 1


@given(
    seed=st.integers(0, 2**32 - 1),
    density=st.sampled_from([0.0, 0.05, 0.15]),
    cutting=st.booleans(),
    from_end=st.booleans(),
    units=st.sampled_from([UNITS, (2**32, round(2**32 * 2**0.5))]),
)
def test_what_is_kept_step_by_step(seed, density, cutting, from_end, units):
    """On routes that may leave the window and return, for a robot on them, beside them, and far from them."""
    rng = np.random.default_rng(seed)
    blocked = rng.random((11, 12)) < density
    steps = rng.choice([-1, 0, 1], (14, 2), p=[0.15, 0.15, 0.7])
    shift = rng.integers(-3, 4, 2)
    route = rng.integers(-2, 6, 2) + np.cumsum(steps[steps.any(axis=1)], axis=0)
    start, goal = (tuple(rng.integers(0, (12, 11)).tolist()) for _ in range(2))
    on_route = tuple(route[rng.integers(len(route))].tolist())
    if rng.random() < 0.3 and 0 <= on_route[0] < 12 and 0 <= on_route[1] < 11:
        start = on_route
    blocked[start[1], start[0]] = False
    cells = np.zeros((len(route) + REANCHOR_CELLS, 2), dtype=np.int32)
    old_route = (route + shift).astype(np.int32)
    kept, linking, straights, diagonals = kept_route(
        blocked, old_route, *shift, start, goal, cutting, units, cells, from_end
    )
    wanted, new = reference(blocked, [tuple(cell) for cell in route.tolist()], start, goal, cutting, units, from_end)
    assert [tuple(cell) for cell in cells[:kept].tolist()] == wanted
    if wanted:
        assert linking == new
        assert units[0] * straights + units[1] * diagonals == cost_of(wanted, units)
        assert straights + diagonals == kept - 1


def kept_cells(route, start, goal, blocked=None, from_end=False):
    blocked = np.zeros((20, 30), dtype=bool) if blocked is None else blocked
    cells = np.zeros((len(route) + REANCHOR_CELLS, 2), dtype=np.int32)
    route = np.array(route, dtype=np.int32)
    kept, linking, straights, diagonals = kept_route(blocked, route, 0, 0, start, goal, False, UNITS, cells, from_end)
    return cells[:kept].tolist(), linking, 10 * straights + 14 * diagonals


def test_kept_up_to_the_least_f_from_the_end():
    """f by hand: straight towards the goal it is constant, and the last of equals is taken."""
    route = [[0, 0], [1, 0], [2, 0], [3, 0], [3, 1]]
    assert kept_cells(route, (0, 0), (9, 0)) == (route[:4], 0, 30)
    # A diagonal step costs 14 and brings the goal 20 nearer.
    diagonal = [[0, 0], [1, 1], [2, 2]]
    assert kept_cells(diagonal, (0, 0), (5, 5)) == (diagonal, 0, 28)


def test_round_an_obstacle_the_end_is_kept_by_one_reading_and_the_part_before_the_detour_by_the_other():
    """f by hand: 60 along row 0, 80 after the step aside, 60 again once the way leads back towards the goal."""
    aside = [[0, 0], [1, 0], [1, 1], [2, 1], [3, 1]]
    assert kept_cells(aside, (0, 0), (6, 0)) == (aside[:2], 0, 10)
    assert kept_cells(aside, (0, 0), (6, 0), from_end=True) == (aside, 0, 40)
    # The last step leads away from the goal: from the end, f falls over it.
    beyond = [[0, 0], [1, 0], [2, 0], [2, 1]]
    assert kept_cells(beyond, (0, 0), (6, 0), from_end=True) == (beyond[:3], 0, 20)
