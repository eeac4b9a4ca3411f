from __future__ import annotations

from itertools import product

import pytest

from quadlog.planning.rules import COSTS, HEURISTICS, TIES, Rules
from quadlog.planning.search.bucket_search import BucketSearch, make_search
from quadlog.planning.search.heap_search import HeapSearch


@pytest.mark.parametrize("cutting", [False, True])
@pytest.mark.parametrize(("costs", "heuristic", "ties"), list(product(COSTS, HEURISTICS, TIES)))
def test_the_bucket_queue_only_where_it_can(costs, heuristic, ties, cutting):
    can = (costs, heuristic, ties) == ("integer", "octile", "larger_g")
    search = make_search(Rules(costs, heuristic, ties, cutting))
    assert isinstance(search, BucketSearch if can else HeapSearch)
