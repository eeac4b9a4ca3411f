from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from quadlog.planning.rules import USUAL
from quadlog.planning.search import bucket_search
from quadlog.planning.search.bucket_search import BucketSearch
from quadlog.planning.search.heap_search import HeapSearch


@pytest.mark.parametrize("count", [0, 1, 2, 7, 300])
@pytest.mark.parametrize("highest", [2, 200, 200_000])
def test_a_list_comes_to_the_stack_by_g_and_equals_as_they_are_listed(count, highest):
    """Against numpy's stable sort; the newest link is first in the list, and the list is empty then."""
    rng = np.random.default_rng(0)
    records = np.zeros((1000, 4), dtype=np.int32)
    records[:, bucket_search.G] = 2 * rng.integers(0, highest, 1000)
    heads = np.full(bucket_search.RING, -1, dtype=np.int64)
    cells = rng.permutation(1000)[:count]
    for cell in cells:
        bucket_search._link(heads, 5, cell, records)
    newest_first = cells[::-1]
    wanted = newest_first[np.argsort(records[newest_first, bucket_search.G], kind="stable")]
    stack, listed, keys = (np.empty(1000, dtype=dtype) for dtype in (np.int32, np.int32, np.int64))
    assert bucket_search._take_list(heads, 5, records, stack, listed, keys) == count
    np.testing.assert_array_equal(stack[:count], wanted)
    assert (heads == -1).all()


@pytest.mark.parametrize("taken", list(permutations([4, 7, 2, 9], 2)))
def test_cells_are_taken_out_of_their_list_wherever_they_are(taken):
    records = np.zeros((10, 4), dtype=np.int32)
    heads = np.full(bucket_search.RING, -1, dtype=np.int64)
    cells = [4, 7, 2, 9]
    for cell in cells:
        bucket_search._link(heads, 3, cell, records)
    for cell in taken:
        bucket_search._unlink(heads, 3, cell, records)
        cells.remove(cell)
    stack, listed, keys = (np.empty(10, dtype=dtype) for dtype in (np.int32, np.int32, np.int64))
    assert bucket_search._take_list(heads, 3, records, stack, listed, keys) == 2
    assert stack[:2].tolist() == cells[::-1]


def test_stamps_start_over_before_they_overflow():
    search = BucketSearch()
    blocked = np.zeros((8, 8), dtype=bool)
    first = search.search(blocked, (0, 0), (7, 3))
    search._generation = bucket_search.MAX_GENERATION - 1
    for _ in range(3):
        again = search.search(blocked, (0, 0), (7, 3))
        assert (again.cost, again.expanded, again.generated) == (first.cost, first.expanded, first.generated)


def test_maps_of_different_sizes_in_turn(grids, cells_of):
    """What one map left in the arrays must not be taken for the next one's."""
    search = BucketSearch()
    for seed in range(3):
        for blocked in grids.values():
            start, goal = cells_of(blocked, 2, seed)
            ours, fresh = search.search(blocked, start, goal), BucketSearch().search(blocked, start, goal)
            assert (ours.cost, ours.expanded, ours.touched) == (fresh.cost, fresh.expanded, fresh.touched)
            np.testing.assert_array_equal(ours.cells, fresh.cells)


@pytest.mark.parametrize("seed", range(20))
def test_expands_what_the_heap_does(seed):
    """Which of several cells with equal f and g comes first is free, so counts may differ by a few.

    Ties to the smaller g would differ by far more.
    """
    blocked = np.random.default_rng(seed).random((60, 60)) < 0.25
    blocked[0, 0] = blocked[-1, -1] = False
    ours, heaps = (each.search(blocked, (0, 0), (59, 59)) for each in (BucketSearch(), HeapSearch(USUAL)))
    assert ours.cost == heaps.cost
    if ours.found:
        assert ours.expanded == pytest.approx(heaps.expanded, rel=0.1, abs=8)
    else:
        assert ours.expanded == heaps.expanded == ours.generated
