"""Short pieces of a beam that stand out of the ground: a box or a log, however gentle the slope up to it.

Constants were chosen on seed 100 of quadlog.simulation.labelled_scans, and are never reported on that seed.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.messages import Float32

Marks = NDArray[np.int8]

# Where ranges jump, how wide it may be, how high it must stand; unless it goes on as a ramp does.
_JUMP_M, _JUMP_PER_M, _PIECE_GAP = np.float32(0.10), np.float32(0.03), 3
_PIECE_WIDTH_M, _PIECE_RISE_M, _PIECE_RISE_PER_M = np.float32(2.5), np.float32(0.06), np.float32(0.02)
_RAMP_SLOPE, _RAMP_AGREES, _RAMP_STEP_M = np.float32(0.12), np.float32(0.12), np.float32(0.3)

_NOTHING, _PIECE, _NONE, _TURN = np.int8(0), np.int8(3), np.float32(0), np.float32(2 * np.pi)
# A number of a type, which a plain 0 is not: with that, everything would be compiled twice.
_ZERO: int = np.int64(0)  # type: ignore[assignment]
# What the range does from one return to the next: to something farther, to something nearer, or nothing is near.
_JOINED, _RISES, _DROPS = np.int32(0), np.int32(1), np.int32(2)


@njit(cache=True, error_model="numpy")
def drop_pieces(
    kind: Marks,
    good: Marks,
    distance_m: Float32,
    z_m: Float32,
    range_m: Float32,
    row: int,
    off_m: Float32,
    gap_m: Float32,
    rise_m: Float32,
    seen: NDArray[np.int32],
    ground: Marks,
) -> None:
    """No short piece of a beam is ground that stands out of it, with something farther, or nothing, at an end.

    kind, ground, range_m, off_m, gap_m, rise_m: (columns,) of the beam in `row`, the last three from the column's
    last ground; good, distance_m, z_m: (rows, columns). seen: (2, columns), room to work in. What is dropped is
    taken from ground and marked in kind.
    """
    column, edge = seen[0], seen[1]
    n = _ZERO
    for c in range(len(kind)):
        if kind[c] != _NOTHING:
            column[n] = c
            n += 1
    first = _mark_edges(column, n, range_m, edge)
    if first < 0:
        return
    # Pieces run from behind one edge to the next one, once round.
    before, begin, done = edge[first], first + 1, _ZERO
    while done < n:
        begin = begin if begin < n else begin - n
        size, off, gap, wide, after = _ZERO, _NONE, _NONE, _NONE, _JOINED
        while after == _JOINED:
            j = begin + size if begin + size < n else begin + size - n
            c, after, size = column[j], edge[j], size + 1
            off, gap, wide = off + off_m[c], gap + gap_m[c], wide + range_m[c]
        free = (before & _DROPS) != 0 or (after & _RISES) != 0
        stands = off > size * _PIECE_RISE_M + _PIECE_RISE_PER_M * gap
        if free and stands and wide * _TURN < _PIECE_WIDTH_M * len(kind):
            _drop(column, begin, size, n, kind, good, distance_m, z_m, row, gap_m, rise_m, ground)
        before, begin, done = after, begin + size, done + size


@njit(cache=True, error_model="numpy")
def _mark_edges(column: NDArray[np.int32], n: int, range_m: Float32, edge: NDArray[np.int32]) -> int:
    """What lies between each of n returns and the next one round the beam; the first that are not joined, or -1."""
    first = -1
    for j in range(n):
        other = j + 1 if j + 1 < n else 0
        apart = column[other] - column[j] + (len(range_m) if other <= j else 0)
        here, there = range_m[column[j]], range_m[column[other]]
        edge[j] = _JOINED
        if apart > _PIECE_GAP:
            edge[j] = _RISES | _DROPS
        elif abs(there - here) > _JUMP_M + _JUMP_PER_M * min(here, there):
            edge[j] = _RISES if there > here else _DROPS
        if first < 0 and edge[j] != _JOINED:
            first = j
    return first


@njit(cache=True, error_model="numpy")
def _drop(
    column: NDArray[np.int32],
    begin: int,
    size: int,
    n: int,
    kind: Marks,
    good: Marks,
    distance_m: Float32,
    z_m: Float32,
    row: int,
    gap_m: Float32,
    rise_m: Float32,
    ground: Marks,
) -> None:
    """Mark a piece, unless it goes on as a ramp does: to the next beam's returns at about the same slope."""
    ramps = 0
    for j in range(begin, begin + size):
        c = column[j if j < n else j - n]
        if row + 1 == len(good) or good[row + 1, c] == 0:
            continue
        gap, rise, on = gap_m[c], rise_m[c], distance_m[row + 1, c] - distance_m[row, c]
        if gap > 0 and rise > _RAMP_SLOPE * gap and 0 < on < 3 * gap + _RAMP_STEP_M:
            ramps += abs((z_m[row + 1, c] - z_m[row, c]) / on - rise / gap) < _RAMP_AGREES
    if 2 * ramps >= size:
        return
    for j in range(begin, begin + size):
        c = column[j if j < n else j - n]
        ground[c], kind[c] = 0, _PIECE
