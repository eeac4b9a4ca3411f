"""The ground by walking outwards along the columns of a range image, from beam to beam.

A return goes on from the last ground when the slope between them can be
walked and nothing rises steeply right above it. Neighbours then agree: the
majority of a beam's neighbouring returns decides, ground spreads along a beam
as long as its range and height are continuous, and a short piece of a beam
that stands higher and nearer than what is beside it is an obstacle, however
gentle its slope from the beam below.

Constants were chosen on seed 100 of quadlog.simulation.labelled_scans, and are never reported on that seed.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.lidar.beam_pieces import drop_pieces
from quadlog.messages import Float32

Marks = NDArray[np.int8]

STEEPEST = np.float32(0.47)
"""25 degrees: a ramp of 20 and what the gait tilts."""
# Height off the line of the ground before it: sure ground, and what is still possible behind an obstacle.
_NEAR_M, _NEAR_PER_M, _BEHIND_PER_M = np.float32(0.04), np.float32(0.02), np.float32(0.05)
_SLACK_M, _BACK_M = np.float32(0.03), np.float32(-0.05)
# A wall: steeper than this up to a return of the next beams, and at least so much higher.
_WALL_SLOPE, _WALL_RISE_M, _WALL_BEAMS = np.float32(0.7), np.float32(0.05), 3
_WALL_FOOT_M = np.float32(0.012)
# Farther off, no return is at a wall's foot.
_WALL_FOOT_REACH_M = np.float32(0.3)
_VOTERS, _VOTER_M, _VOTER_PER_M = 4, np.float32(0.05), np.float32(0.02)
_SPREAD_M, _SPREAD_PER_M, _SPREAD_RISE_M = np.float32(0.05), np.float32(0.01), np.float32(0.03)


NOTHING, OBSTACLE, POSSIBLE, PIECE = np.int8(0), np.int8(1), np.int8(2), np.int8(3)
_YES, _NO, _AYES, _NO_BITS = np.int8(1), np.int8(0), np.int8(15), np.int8(4)
_NONE, _ONE = np.float32(0), np.float32(1)
# A step outwards, and one that says all about the slope.
_STEP_M, _SLOW_M = np.float32(0.05), np.float32(0.5)


def walk_columns(
    good: NDArray[np.bool_],
    distance_m: Float32,
    z_m: Float32,
    range_m: Float32,
    descending: NDArray[np.bool_],
    floor_m: float,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which cells (rows, columns) are ground, and which near it have a wall right above them.

    good, distance_m, z_m: as `isolate` returns them; range_m: (rows, columns);
    floor_m: height of the ground under the lidar. A column's first ground is
    seen by a beam that descends from the lidar, or not at all.
    """
    ground, wall = np.zeros(good.shape, np.int8), np.zeros(good.shape, np.int8)
    columns = good.shape[1]
    floats, marks = np.zeros((6, columns), np.float32), np.zeros((5, columns + 2 * _VOTERS), np.int8)
    seen = np.zeros((2, columns), np.int32)
    floats[1] = floor_m
    _walk(good.view(np.int8), distance_m, z_m, range_m, descending, floats, marks, seen, ground, wall)
    return ground.view(np.bool_), wall.view(np.bool_)


@njit(cache=True, error_model="numpy")
def _walk(
    good: Marks,
    distance_m: Float32,
    z_m: Float32,
    range_m: Float32,
    descending: NDArray[np.bool_],
    floats: Float32,
    marks: Marks,
    seen: NDArray[np.int32],
    ground: Marks,
    wall: Marks,
) -> None:
    # Of every column: where its last ground is, how steep the ground was there, and what lies between.
    last_m, last_z_m, slope = floats[0], floats[1], floats[2]
    gap_m, rise_m, off_m = floats[3], floats[4], floats[5]
    rows, columns = good.shape
    hidden, rises, walkable, votes = marks[0, :columns], marks[1, :columns], marks[2, :columns], marks[3, :columns]
    # With some of the other end on either side, so that neighbours need no wrapping.
    wide = marks[4]
    kind = wide[_VOTERS : _VOTERS + columns]
    for row in range(rows):
        distance, z, here = distance_m[row], z_m[row], good[row]
        _off_the_ground(distance, z, last_m, last_z_m, slope, gap_m, rise_m, off_m)
        for c in range(columns):
            rises[c] = _NO
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
            for k in range(_VOTERS):
                wide[k], wide[_VOTERS + columns + k] = kind[columns - _VOTERS + k], kind[k]
            _vote(wide, kind, distance, wall[row], off_m, votes, ground[row])
            drop_pieces(kind, good, distance_m, z_m, range_m[row], row, off_m, gap_m, rise_m, seen, ground[row])
            _spread(kind, distance, z, wall[row], ground[row])
        _step_out(kind, ground[row], distance, z, hidden, last_m, last_z_m, slope)


# The following have no branches, and few arrays each, so that they become vector instructions.
@njit(cache=True, error_model="numpy")
def _off_the_ground(
    distance_m: Float32,
    z_m: Float32,
    last_m: Float32,
    last_z_m: Float32,
    slope: Float32,
    gap_m: Float32,
    rise_m: Float32,
    off_m: Float32,
) -> None:
    for c in range(len(gap_m)):
        gap_m[c] = distance_m[c] - last_m[c]
    for c in range(len(gap_m)):
        rise_m[c] = z_m[c] - last_z_m[c]
    for c in range(len(gap_m)):
        off_m[c] = rise_m[c] - slope[c] * gap_m[c]


@njit(cache=True, error_model="numpy")
def _mark_rises(
    there: Marks, distance_above_m: Float32, z_above_m: Float32, distance_m: Float32, z_m: Float32, rises: Marks
) -> None:
    for c in range(len(rises)):
        rise = z_above_m[c] - z_m[c]
        steep = rise > _WALL_SLOPE * (distance_above_m[c] - distance_m[c])
        rises[c] |= there[c] if steep & (rise > _WALL_RISE_M) else _NO


@njit(cache=True, error_model="numpy")
def _mark_walls(here: Marks, rises: Marks, walkable: Marks, off_m: Float32, gap_m: Float32, wall: Marks) -> None:
    for c in range(len(wall)):
        near = abs(off_m[c]) < _WALL_FOOT_REACH_M + _NEAR_PER_M * gap_m[c]
        above = (walkable[c] != _NO) & (off_m[c] > _WALL_FOOT_M)
        wall[c] = here[c] & rises[c] if near | above else _NO


@njit(cache=True, error_model="numpy")
def _sort_out(here: Marks, walkable: Marks, wall: Marks, off_m: Float32, kind: Marks) -> bool:
    for c in range(len(kind)):
        at_foot = (wall[c] == _NO) | (off_m[c] <= _WALL_FOOT_M)
        kind[c] = here[c] + (walkable[c] if at_foot else _NO)
    any_possible = _NO
    for c in range(len(kind)):
        any_possible |= kind[c] & POSSIBLE
    return any_possible != _NO


@njit(cache=True, error_model="numpy")
def _step_out(
    kind: Marks,
    ground: Marks,
    distance_m: Float32,
    z_m: Float32,
    hidden: Marks,
    last_m: Float32,
    last_z_m: Float32,
    slope: Float32,
) -> None:
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


@njit(cache=True, error_model="numpy")
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
            # All agree, at whatever distance.
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


@njit(cache=True, error_model="numpy")
def _spread(kind: Marks, distance_m: Float32, z_m: Float32, wall: Marks, ground: Marks) -> None:
    """Along the beam, both ways round, over what the columns alone could not tell, such as a ramp behind a pole."""
    columns = len(kind)
    for step in (1, -1):
        c = 0 if step == 1 else columns - 1
        before, spreads, seen = (c - step) % columns, True, 0
        # Once round, and on over the seam as long as the ground does.
        while seen < columns or (spreads and seen < 2 * columns):
            spreads = False
            undecided = ground[c] == _NO and wall[c] == _NO and (kind[c] == OBSTACLE or kind[c] == POSSIBLE)
            if undecided and ground[before] != _NO:
                near_m = _SPREAD_M + _SPREAD_PER_M * distance_m[c]
                level = abs(z_m[c] - z_m[before]) <= _SPREAD_RISE_M
                spreads = level and abs(distance_m[c] - distance_m[before]) <= near_m
                ground[c] = spreads
            before, c, seen = c, c + step, seen + 1
            if c == columns:
                c = 0
            elif c < 0:
                c = columns - 1
