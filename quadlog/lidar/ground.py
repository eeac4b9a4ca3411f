"""Ground or obstacle in an image of beams: the ground along each column, its height around the lidar, and labels by it.

Columns are walked from the lidar outwards, beam by beam. Short pieces of a beam that stand out of the ground are a box
or a log, however gentle the slope up to them. Constants were chosen on seed 100 of
tests.lab.labelled_scans, and are never reported on that seed.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.lidar.classified_scan import PointClass, Returns, level_plane
from quadlog.lidar.range_image import Image, shares_cell, wrapped
from quadlog.messages import Float, Float32

Marks = NDArray[np.int8]
Bool = NDArray[np.bool_]
Cells = NDArray[np.int32]

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
# Every so many returns the plane is fitted to; odd, so that all beams of a sweep that is sent column by column count.
_PLANE_POINTS = 15

_INVALID, _, _, _GROUND, _RETURN = (np.uint8(each) for each in PointClass)
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
def walk_columns(
    image: Image, returns: Returns, good: Bool, descending: Bool, floor_m: float, used: Cells
) -> tuple[Bool, Bool, int]:
    """Which cells (rows, columns) are ground, and which near the ground have a wall right above them.

    good: (rows, columns) of supported cells. floor_m: the ground's height below the lidar, float32. descending: (rows,)
    whether the beam points below the lidar's own horizon: a column's first ground is seen by one that does, or not.
    used: room for the numbers of the returns that the plane is fitted to; how many these are is the third result.
    """
    (rows, columns), one = good.shape, np.float32(1)
    ground, wall = np.zeros((rows, columns), np.bool_), np.empty((rows, columns), np.bool_)
    # Of every column: where its last ground is, how steep the ground was there, and whether an obstacle lies between.
    last_m, last_z_m = np.zeros(columns, np.float32), np.full(columns, floor_m)
    slope, hidden = np.zeros(columns, np.float32), np.zeros(columns, np.bool_)
    floats = np.empty((3, columns), np.float32)
    kind, gap_m, rise_m, off_m = beam = _Beam(np.empty(columns, np.int8), floats[0], floats[1], floats[2])
    # Loops without branches become vector instructions.
    for row in range(rows):
        distance_m, z_m, seen = image.distance_m[row], image.z_m[row], good[row]
        is_ground, at_wall = ground[row], wall[row]
        _mark_rises(image, good, row, at_wall)
        falls, any_possible = descending[row], False
        for c in range(columns):
            gap, rise = distance_m[c] - last_m[c], z_m[c] - last_z_m[c]
            off = rise - slope[c] * gap
            gap_m[c], rise_m[c], off_m[c] = gap, rise, off
            near = abs(off) <= _NEAR_M + _NEAR_PER_M * gap
            gentle = abs(rise) <= STEEPEST * gap + _SLACK_M
            behind = abs(off) <= _NEAR_M + _BEHIND_PER_M * gap
            walkable = near | (gentle & (behind | (not hidden[c])))
            walkable &= (gap > _BACK_M) & (falls | (last_m[c] > _NONE))
            above_foot = off > _WALL_FOOT_M
            at_foot = (abs(off) < _WALL_FOOT_REACH_M + _NEAR_PER_M * gap) | (walkable & above_foot)
            at_wall[c] &= seen[c] & at_foot
            possible = walkable & (not (at_wall[c] & above_foot))
            kind[c] = (_POSSIBLE if possible else _OBSTACLE) if seen[c] else _NOTHING
        for c in range(columns):
            any_possible |= kind[c] == _POSSIBLE
        if any_possible:
            _vote(beam, distance_m, at_wall, is_ground)
            _drop_pieces(beam, image, good, row, is_ground)
        for c in range(columns):
            hidden[c] = (seen[c] & (not is_ground[c])) | (hidden[c] & (not seen[c]))
        for c in range(columns):
            gap, here = gap_m[c], is_ground[c] & (gap_m[c] > _STEP_M)
            steep = min(max(rise_m[c] / gap, -STEEPEST), STEEPEST)
            slope[c] += (steep - slope[c]) * min(gap / _SLOW_M, one) if here else _NONE
            last_m[c] = distance_m[c] if here else last_m[c]
            last_z_m[c] = z_m[c] if here else last_z_m[c]
    count, n_used, grounds = 0, 0, ground.reshape(-1)
    for i in range(len(returns.label)):
        if returns.label[i] == _RETURN:
            cell = image.cell[i]
            if count == 0 and cell >= 0 and grounds[cell]:
                used[n_used] = i
                n_used += 1
            count = count + 1 if count + 1 < _PLANE_POINTS else 0
    return ground, wall, n_used


@inner
def _mark_rises(image: Image, good: Bool, row: int, rises: Bool) -> None:
    """Where one of the next beams' returns lies as much higher as those on a wall do."""
    distance_m, z_m = image.distance_m[row], image.z_m[row]
    rises[:] = False
    for above in range(row + 1, min(row + 1 + _WALL_BEAMS, len(good))):
        seen, on_m, up_m = good[above], image.distance_m[above], image.z_m[above]
        for c in range(len(rises)):
            rise = up_m[c] - z_m[c]
            rises[c] |= seen[c] & (rise > _WALL_RISE_M) & (rise > _WALL_SLOPE * (on_m[c] - distance_m[c]))


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
    columns, n, ranges_m = len(ground), 0, image.range_m[row]
    column = np.empty(columns + 1, np.int32)
    for c in range(columns):
        column[n] = c
        n += beam.kind[c] != _NOTHING
    column[n] = column[0] + columns
    range_m, edge, edges = np.empty(n + 1, np.float32), np.empty(n + 1, np.int32), 0
    for j in range(n):
        range_m[j] = ranges_m[column[j]]
    range_m[n] = range_m[0]
    for j in range(n):
        jumps = abs(range_m[j + 1] - range_m[j]) > _JUMP_M + _JUMP_PER_M * min(range_m[j], range_m[j + 1])
        edge[edges] = j
        edges += jumps | (column[j + 1] - column[j] > _PIECE_GAP)
    most_wide = _PIECE_WIDTH_M * np.float32(columns) / _TURN
    # Pieces run from behind one edge to the next one, the last one once round.
    for e in range(edges):
        before, after = edge[e], edge[e + 1] if e + 1 < edges else edge[0] + n
        off, gap, wide, size = _NONE, _NONE, _NONE, after - before
        for j in range(before + 1, after + 1):
            k = j if j < n else j - n
            wide += range_m[k]
            if wide >= most_wide:
                break
            off, gap = off + beam.off_m[column[k]], gap + beam.gap_m[column[k]]
        last = after if after < n else after - n
        drops = column[before + 1] - column[before] > _PIECE_GAP or range_m[before + 1] < range_m[before]
        rises = column[last + 1] - column[last] > _PIECE_GAP or range_m[last + 1] > range_m[last]
        stands_out = off > np.float32(size) * _PIECE_RISE_M + _PIECE_RISE_PER_M * gap
        if wide < most_wide and (drops or rises) and stands_out:
            _drop(beam, image, good, row, ground, column[:n], before + 1, size)


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
_STEP, _PER_STEP, _HALF = np.float32(STEP_M), np.float32(1 / STEP_M), np.float32(0.5)


def label_ground(
    image: Image, returns: Returns, good: Bool, descending: Bool, floor_m: float, transform_lidar_to_level: Float
) -> Float:
    """Fill height_m of returns that `isolate` labelled, and label the ground among them.

    Returns (3,) a, b, c of the plane z = a x + b y + c of the ground in base. good, descending, floor_m: as of
    `walk_columns`.
    """
    used = np.empty(len(returns.label) // _PLANE_POINTS + 1, np.int32)
    ground, wall, n_used = walk_columns(image, returns, good, descending, np.float32(floor_m), used)
    xyz_m = np.empty((n_used, 3))
    for axis, along_m in enumerate(returns[:3]):
        xyz_m[:, axis] = along_m[used[:n_used]]
    xyz_m[:, :2] += transform_lidar_to_level[:2, 3]
    plane = level_plane(xyz_m, 0.0)
    outward = _directions(image.range_m.shape[1]) @ transform_lidar_to_level[:2, :2].T
    rise = (outward @ plane[:2] / np.linalg.norm(outward, axis=1)).astype(np.float32)
    _label(image, returns, ground, wall, _profile(image, ground, np.float32(floor_m), rise))
    return plane


@lru_cache(maxsize=8)
def _directions(columns: int) -> Float:
    """(sectors, 2) x and y in the lidar's frame of the middles of sectors."""
    sectors = -(-columns // SECTOR_COLUMNS)
    azimuth_rad = (np.arange(sectors) + 0.5) * (SECTOR_COLUMNS / columns * 2 * np.pi)
    return np.column_stack([np.cos(azimuth_rad), np.sin(azimuth_rad)])


@kernel
def _profile(image: Image, ground: Bool, floor_m: float, rise: Float32) -> Float32:
    """(sectors + 2, STEPS) height of the ground in base, every STEP_M outwards; of every SECTOR_COLUMNS columns.

    The first and the last row are those of the sectors beside them, once round.
    Straight lines from floor_m under the lidar through the mean of each beam's ground in the sector, borrowed from the
    sectors beside it where it has too little; beyond the last, it goes on as `rise` (sectors,) says, per metre.
    """
    sectors, (rows, columns) = len(rise), ground.shape
    sums, height_m = np.zeros((sectors, rows, 3), np.float32), np.empty((sectors + 2, STEPS), np.float32)
    for row in range(rows):
        for c in range(columns):
            if ground[row, c]:
                at = sums[c // SECTOR_COLUMNS, row]
                at[0], at[1], at[2] = at[0] + 1, at[1] + image.distance_m[row, c], at[2] + image.z_m[row, c]
    for s in range(sectors):
        at_m, step, z_m, here_m = _NONE, 0, floor_m, height_m[s + 1]
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
            _draw_line(here_m, step, end, (high - z_m) / (far - at_m), z_m, at_m)
            step, at_m, z_m = max(end, step), far, high
        _draw_line(here_m, step, STEPS, rise[s], z_m, at_m)
    height_m[0], height_m[-1] = height_m[-2], height_m[1]
    return height_m


@inner
def _draw_line(height_m: Float32, begin: int, end: int, rise: float, z_m: float, at_m: float) -> None:
    for k in range(begin, end):
        height_m[k] = z_m + rise * (np.float32(k) * _STEP - at_m)


# Largest height of ground points: found by the column walk, not found by it, and at the foot of a wall.
_WALKED_M, _LEVEL_M, _FOOT_M, _SUNKEN_M = np.float32(0.10), np.float32(0.04), np.float32(0.01), np.float32(-0.3)


@kernel
def _label(image: Image, returns: Returns, ground: Bool, wall: Bool, profile_m: Float32) -> None:
    (rows, columns), flat_m, heights_m = ground.shape, profile_m.reshape(-1), np.empty(ground.shape, np.float32)
    begin, across = np.empty(columns, np.int32), np.empty(columns, np.float32)
    for c in range(columns):
        sector, within = divmod(c + SECTOR_COLUMNS // 2, SECTOR_COLUMNS)
        begin[c], across[c] = sector * STEPS, (np.float32(within) + _HALF) / np.float32(SECTOR_COLUMNS)
    for row in range(rows):
        distance_m, z_m, here_m = image.distance_m[row], image.z_m[row], heights_m[row]
        for c in range(columns):
            here_m[c] = z_m[c] - _floor(flat_m, begin[c], across[c], distance_m[c])
    nearest_m, smoothed_m, above_m = image.range_m.reshape(-1), image.z_m.reshape(-1), heights_m.reshape(-1)
    grounds, walls = ground.reshape(-1), wall.reshape(-1)
    for i in range(len(returns.label)):
        cell, label, r = image.cell[i], returns.label[i], image.point_range_m[i]
        if label == _INVALID:
            continue
        at = np.uint32(max(cell, 0))
        alike = cell >= 0 and shares_cell(r, nearest_m[at])
        if alike and r == nearest_m[at]:
            height_m = above_m[at]
        else:
            c, x, y = cell % columns, returns.dx_m[i], returns.dy_m[i]
            height_m = smoothed_m[at] if alike else returns.z_m[i]
            height_m -= _floor(flat_m, begin[c], across[c], np.sqrt(x * x + y * y))
        returns.height_m[i] = height_m
        is_ground, at_wall = alike and grounds[at], alike and walls[at]
        most = _FOOT_M if at_wall else (_WALKED_M if is_ground else _LEVEL_M)
        low = abs(height_m) <= most or (is_ground and _SUNKEN_M < height_m < _NONE)
        returns.label[i] = _GROUND if low and label == _RETURN else label


@inner
def _floor(flat_m: Float32, begin: np.int32, across: np.float32, away_m: np.float32) -> np.float32:
    """Height of the ground between the sector that begins there and the next, and the steps before and behind."""
    away = min(np.float32(STEPS - 2), away_m * _PER_STEP)  # in this order the former for NaN
    k = np.int32(away)
    along, a, b = away - np.float32(k), np.uint32(begin + k), np.uint32(begin + k + np.int32(STEPS))
    near_m = flat_m[a] + along * (flat_m[np.uint32(a + np.uint32(1))] - flat_m[a])
    far_m = flat_m[b] + along * (flat_m[np.uint32(b + np.uint32(1))] - flat_m[b])
    return near_m + across * (far_m - near_m)
