from __future__ import annotations

import heapq

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.planning.search.heap_search import rise, take

CELLS = 40


class Heap:
    """The compiled functions on arrays of their own, as the searches use them."""

    def __init__(self):
        self.heap, self.place_of = np.empty(CELLS, dtype=np.int32), np.zeros(CELLS, dtype=np.int32)
        self.keys = np.empty((CELLS, 2), dtype=np.int64)
        self.size = 0

    def put(self, cell, f, tie):
        place = self.place_of[cell]
        if place == 0:
            self.size += 1
            place = self.size
        rise(self.heap, self.keys, self.place_of, place - 1, cell, f, tie)

    def take(self):
        key = tuple(self.keys[0].tolist())
        cell = take(self.heap, self.keys, self.place_of, self.size)
        self.size -= 1
        self.place_of[cell] = 0
        return cell, key


# Few values of f and tie, so that there are equals; None takes the first one out.
operations = st.lists(
    st.one_of(st.none(), st.tuples(st.integers(0, CELLS - 1), st.integers(-3, 6), st.integers(-4, 4))), max_size=150
)


@settings(max_examples=300, deadline=None)
@given(operations)
def test_against_heapq(steps):
    """Cells come and go, and some get a better key: always the least comes out, and each cell knows its place."""
    ours, keys, listed = Heap(), {}, []
    for step in [*steps, *[None] * CELLS]:
        if step is not None:
            cell, *key = step
            if tuple(key) < keys.get(cell, (99, 0)):
                keys[cell] = tuple(key)
                heapq.heappush(listed, (tuple(key), cell))
                ours.put(cell, *key)
        elif keys:
            while keys.get(listed[0][1]) != listed[0][0]:
                heapq.heappop(listed)
            cell, key = ours.take()
            assert key == listed[0][0] == keys.pop(cell)
        assert ours.size == len(keys)
        for place, cell in enumerate(ours.heap[: ours.size].tolist()):
            assert ours.place_of[cell] == place + 1
            assert tuple(ours.keys[place].tolist()) == keys[cell]
    assert not ours.place_of.any()


def test_keys_as_large_as_exact_costs():
    heap, largest = Heap(), 2**62
    for cell, f in enumerate([largest, -largest, largest - 1, 0]):
        heap.put(cell, f, -largest)
    assert [heap.take()[0] for _ in range(4)] == [1, 3, 2, 0]
