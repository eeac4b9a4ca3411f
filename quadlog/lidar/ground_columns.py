"""The ground along each column of beams, from the lidar outwards, and short pieces of a beam that stand out of it: a
box or a log, however gentle the slope up to it.

Constants were chosen on seed 100 of quadlog.simulation.synthetic.labelled_scans, and are never reported on that seed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.lidar.isolation_filter import Isolated
from quadlog.messages import Float32

Marks = NDArray[np.int8]

# Where ranges jump, how wide it may be, how high it must stand; unless it goes on as a ramp does.
_JUMP_M, _JUMP_PER_M, _PIECE_GAP = np.float32(0.10), np.float32(0.03), 3
_PIECE_WIDTH_M, _PIECE_RISE_M, _PIECE_RISE_PER_M = np.float32(2.5), np.float32(0.06), np.float32(0.02)
_RAMP_SLOPE, _RAMP_AGREES, _RAMP_STEP_M = np.float32(0.12), np.float32(0.12), np.float32(0.3)

NOTHING, OBSTACLE, POSSIBLE, PIECE = np.int8(0), np.int8(1), np.int8(2), np.int8(3)
_NONE, _TURN = np.float32(0), np.float32(2 * np.pi)
# Typed: a plain 0 would make numba compile everything twice.
_ZERO: int = np.int64(0)  # type: ignore[assignment]
# What the range does from one return to the next: to something farther, to something nearer, or nothing is near.
_JOINED, _RISES, _DROPS = np.int8(0), np.int8(1), np.int8(2)


@inner
def _drop_pieces(
    kind: Marks, seen: Isolated, range_m: Float32, row: int, off_m: Float32, gap_m: Float32, rise_m: Float32,
    ground: Marks,
) -> None:  # fmt: skip
    """No short piece of a beam is ground that stands out of it, with something farther, or nothing, at an end.

    kind, ground, range_m, off_m, gap_m, rise_m: (columns,) of the beam in `row`, the last three from the column's
    last ground. What is dropped is taken from ground and marked in kind.
    """
    columns = len(kind)
    column, edges, edge = np.empty(columns + 1, np.int32), np.empty(columns, np.int32), np.empty(columns, np.int8)
    n, ranges_m = _ZERO, np.empty(columns + 1, np.float32)
    for c in range(len(kind)):
        # Written unconditionally: a mispredicted branch takes longer.
        column[n], ranges_m[n] = c, range_m[c]
        n += kind[c] != NOTHING
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
            _drop(column, begin, size, n, kind, seen, row, gap_m, rise_m, ground)


@inner
def _drop(
    column: NDArray[np.int32], begin: int, size: int, n: int, kind: Marks, seen: Isolated, row: int, gap_m: Float32,
    rise_m: Float32, ground: Marks,
) -> None:  # fmt: skip
    """Mark a piece, unless it goes on as a ramp does: to the next beam's returns at about the same slope."""
    good, distance_m, z_m, ramps = seen.good, seen.distance_m, seen.z_m, 0
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
        ground[c], kind[c] = 0, PIECE


STEEPEST = np.float32(0.47)
"""25 degrees: a ramp of 20 and what the gait tilts."""
# Height off the line of the ground before it: certain ground, and possible ground behind an obstacle.
_NEAR_M, _NEAR_PER_M, _BEHIND_PER_M = np.float32(0.04), np.float32(0.02), np.float32(0.05)
_SLACK_M, _BACK_M = np.float32(0.03), np.float32(-0.05)
# A wall: steeper than _WALL_SLOPE up to a return of the next beams, and at least _WALL_RISE_M higher.
_WALL_SLOPE, _WALL_RISE_M, _WALL_BEAMS = np.float32(0.7), np.float32(0.05), 3
_WALL_FOOT_M = np.float32(0.012)
# Farther off, no return is at a wall's foot.
_WALL_FOOT_REACH_M = np.float32(0.3)
_VOTERS, _VOTER_M, _VOTER_PER_M = 4, np.float32(0.05), np.float32(0.02)


_YES, _NO, _AYES, _NO_BITS = np.int8(1), np.int8(0), np.int8(15), np.int8(4)
_ONE = np.float32(1)
# A step outwards, and one that says all about the slope.
_STEP_M, _SLOW_M = np.float32(0.05), np.float32(0.5)


class Walked(NamedTuple):
    """(rows, columns) int8 each: 1 where a cell is ground, and where one near the ground has a wall right above it."""

    ground: Marks
    wall: Marks


@kernel
def walk_columns(seen: Isolated, range_m: Float32, descending: NDArray[np.bool_], floor_m: float) -> Walked:
    """range_m: (rows * columns,). floor_m: height of the ground under the lidar, float32.

    descending: (rows,) whether the beam points below the lidar's own horizon: a column's first ground is seen by one
    that does, or not at all.
    """
    good, distance_m, z_m = seen.good, seen.distance_m, seen.z_m
    rows, columns = good.shape
    ground, wall = np.empty((rows, columns), np.int8), np.empty((rows, columns), np.int8)
    floats, marks = np.empty((6, columns), np.float32), np.empty((5, columns), np.int8)
    wide = np.empty(columns + 2 * _VOTERS, np.int8)
    # Of every column: where its last ground is, how steep the ground was there, and what lies between.
    last_m, last_z_m, slope = floats[0], floats[1], floats[2]
    gap_m, rise_m, off_m = floats[3], floats[4], floats[5]
    hidden, rises, walkable, votes, kind = marks[0], marks[1], marks[2], marks[3], marks[4]
    last_m[:], last_z_m[:], slope[:], hidden[:] = _NONE, floor_m, _NONE, _NO
    for row in range(rows):
        distance, z, here = distance_m[row], z_m[row], good[row]
        ground[row, :], wall[row, :], rises[:] = _NO, _NO, _NO
        _off_the_ground(distance, z, last_m, last_z_m, slope, gap_m, rise_m, off_m)
        for above in range(row + 1, min(row + 1 + _WALL_BEAMS, rows)):
            _mark_rises(good[above], distance_m[above], z_m[above], distance, z, rises)
        for c in range(columns):
            near = abs(off_m[c]) <= _NEAR_M + _NEAR_PER_M * gap_m[c]
            gentle = abs(rise_m[c]) <= STEEPEST * gap_m[c] + _SLACK_M
            behind = abs(off_m[c]) <= _NEAR_M + _BEHIND_PER_M * gap_m[c]
            walks = near | (gentle & ((hidden[c] == _NO) | behind))
            walkable[c] = here[c] if walks & (gap_m[c] > _BACK_M) else _NO
        if not descending[row]:
            for c in range(columns):
                walkable[c] = walkable[c] if last_m[c] > _NONE else _NO
        _mark_walls(here, rises, walkable, off_m, gap_m, wall[row])
        if _sort_out(here, walkable, wall[row], off_m, kind):
            for c in range(columns):
                wide[_VOTERS + c] = kind[c]
            for k in range(_VOTERS):
                # With some of the other end on either side, so that neighbours need no wrapping.
                wide[k], wide[_VOTERS + columns + k] = kind[columns - _VOTERS + k], kind[k]
            _vote(wide, kind, distance, wall[row], off_m, votes, ground[row])
            ranges = range_m[row * columns :]
            _drop_pieces(kind, seen, ranges, row, off_m, gap_m, rise_m, ground[row])
        _step_out(kind, ground[row], distance, z, hidden, last_m, last_z_m, slope)
    return Walked(ground, wall)


# The following have no branches, and few arrays each, so that they become vector instructions.
@inner
def _off_the_ground(
    distance_m: Float32, z_m: Float32, last_m: Float32, last_z_m: Float32, slope: Float32, gap_m: Float32,
    rise_m: Float32, off_m: Float32,
) -> None:  # fmt: skip
    for c in range(len(gap_m)):
        gap_m[c] = distance_m[c] - last_m[c]
    for c in range(len(gap_m)):
        rise_m[c] = z_m[c] - last_z_m[c]
    for c in range(len(gap_m)):
        off_m[c] = rise_m[c] - slope[c] * gap_m[c]


@inner
def _mark_rises(
    there: Marks, distance_above_m: Float32, z_above_m: Float32, distance_m: Float32, z_m: Float32, rises: Marks
) -> None:
    for c in range(len(rises)):
        rise = z_above_m[c] - z_m[c]
        steep = rise > _WALL_SLOPE * (distance_above_m[c] - distance_m[c])
        rises[c] |= there[c] if steep & (rise > _WALL_RISE_M) else _NO


@inner
def _mark_walls(here: Marks, rises: Marks, walkable: Marks, off_m: Float32, gap_m: Float32, wall: Marks) -> None:
    for c in range(len(wall)):
        near = abs(off_m[c]) < _WALL_FOOT_REACH_M + _NEAR_PER_M * gap_m[c]
        above = (walkable[c] != _NO) & (off_m[c] > _WALL_FOOT_M)
        wall[c] = here[c] & rises[c] if near | above else _NO


@inner
def _sort_out(here: Marks, walkable: Marks, wall: Marks, off_m: Float32, kind: Marks) -> bool:
    for c in range(len(kind)):
        at_foot = (wall[c] == _NO) | (off_m[c] <= _WALL_FOOT_M)
        kind[c] = here[c] + (walkable[c] if at_foot else _NO)
    any_possible = _NO
    for c in range(len(kind)):
        any_possible |= kind[c] & POSSIBLE
    return any_possible != _NO


@inner
def _step_out(
    kind: Marks, ground: Marks, distance_m: Float32, z_m: Float32, hidden: Marks, last_m: Float32,
    last_z_m: Float32, slope: Float32,
) -> None:  # fmt: skip
    for c in range(len(kind)):
        hidden[c] = hidden[c] if kind[c] == NOTHING else (_NO if ground[c] != _NO else _YES)
    for c in range(len(kind)):
        gap = distance_m[c] - last_m[c]
        steep = (z_m[c] - last_z_m[c]) / gap
        steep = STEEPEST if steep > STEEPEST else (-STEEPEST if steep < -STEEPEST else steep)
        weight = gap + gap if gap < _SLOW_M else _ONE
        counts = (ground[c] != _NO) & (gap > _STEP_M)
        slope[c] = slope[c] + (steep - slope[c]) * weight if counts else slope[c]
    for c in range(len(kind)):
        counts = (ground[c] != _NO) & (distance_m[c] - last_m[c] > _STEP_M)
        last_z_m[c] = z_m[c] if counts else last_z_m[c]
    for c in range(len(kind)):
        counts = (ground[c] != _NO) & (distance_m[c] - last_m[c] > _STEP_M)
        last_m[c] = distance_m[c] if counts else last_m[c]


@inner
def _vote(
    wide: Marks, kind: Marks, distance_m: Float32, wall: Marks, off_m: Float32, votes: Marks, ground: Marks
) -> None:
    """More than half of the returns beside a cell, at about its distance, must be possible ground."""
    columns = len(kind)
    for c in range(columns):
        votes[c] = _NO
    for k in range(2 * _VOTERS + 1):
        for c in range(columns):
            # Both counts in one: the ayes in the lower four bits, the noes above them.
            votes[c] += (wide[c + k] >> _YES) + ((wide[c + k] & _YES) << _NO_BITS)
    for c in range(columns):
        ayes = votes[c] & _AYES
        if ayes == 0 or kind[c] == NOTHING or (wall[c] != _NO and off_m[c] > _WALL_FOOT_M):
            continue
        if votes[c] == ayes:
            # All agree, at any distance.
            ground[c] = _YES
            continue
        near_m = _VOTER_M + _VOTER_PER_M * distance_m[c]
        voters, agreeing = 0, 0
        for k in range(-_VOTERS, _VOTERS + 1):
            other = c + k
            if other < 0:
                other += columns
            elif other >= columns:
                other -= columns
            if kind[other] != NOTHING and abs(distance_m[other] - distance_m[c]) < near_m:
                voters += 1
                agreeing += kind[other] == POSSIBLE
        ground[c] = 2 * agreeing > voters
