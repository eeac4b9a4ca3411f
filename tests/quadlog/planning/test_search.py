from __future__ import annotations

from itertools import product

import pytest

from quadlog.planning.bucket_search import BucketSearch
from quadlog.planning.heap_search import HeapSearch
from quadlog.planning.rules import COSTS, HEURISTICS, TIES, Rules
from quadlog.planning.search import make_search


@pytest.mark.parametrize("cutting", [False, True])
@pytest.mark.parametrize(("costs", "heuristic", "ties"), list(product(COSTS, HEURISTICS, TIES)))
def test_the_bucket_queue_only_where_it_can(costs, heuristic, ties, cutting):
    can = (costs, heuristic, ties) == ("integer", "octile", "larger_g")
    search = make_search(Rules(costs, heuristic, ties, cutting))
    assert isinstance(search, BucketSearch if can else HeapSearch)
