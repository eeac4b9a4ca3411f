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

from quadlog.lidar.polar import Float32

STEEPEST = 0.47
"""25 degrees: a ramp of 20 and what the gait tilts."""
# Height off the line of the ground before it: sure ground, and what is still possible behind an obstacle.
_NEAR_M, _NEAR_PER_M, _BEHIND_PER_M = 0.04, 0.02, 0.05
_SLACK_M = 0.03
# A wall: steeper than this up to a return of the next beams, and at least so much higher.
_WALL_SLOPE, _WALL_RISE_M, _WALL_BEAMS = 0.7, 0.05, 3
_WALL_FOOT_M = 0.012
# Farther off, no return is at a wall's foot.
_WALL_FOOT_REACH_M = 0.3
_VOTERS = 4
_SPREAD_M, _SPREAD_PER_M, _SPREAD_RISE_M = 0.05, 0.01, 0.03
# A short piece: where ranges jump, how wide it may be, how high it must stand; unless it goes on as a ramp does.
_JUMP_M, _JUMP_PER_M, _PIECE_GAP = 0.10, 0.03, 3
_PIECE_WIDTH_M, _PIECE_RISE_M, _PIECE_RISE_PER_M = 2.5, 0.06, 0.02
_RAMP_SLOPE, _RAMP_AGREES = 0.12, 0.12

_NOTHING, _OBSTACLE, _POSSIBLE, _PIECE = 0, 1, 2, 3


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
    ground, wall = np.zeros(good.shape, np.bool_), np.zeros(good.shape, np.bool_)
    columns = good.shape[1]
    lasts, offs = np.zeros((3, columns), np.float32), np.zeros((3, columns), np.float32)
    lasts[1] = floor_m
    marks = np.zeros((4, columns), np.int8)
    follows = np.zeros(columns, np.int32)
    _walk(good, distance_m, z_m, range_m, descending, lasts, offs, marks, follows, ground, wall)
    return ground, wall


@njit(cache=True, error_model="numpy")
def _walk(
    good: NDArray[np.bool_],
    distance_m: Float32,
    z_m: Float32,
    range_m: Float32,
    descending: NDArray[np.bool_],
    lasts: Float32,
    offs: Float32,
    marks: NDArray[np.int8],
    follows: NDArray[np.int32],
    ground: NDArray[np.bool_],
    wall: NDArray[np.bool_],
) -> None:
    # Of every column: where its last ground is, how steep the ground was there, and what lies between.
    last_m, last_z_m, slope = lasts[0], lasts[1], lasts[2]
    off_m, gap_m, rise_m = offs[0], offs[1], offs[2]
    kind, hidden = marks[0], marks[1]
    for row in range(good.shape[0]):
        any_possible = False
        for c in range(good.shape[1]):
            kind[c] = _NOTHING
            if not good[row, c]:
                continue
            gap, rise = distance_m[row, c] - last_m[c], z_m[row, c] - last_z_m[c]
            off = rise - slope[c] * gap
            off_m[c], gap_m[c], rise_m[c] = off, gap, rise
            kind[c] = _OBSTACLE
            if abs(off) < _WALL_FOOT_REACH_M + _NEAR_PER_M * gap:
                wall[row, c] = _rises(good, distance_m, z_m, row, c)
            if gap <= -0.05 or not (descending[row] or last_m[c] > 0):
                continue
            walkable = abs(rise) <= STEEPEST * gap + _SLACK_M
            walkable &= hidden[c] == 0 or abs(off) <= _NEAR_M + _BEHIND_PER_M * gap
            if not walkable and abs(off) > _NEAR_M + _NEAR_PER_M * gap:
                continue
            if off > _WALL_FOOT_M and not wall[row, c]:
                wall[row, c] = _rises(good, distance_m, z_m, row, c)
            if off <= _WALL_FOOT_M or not wall[row, c]:
                kind[c] = _POSSIBLE
                any_possible = True
        if any_possible:
            _vote(kind, distance_m[row], wall[row], off_m, ground[row])
            _drop_pieces(kind, good, distance_m, z_m, range_m, row, offs, marks[2], marks[3], follows, ground[row])
            _spread(kind, distance_m[row], z_m[row], wall[row], ground[row])
        for c in range(good.shape[1]):
            if kind[c] == _NOTHING:
                continue
            hidden[c] = 1
            if ground[row, c]:
                hidden[c] = 0
                gap = distance_m[row, c] - last_m[c]
                if gap > 0.05:
                    steep = (z_m[row, c] - last_z_m[c]) / gap
                    steep = STEEPEST if steep > STEEPEST else (-STEEPEST if steep < -STEEPEST else steep)
                    slope[c] += (steep - slope[c]) * (gap * 2 if gap < 0.5 else 1.0)
                last_m[c], last_z_m[c] = distance_m[row, c], z_m[row, c]


@njit(cache=True, error_model="numpy")
def _rises(good: NDArray[np.bool_], distance_m: Float32, z_m: Float32, row: int, c: int) -> bool:
    for above in range(row + 1, row + 1 + _WALL_BEAMS):
        if above < len(good) and good[above, c]:
            rise = z_m[above, c] - z_m[row, c]
            if rise > _WALL_RISE_M and rise > _WALL_SLOPE * (distance_m[above, c] - distance_m[row, c]):
                return True
    return False


@njit(cache=True, error_model="numpy")
def _goes_on(
    good: NDArray[np.bool_], distance_m: Float32, z_m: Float32, row: int, c: int, gap: float, rise: float
) -> bool:
    """Whether it climbs from the last ground to this return, and on to the next beam's at about the same slope."""
    if not (gap > 0 and rise > _RAMP_SLOPE * gap and row + 1 < len(good) and good[row + 1, c]):
        return False
    on = distance_m[row + 1, c] - distance_m[row, c]
    if not 0 < on < 3 * gap + 0.3:
        return False
    return abs((z_m[row + 1, c] - z_m[row, c]) / on - rise / gap) < _RAMP_AGREES


@njit(cache=True, error_model="numpy")
def _vote(
    kind: NDArray[np.int8], distance_m: Float32, wall: NDArray[np.bool_], off_m: Float32, ground: NDArray[np.bool_]
) -> None:
    """More than half of the returns beside a cell, at about its distance, must be possible ground."""
    columns = len(kind)
    for_it, against = 0, 0
    for c in range(-_VOTERS - 1, _VOTERS):
        for_it += kind[c] == _POSSIBLE
        against += kind[c] == _OBSTACLE
    for c in range(columns):
        first, last = c - _VOTERS - 1, c + _VOTERS - columns
        for_it += int(kind[last] == _POSSIBLE) - int(kind[first] == _POSSIBLE)
        against += int(kind[last] == _OBSTACLE) - int(kind[first] == _OBSTACLE)
        if for_it == 0 or kind[c] == _NOTHING or (wall[c] and off_m[c] > _WALL_FOOT_M):
            continue
        if against == 0:
            # All agree, at whatever distance.
            ground[c] = True
            continue
        near_m = 0.05 + 0.02 * distance_m[c]
        voters, ayes = 0, 0
        for k in range(-_VOTERS, _VOTERS + 1):
            other = c + k
            if other < 0:
                other += columns
            elif other >= columns:
                other -= columns
            if kind[other] != _NOTHING and abs(distance_m[other] - distance_m[c]) < near_m:
                voters += 1
                ayes += kind[other] == _POSSIBLE
        ground[c] = 2 * ayes > voters


@njit(cache=True, error_model="numpy")
def _drop_pieces(
    kind: NDArray[np.int8],
    good: NDArray[np.bool_],
    distance_m: Float32,
    z_m: Float32,
    range_m: Float32,
    row: int,
    offs: Float32,
    before: NDArray[np.int8],
    after: NDArray[np.int8],
    follows: NDArray[np.int32],
    ground: NDArray[np.bool_],
) -> None:
    """No short piece of a beam is ground that stands out of it, with something farther, or nothing, at an end."""
    columns = len(kind)
    off_m, gap_m, ranges = offs[0], offs[1], range_m[row]
    for c in range(columns):
        # Of each piece's ends: 1 where what is beside it is farther or absent, -1 where nearer, 0 inside.
        before[c], after[c], follows[c] = 0, 0, -1
    for c in range(columns):
        if kind[c] == _NOTHING:
            continue
        if _first_beside(kind, c, -1) < 0:
            before[c] = 1
        other = _first_beside(kind, c, 1)
        if other < 0:
            after[c] = 1
            continue
        step = ranges[other] - ranges[c]
        nearer_m = ranges[c] if step > 0 else ranges[other]
        if abs(step) <= _JUMP_M + _JUMP_PER_M * nearer_m:
            follows[c] = other
        else:
            after[c] = 1 if step > 0 else -1
            before[other] = -after[c]
    for first in range(columns):
        if before[first] == 0:
            continue
        n, off, gap, width_m = 0, 0.0, 0.0, 0.0
        c = last = first
        while c >= 0:
            n, last = n + 1, c
            off, gap, width_m = off + off_m[c], gap + gap_m[c], width_m + ranges[c] * (2 * np.pi / columns)
            c = follows[c]
        ends_free = before[first] == 1 or after[last] == 1
        if not ends_free or width_m >= _PIECE_WIDTH_M or off / n <= _PIECE_RISE_M + _PIECE_RISE_PER_M * gap / n:
            continue
        ramps, c = 0, first
        while c >= 0:
            ramps += _goes_on(good, distance_m, z_m, row, c, gap_m[c], offs[2, c])
            c = follows[c]
        if 2 * ramps < n:
            c = first
            while c >= 0:
                ground[c], kind[c] = False, _PIECE
                c = follows[c]


@njit(cache=True, error_model="numpy")
def _first_beside(kind: NDArray[np.int8], c: int, step: int) -> int:
    for k in range(1, _PIECE_GAP + 1):
        other = c + k * step
        if other < 0:
            other += len(kind)
        elif other >= len(kind):
            other -= len(kind)
        if kind[other] != _NOTHING:
            return other
    return -1


@njit(cache=True, error_model="numpy")
def _spread(
    kind: NDArray[np.int8], distance_m: Float32, z_m: Float32, wall: NDArray[np.bool_], ground: NDArray[np.bool_]
) -> None:
    """Along the beam, both ways round, over what the columns alone could not tell, such as a ramp behind a pole."""
    columns = len(kind)
    for step in (1, -1):
        before, c = 0, 0
        for _ in range(2 * columns):
            c += step
            if c == columns:
                c = 0
            elif c < 0:
                c = columns - 1
            undecided = not ground[c] and not wall[c] and (kind[c] == _OBSTACLE or kind[c] == _POSSIBLE)
            if undecided and ground[before]:
                near_m = _SPREAD_M + _SPREAD_PER_M * distance_m[c]
                level = abs(z_m[c] - z_m[before]) <= _SPREAD_RISE_M
                ground[c] = level and abs(distance_m[c] - distance_m[before]) <= near_m
            before = c
