from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from quadlog.planning.rules import COSTS, HEURISTICS, TIES, USUAL, Rules
from quadlog.planning.search import bucket_search
from quadlog.planning.search.bucket_search import BucketSearch, make_search
from quadlog.planning.search.heap_search import HeapSearch


def test_stamps_start_over_before_they_overflow():
    search = BucketSearch()
    blocked = np.zeros((8, 8), dtype=bool)
    first = search.search(blocked, (0, 0), (7, 3))
    search._generation = bucket_search.MAX_GENERATION - 1
    for _ in range(3):
        again = search.search(blocked, (0, 0), (7, 3))
        assert (again.cost, again.expanded, again.generated) == (first.cost, first.expanded, first.generated)


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


@pytest.mark.parametrize("cutting", [False, True])
@pytest.mark.parametrize(("costs", "heuristic", "ties"), list(product(COSTS, HEURISTICS, TIES)))
def test_the_bucket_queue_only_where_it_can(costs, heuristic, ties, cutting):
    can = (costs, heuristic, ties) == ("integer", "octile", "larger_g")
    search = make_search(Rules(costs, heuristic, ties, cutting))
    assert isinstance(search, BucketSearch if can else HeapSearch)
