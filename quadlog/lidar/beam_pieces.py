"""Short pieces of a beam that stand out of the ground: a box or a log, however gentle the slope up to it.

Constants were chosen on seed 100 of quadlog.simulation.labelled_scans, and are never reported on that seed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner
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
_JOINED, _RISES, _DROPS = np.int8(0), np.int8(1), np.int8(2)


@inner
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
    column: NDArray[np.int32],
    edges: NDArray[np.int32],
    ranges_m: Float32,
    edge: Marks,
    ground: Marks,
) -> None:
    """No short piece of a beam is ground that stands out of it, with something farther, or nothing, at an end.

    kind, ground, range_m, off_m, gap_m, rise_m: (columns,) of the beam in `row`, the last three from the column's
    last ground; good, distance_m, z_m: (rows, columns). column, edges, ranges_m, edge: (columns + 1,), room to work
    in. What is dropped is taken from ground and marked in kind.
    """
    n = _ZERO
    for c in range(len(kind)):
        # Written whatever they are: a branch that is often guessed wrongly takes longer.
        column[n], ranges_m[n] = c, range_m[c]
        n += kind[c] != _NOTHING
    if n == 0:
        return
    column[n], ranges_m[n] = column[0] + len(kind), ranges_m[0]
    for j in range(n):
        here, there = ranges_m[j], ranges_m[j + 1]
        jump_m = _JUMP_M + _JUMP_PER_M * min(here, there)
        change = _RISES if there - here > jump_m else (_DROPS if here - there > jump_m else _JOINED)
        edge[j] = _RISES | _DROPS if column[j + 1] - column[j] > _PIECE_GAP else change
    n_edges = _ZERO
    for j in range(n):
        edges[n_edges] = j
        n_edges += edge[j] != _JOINED
    most_wide = _PIECE_WIDTH_M * np.float32(len(kind)) / _TURN
    # Pieces run from behind one edge to the next one, once round.
    for i in range(n_edges):
        first = edges[i]
        last = edges[i + 1] if i + 1 < n_edges else edges[0] + n
        if (edge[first] & _DROPS) == 0 and (edge[last if last < n else last - n] & _RISES) == 0:
            continue
        off, gap, wide = _NONE, _NONE, _NONE
        for k in range(first + 1, last + 1):
            j = k if k < n else k - n
            c = column[j]
            off, gap, wide = off + off_m[c], gap + gap_m[c], wide + ranges_m[j]
            if wide >= most_wide:
                break
        size = np.int64(last - first)
        if wide < most_wide and off > size * _PIECE_RISE_M + _PIECE_RISE_PER_M * gap:
            begin = np.int64(first + 1 if first + 1 < n else first + 1 - n)
            _drop(column, begin, size, n, kind, good, distance_m, z_m, row, gap_m, rise_m, ground)


@inner
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
