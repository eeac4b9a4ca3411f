"""Ground or obstacle in an image of beams: the ground along each column, its height around the lidar, and labels by it.

Columns are walked from the lidar outwards, beam by beam. Short pieces of a beam that stand out of the ground are a box
or a log, however gentle the slope up to them. Constants were chosen on seed 100 of
quadlog.simulation.synthetic.labelled_scans, and are never reported on that seed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.lidar.classified_scan import PointClass, Returns, level_plane
from quadlog.lidar.range_image import Image, shares_cell, wrapped
from quadlog.messages import Float, Float32

Marks = NDArray[np.int8]
Bool = NDArray[np.bool_]

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
# A step outwards, and one that says all about the slope.
_STEP_M, _SLOW_M = np.float32(0.05), np.float32(0.5)
# Where ranges jump, how wide a piece may be, how high it must stand; unless it goes on as a ramp does.
_JUMP_M, _JUMP_PER_M, _PIECE_GAP = np.float32(0.10), np.float32(0.03), 3
_PIECE_WIDTH_M, _PIECE_RISE_M, _PIECE_RISE_PER_M = np.float32(2.5), np.float32(0.06), np.float32(0.02)
_RAMP_SLOPE, _RAMP_AGREES, _RAMP_STEP_M = np.float32(0.12), np.float32(0.12), np.float32(0.3)

_NOTHING, _OBSTACLE, _POSSIBLE = np.int8(0), np.int8(1), np.int8(2)
_NONE, _TURN = np.float32(0), np.float32(2 * np.pi)


class _Beam(NamedTuple):
    """One beam's returns, (columns,) each: whether they may be ground, and from the column's ground before them how
    far, how much higher, and how much above its line.
    """

    kind: Marks
    gap_m: Float32
    rise_m: Float32
    off_m: Float32


@kernel
def walk_columns(image: Image, good: Bool, descending: Bool, floor_m: float) -> tuple[Bool, Bool]:
    """Which cells (rows, columns) are ground, and which near the ground have a wall right above them.

    good: (rows, columns) of supported cells. floor_m: height of the ground under the lidar, float32.
    descending: (rows,) whether the beam points below the lidar's own horizon: a column's first ground is seen by one
    that does, or not at all.
    """
    distance_m, z_m, (rows, columns) = image.distance_m, image.z_m, good.shape
    ground, wall = np.zeros((rows, columns), np.bool_), np.zeros((rows, columns), np.bool_)
    # Of every column: where its last ground is, how steep the ground was there, and whether an obstacle lies between.
    last_m, last_z_m = np.zeros(columns, np.float32), np.full(columns, floor_m)
    slope, hidden = np.zeros(columns, np.float32), np.zeros(columns, np.bool_)
    floats = np.empty((3, columns), np.float32)
    beam = _Beam(np.empty(columns, np.int8), floats[0], floats[1], floats[2])
    for row in range(rows):
        any_possible = False
        for c in range(columns):
            beam.kind[c] = _NOTHING
            if not good[row, c]:
                continue
            gap, rise = distance_m[row, c] - last_m[c], z_m[row, c] - last_z_m[c]
            off = rise - slope[c] * gap
            beam.gap_m[c], beam.rise_m[c], beam.off_m[c] = gap, rise, off
            near = abs(off) <= _NEAR_M + _NEAR_PER_M * gap
            gentle = abs(rise) <= STEEPEST * gap + _SLACK_M
            behind = abs(off) <= _NEAR_M + _BEHIND_PER_M * gap
            walkable = near or (gentle and (behind or not hidden[c]))
            walkable &= gap > _BACK_M and (descending[row] or last_m[c] > _NONE)
            above_foot = off > _WALL_FOOT_M
            if abs(off) < _WALL_FOOT_REACH_M + _NEAR_PER_M * gap or (walkable and above_foot):
                wall[row, c] = _rises_above(distance_m, z_m, good, row, c)
            possible = walkable and not (wall[row, c] and above_foot)
            any_possible |= possible
            beam.kind[c] = _POSSIBLE if possible else _OBSTACLE
        if any_possible:
            _vote(beam, distance_m[row], wall[row], ground[row])
            _drop_pieces(beam, image, good, row, ground[row])
        for c in range(columns):
            if beam.kind[c] == _NOTHING:
                continue
            hidden[c] = not ground[row, c]
            gap = beam.gap_m[c]
            if ground[row, c] and gap > _STEP_M:
                steep = min(max(beam.rise_m[c] / gap, -STEEPEST), STEEPEST)
                slope[c] += (steep - slope[c]) * min(gap / _SLOW_M, np.float32(1))
                last_m[c], last_z_m[c] = distance_m[row, c], z_m[row, c]
    return ground, wall


@inner
def _rises_above(distance_m: Float32, z_m: Float32, good: Bool, row: int, c: int) -> bool:
    for above in range(row + 1, min(row + 1 + _WALL_BEAMS, len(good))):
        rise, on = z_m[above, c] - z_m[row, c], distance_m[above, c] - distance_m[row, c]
        if good[above, c] and rise > _WALL_RISE_M and rise > _WALL_SLOPE * on:
            return True
    return False


@inner
def _vote(beam: _Beam, distance_m: Float32, wall: Bool, ground: Bool) -> None:
    """More than half of the returns beside a cell, at about its distance, must be possible ground."""
    columns, clear = len(wall), 0
    for ahead in range(-_VOTERS, columns + _VOTERS):
        clear, c = 0 if beam.kind[wrapped(ahead, columns)] == _OBSTACLE else clear + 1, ahead - _VOTERS
        if c < 0 or beam.kind[c] == _NOTHING or (wall[c] and beam.off_m[c] > _WALL_FOOT_M):
            continue
        if clear > 2 * _VOTERS:
            ground[c] = True
            continue
        near_m, votes = _VOTER_M + _VOTER_PER_M * distance_m[c], 0
        for k in range(-_VOTERS, _VOTERS + 1):
            other = wrapped(c + k, columns)
            if beam.kind[other] != _NOTHING and abs(distance_m[other] - distance_m[c]) < near_m:
                votes += 1 if beam.kind[other] == _POSSIBLE else -1
        ground[c] = votes > 0


@inner
def _drop_pieces(beam: _Beam, image: Image, good: Bool, row: int, ground: Bool) -> None:
    """No short piece of a beam is ground that stands out of it, with something farther, or nothing, at an end."""
    columns = len(ground)
    column, n, ranges_m = np.empty(columns, np.int32), 0, image.range_m[row]
    for c in range(columns):
        column[n] = c
        n += beam.kind[c] != _NOTHING
    most_wide = _PIECE_WIDTH_M * np.float32(columns) / _TURN
    # Pieces run from behind one edge to the next one, once round from the first edge.
    first, begin, drops_before = -1, 0, False
    off, gap, wide = _NONE, _NONE, _NONE
    for j in range(2 * n):
        here, there = column[j if j < n else j - n], column[j + 1 if j + 1 < n else (j + 1 - n) % n]
        off, gap, wide = off + beam.off_m[here], gap + beam.gap_m[here], wide + ranges_m[here]
        step_m = ranges_m[there] - ranges_m[here]
        jumps = abs(step_m) > _JUMP_M + _JUMP_PER_M * min(ranges_m[here], ranges_m[there])
        apart = wrapped(there - here - 1, columns) + 1 > _PIECE_GAP
        if not (jumps or apart):
            continue
        rises, drops, size = apart or step_m > _NONE, apart or step_m < _NONE, j + 1 - begin
        stands_out = off > np.float32(size) * _PIECE_RISE_M + _PIECE_RISE_PER_M * gap
        if first >= 0 and (drops_before or rises) and wide < most_wide and stands_out:
            _drop(beam, image, good, row, ground, column[:n], begin, size)
        if first >= 0 and j >= first + n:
            break
        first = j if first < 0 else first
        begin, drops_before, off, gap, wide = j + 1, drops, _NONE, _NONE, _NONE


@inner
def _drop(
    beam: _Beam, image: Image, good: Bool, row: int, ground: Bool, column: NDArray[np.int32], begin: int, size: int
) -> None:
    """Not ground any more, unless the piece goes on as a ramp does: to the next beam's returns at about the same slope.

    column: (n,) of the beam's returns; the piece has `size` of them from number `begin` on.
    """
    ramps = 0
    for j in range(begin, begin + size):
        c = column[j % len(column)]
        if row + 1 == len(good) or not good[row + 1, c]:
            continue
        gap, rise = beam.gap_m[c], beam.rise_m[c]
        on, up = image.distance_m[row + 1, c] - image.distance_m[row, c], image.z_m[row + 1, c] - image.z_m[row, c]
        if gap > 0 and rise > _RAMP_SLOPE * gap and 0 < on < 3 * gap + _RAMP_STEP_M:
            ramps += abs(up / on - rise / gap) < _RAMP_AGREES
    for j in range(begin, begin + size):
        ground[column[j % len(column)]] &= 2 * ramps >= size


SECTOR_COLUMNS = 16
"""About 3 degrees: at 10 m as wide as the ground may curve, and few enough returns to average."""
STEP_M, REACH_M = 0.125, 32.0
STEPS = int(REACH_M / STEP_M) + 1
_SECTORS_BESIDE, _FEWEST = 3, 3
# Every so many points the plane is fitted to; odd, so that all beams of a sweep that is sent column by column count.
_PLANE_POINTS = 15
_STEP, _PER_STEP, _HALF = np.float32(STEP_M), np.float32(1 / STEP_M), np.float32(0.5)


def label_ground(
    image: Image, returns: Returns, good: Bool, descending: Bool, floor_m: float, transform_lidar_to_level: Float
) -> Float:
    """Fill height_m of returns that `isolate` labelled, and label the ground among them.

    Returns (3,) a, b, c of the plane z = a x + b y + c of the ground in base. good, descending, floor_m: as of
    `walk_columns`.
    """
    ground, wall = walk_columns(image, good, descending, np.float32(floor_m))
    used = np.flatnonzero((image.row >= 0) & (image.point_range_m > 0))[::_PLANE_POINTS]
    used = used[ground[image.row[used], image.column[used]] & (returns.label[used] == PointClass.OBSTACLE)]
    places = np.column_stack([returns.dx_m[used], returns.dy_m[used], returns.z_m[used]]).astype(np.float64)
    plane = level_plane(places + np.array([*transform_lidar_to_level[:2, 3], 0.0]), 0.0)
    sectors = -(-image.range_m.shape[1] // SECTOR_COLUMNS)
    azimuth_rad = (np.arange(sectors) + 0.5) * (SECTOR_COLUMNS / image.range_m.shape[1] * 2 * np.pi)
    outward = np.column_stack([np.cos(azimuth_rad), np.sin(azimuth_rad)]) @ transform_lidar_to_level[:2, :2].T
    rise = (outward @ plane[:2] / np.linalg.norm(outward, axis=1)).astype(np.float32)
    _label(image, returns, ground, wall, _profile(image, ground, np.float32(floor_m), rise))
    return plane


@kernel
def _profile(image: Image, ground: Bool, floor_m: float, rise: Float32) -> Float32:
    """(sectors, STEPS) height of the ground in base, every STEP_M outwards; of every SECTOR_COLUMNS columns.

    Straight lines from floor_m under the lidar through the mean of each beam's ground in the sector, borrowed from the
    sectors beside it where it has too little; beyond the last, it goes on as `rise` (sectors,) says, per metre.
    """
    sectors, (rows, columns) = len(rise), ground.shape
    sums, height_m = np.zeros((sectors, rows, 3), np.float32), np.empty((sectors, STEPS), np.float32)
    for row in range(rows):
        for c in range(columns):
            if ground[row, c]:
                at = sums[c // SECTOR_COLUMNS, row]
                at[0], at[1], at[2] = at[0] + 1, at[1] + image.distance_m[row, c], at[2] + image.z_m[row, c]
    for s in range(sectors):
        at_m, step, z_m = _NONE, 0, floor_m
        for row in range(rows):
            count, far, high = sums[s, row, 0], sums[s, row, 1], sums[s, row, 2]
            for k in range(1, _SECTORS_BESIDE + 1):
                if count >= SECTOR_COLUMNS // 2:
                    break
                left, right = sums[(s - k) % sectors, row], sums[(s + k) % sectors, row]
                count, far, high = count + left[0] + right[0], far + left[1] + right[1], high + left[2] + right[2]
            if count < _FEWEST or far / count <= at_m:
                continue
            far, high = far / count, high / count
            end = min(int(far * _PER_STEP) + 1, STEPS)
            _draw_line(height_m[s], step, end, (high - z_m) / (far - at_m), z_m, at_m)
            step, at_m, z_m = max(end, step), far, high
        _draw_line(height_m[s], step, STEPS, rise[s], z_m, at_m)
    return height_m


@inner
def _draw_line(height_m: Float32, begin: int, end: int, rise: float, z_m: float, at_m: float) -> None:
    for k in range(begin, end):
        height_m[k] = z_m + rise * (np.float32(k) * _STEP - at_m)


# Largest height of ground points: found by the column walk, not found by it, and at the foot of a wall.
_WALKED_M, _LEVEL_M, _FOOT_M, _SUNKEN_M = np.float32(0.10), np.float32(0.04), np.float32(0.01), np.float32(-0.3)
_INVALID, _, _, _GROUND, _RETURN = (np.uint8(each) for each in PointClass)


@kernel
def _label(image: Image, returns: Returns, ground: Bool, wall: Bool, profile_m: Float32) -> None:
    sectors, last = len(profile_m), np.float32(STEPS - 2)
    for i in range(len(returns.label)):
        if returns.label[i] == _INVALID:
            continue
        row, c = image.row[i], np.int64(image.column[i])
        x, y, z_m = returns.dx_m[i], returns.dy_m[i], returns.z_m[i]
        distance_m = np.sqrt(x * x + y * y)
        alike = row >= 0 and shares_cell(image.point_range_m[i], image.range_m[row, c])
        if alike:  # smoothed
            z_m = image.z_m[row, c]
        # The height of the ground between the sectors on either side, and the steps before and behind.
        away = min(distance_m * _PER_STEP, last)
        k = np.int64(away)
        along, column = away - np.float32(k), c + SECTOR_COLUMNS // 2
        second = column // SECTOR_COLUMNS
        across = (np.float32(column - second * SECTOR_COLUMNS) + _HALF) / np.float32(SECTOR_COLUMNS)
        before, behind = profile_m[second - 1], profile_m[second if second < sectors else 0]
        near = before[k] + along * (before[k + 1] - before[k])
        far = behind[k] + along * (behind[k + 1] - behind[k])
        above = z_m - (near + across * (far - near))
        returns.height_m[i] = above
        if returns.label[i] != _RETURN:
            continue
        is_ground, at_wall = alike and ground[row, c], alike and wall[row, c]
        most = _FOOT_M if at_wall else (_WALKED_M if is_ground else _LEVEL_M)
        if abs(above) <= most or (is_ground and _SUNKEN_M < above < _NONE):
            returns.label[i] = _GROUND
