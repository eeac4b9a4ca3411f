from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadlog.planning import search_core
from quadlog.planning.astar import AStar
from quadlog.planning.search_core import GridSearch

PLANNERS = {rule: AStar(rule) for rule in (False, True)}


@st.composite
def queries(draw):
    shape = draw(st.tuples(st.integers(1, 24), st.integers(1, 24)))
    if draw(st.booleans()):
        blocked = draw(arrays(bool, shape, fill=st.just(False)))
    else:
        density = draw(st.sampled_from([0.0, 0.1, 0.25, 0.4, 0.6]))
        blocked = np.random.default_rng(draw(st.integers(0, 2**32 - 1))).random(shape) < density
    cell = st.tuples(st.integers(0, shape[1] - 1), st.integers(0, shape[0] - 1))
    return blocked, draw(cell), draw(cell), draw(st.booleans())


@settings(max_examples=400, deadline=None)
@given(queries())
def test_cost_equals_dijkstra_and_path_is_legal(costs_from, assert_legal, query):
    blocked, start, goal, corner_cutting = query
    plan = PLANNERS[corner_cutting].plan(blocked, start, goal)
    if blocked[start[1], start[0]] or blocked[goal[1], goal[0]]:
        assert not plan.found
        assert plan.expanded == 0
        return
    best = costs_from(blocked, start, corner_cutting)[goal[1], goal[0]]
    assert plan.found == np.isfinite(best)
    if plan.found:
        assert plan.cost == best
        assert_legal(plan, blocked, start, goal, corner_cutting)
        assert len(plan.cells) <= plan.expanded <= plan.generated


def structured_grids():
    stripes = np.zeros((97, 83), dtype=bool)
    for i, row in enumerate(range(4, 97, 8)):
        stripes[row] = True
        stripes[row, 1 if i % 2 else -2] = False
    rooms = np.zeros((120, 160), dtype=bool)
    rooms[::20], rooms[:, ::20] = True, True
    rooms[10::20, ::20], rooms[::20, 10::20] = False, False
    random = np.random.default_rng(3).random((150, 150)) < 0.35
    return {"stripes": stripes, "rooms": rooms, "open": np.zeros((130, 70), dtype=bool), "random": random}


@pytest.mark.parametrize("corner_cutting", [False, True])
@pytest.mark.parametrize("name", ["stripes", "rooms", "open", "random"])
def test_large_structured_grids(costs_from, assert_legal, name, corner_cutting):
    blocked = structured_grids()[name]
    planner = PLANNERS[corner_cutting]
    rows, cols = np.nonzero(~blocked)
    rng = np.random.default_rng(7)
    start = int(cols[len(cols) // 3]), int(rows[len(rows) // 3])
    best = costs_from(blocked, start, corner_cutting)
    for i in rng.integers(0, len(rows), 60):
        goal = int(cols[i]), int(rows[i])
        plan = planner.plan(blocked, start, goal)
        assert plan.found == np.isfinite(best[goal[1], goal[0]])
        if plan.found:
            assert plan.cost == best[goal[1], goal[0]]
            assert_legal(plan, blocked, start, goal, corner_cutting)


def reference_counts(blocked, start, goal):
    """Expanded and generated of a plain heap A*, ties to the larger g, in Python."""
    import heapq

    rows, cols = blocked.shape

    def h(col, row):
        across, along = abs(goal[0] - col), abs(goal[1] - row)
        return 10 * max(across, along) + 4 * min(across, along)

    g, closed, heap = {start: 0}, set(), [(h(*start), 0, start)]
    while heap:
        _, minus_g, at = heapq.heappop(heap)
        if at in closed or -minus_g != g[at]:
            continue
        closed.add(at)
        if at == goal:
            break
        for dcol in (-1, 0, 1):
            for drow in (-1, 0, 1):
                col, row = at[0] + dcol, at[1] + drow
                if (dcol, drow) == (0, 0) or not (0 <= col < cols and 0 <= row < rows) or blocked[row, col]:
                    continue
                if dcol and drow and (blocked[at[1], col] or blocked[row, at[0]]):
                    continue
                new = g[at] + (14 if dcol and drow else 10)
                if new < g.get((col, row), 10**9):
                    g[col, row] = new
                    heapq.heappush(heap, (new + h(col, row), -new, (col, row)))
    return len(closed), g, closed


@pytest.mark.parametrize("seed", range(20))
def test_expands_only_what_a_larger_g_tie_break_may(seed):
    """Cells with f below the optimum must be closed; of those with f equal to it, the larger g go first.

    Which of several cells with equal f and g comes first is free, so counts may differ by a few
    from a heap's; ties to the smaller g would differ by far more.
    """
    blocked = np.random.default_rng(seed).random((60, 60)) < 0.25
    blocked[0, 0] = blocked[-1, -1] = False
    plan = AStar().plan(blocked, (0, 0), (59, 59))
    expanded, _, closed = reference_counts(blocked, (0, 0), (59, 59))
    assert plan.found == ((59, 59) in closed)
    if plan.found:
        assert plan.expanded == pytest.approx(expanded, rel=0.1, abs=8)
    else:
        assert plan.expanded == expanded == plan.generated


def test_open_ground_expands_the_path_alone():
    blocked = np.zeros((100, 100), dtype=bool)
    plan = AStar().plan(blocked, (3, 5), (90, 60))
    assert plan.expanded == len(plan.cells) == 88
    assert plan.cost == 55 * 14 + 32 * 10


def test_counts_of_a_single_step():
    plan = AStar().plan(np.zeros((3, 3), dtype=bool), (1, 1), (2, 1))
    assert (plan.expanded, plan.generated, plan.touched) == (2, 9, 8)


@pytest.mark.parametrize("count", [0, 1, 2, 7, 300])
@pytest.mark.parametrize("highest", [2, 200, 200_000])
def test_a_list_comes_to_the_stack_by_g_and_equals_as_they_are_listed(count, highest):
    """Against numpy's stable sort; the newest link is first in the list, and the list is empty then."""
    rng = np.random.default_rng(0)
    records = np.zeros((1000, 4), dtype=np.int32)
    records[:, search_core.G] = 2 * rng.integers(0, highest, 1000)
    heads = np.full(search_core.RING, -1, dtype=np.int64)
    cells = rng.permutation(1000)[:count]
    for cell in cells:
        search_core._link(heads, 5, cell, records)
    newest_first = cells[::-1]
    wanted = newest_first[np.argsort(records[newest_first, search_core.G], kind="stable")]
    stack, listed, keys = (np.empty(1000, dtype=dtype) for dtype in (np.int32, np.int32, np.int64))
    assert search_core._take_list(heads, 5, records, stack, listed, keys) == count
    np.testing.assert_array_equal(stack[:count], wanted)
    assert (heads == -1).all()


@pytest.mark.parametrize("taken", list(permutations([4, 7, 2, 9], 2)))
def test_cells_are_taken_out_of_their_list_wherever_they_are(taken):
    records = np.zeros((10, 4), dtype=np.int32)
    heads = np.full(search_core.RING, -1, dtype=np.int64)
    cells = [4, 7, 2, 9]
    for cell in cells:
        search_core._link(heads, 3, cell, records)
    for cell in taken:
        search_core._unlink(heads, 3, cell, records)
        cells.remove(cell)
    stack, listed, keys = (np.empty(10, dtype=dtype) for dtype in (np.int32, np.int32, np.int64))
    assert search_core._take_list(heads, 3, records, stack, listed, keys) == 2
    assert stack[:2].tolist() == cells[::-1]


@pytest.mark.parametrize(("dcol", "drow"), [(0, 0), (3, 0), (0, -3), (2, 5), (-5, 2), (-4, -4)])
def test_octile_is_diagonal_steps_then_straight_ones(dcol, drow):
    across, along = abs(dcol), abs(drow)
    assert search_core.octile(dcol, drow) == 14 * min(across, along) + 10 * abs(across - along)


def test_stamps_start_over_before_they_overflow():
    search = GridSearch()
    blocked = np.zeros((8, 8), dtype=bool)
    first = search.search(blocked, (0, 0), (7, 3))
    search._generation = search_core.MAX_GENERATION - 1
    for _ in range(3):
        again = search.search(blocked, (0, 0), (7, 3))
        assert (again.cost, again.expanded, again.generated) == (first.cost, first.expanded, first.generated)


@pytest.mark.parametrize(("start", "goal"), [((-1, 0), (2, 2)), ((0, 0), (5, 2)), ((0, 0), (2, 4)), ((1, 1), (2, 2))])
def test_start_or_goal_outside_or_blocked_is_a_result(start, goal):
    blocked = np.zeros((4, 5), dtype=bool)
    blocked[1, 1] = True
    plan = AStar().plan(blocked, start, goal)
    assert not plan.found
    assert plan.cells.shape == (0, 2)


def test_one_cell_and_no_free_cell():
    assert AStar().plan(np.zeros((1, 1), dtype=bool), (0, 0), (0, 0)).cells.tolist() == [[0, 0]]
    assert not AStar().plan(np.ones((1, 1), dtype=bool), (0, 0), (0, 0)).found
