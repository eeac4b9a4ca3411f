"""A binary heap for OPEN, compiled: each cell is in it once and knows its place, so that a better way moves it up.

Ordered by two whole numbers, f and a tie. place_of[cell] is where a cell stands, counted from 1.
"""

from __future__ import annotations

from quadlog.compiled import inlined


@inlined
def _is_less(f, tie, than_f, than_tie):  # type: ignore[no-untyped-def]
    return f < than_f or (f == than_f and tie < than_tie)


@inlined
def _put(heap, keys, place_of, place, cell, f, tie):  # type: ignore[no-untyped-def]
    heap[place], keys[place, 0], keys[place, 1] = cell, f, tie
    place_of[cell] = place + 1


@inlined
def rise(heap, keys, place_of, place, cell, f, tie):  # type: ignore[no-untyped-def]
    """Puts a cell at a free place, or nearer to the top where its key belongs."""
    while place > 0:
        above = (place - 1) >> 1
        if not _is_less(f, tie, keys[above, 0], keys[above, 1]):
            break
        _put(heap, keys, place_of, place, heap[above], keys[above, 0], keys[above, 1])
        place = above
    _put(heap, keys, place_of, place, cell, f, tie)


@inlined
def take(heap, keys, place_of, size):  # type: ignore[no-untyped-def]
    """The first of `size` cells, taken out; the last one sinks from its place to where its key belongs."""
    first, last, place = heap[0], size - 1, 0
    cell, f, tie = heap[last], keys[last, 0], keys[last, 1]
    while True:
        child = 2 * place + 1
        if child + 1 < last and _is_less(keys[child + 1, 0], keys[child + 1, 1], keys[child, 0], keys[child, 1]):
            child += 1
        if child >= last or not _is_less(keys[child, 0], keys[child, 1], f, tie):
            break
        _put(heap, keys, place_of, place, heap[child], keys[child, 0], keys[child, 1])
        place = child
    _put(heap, keys, place_of, place, cell, f, tie)
    return first
