"""Statistical outliers as the papers remove them: points farther from their nearest neighbours than most.

A k-d tree whose leaves hold a few more points than are looked for. All points of a leaf share one list of the leaves
near it; each point then measures its distance to every point of the few leaves its own ball touches, and takes the
smallest. Nothing is estimated: guesses decide where to look first, and a guess that was too small is enlarged until
enough points lie within it.

What makes it faster than a general library's search of one point after the other: distances to a whole leaf, and how
many are below a limit, are loops without branches, which the compiler turns into vector instructions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import cached
from quadlog.messages import Float, Int

# Vector registers hold up to 8 float64: loops over a leaf have no remainder when its slots are a multiple.
LANES = 8
# A ball this much larger (in squared radius) than that of the point before usually holds enough points.
MARGIN = 1.1


def mean_neighbour_distances(xyz_m: Float, neighbours: int) -> Float:
    """Mean distance (N,) of each finite point (N, 3) to its `neighbours` nearest others.

    Exact but for the rounding of the sum, whatever the cloud looks like; coordinates may not exceed 1e150, whose
    squares overflow. Takes a few hundred nanoseconds a point and memory for a few copies of the cloud. Raises
    ValueError when there are not more than `neighbours` points, or neighbours < 1.
    """
    if not 1 <= neighbours < len(xyz_m):
        raise ValueError(f"{len(xyz_m)} points do not have {neighbours} neighbours each")
    # Two compiled steps called from here, because a compiled caller would compile both once more as part of itself.
    tree = _build(np.ascontiguousarray(xyz_m, dtype=np.float64), neighbours + 1)
    return _mean_distances(tree, len(xyz_m), neighbours)


class _Tree(NamedTuple):
    """A balanced tree: node i has the children 2 i + 1 and 2 i + 2, and the last n_leaves nodes are the leaves.

    box: (nodes, 6) least x, y, z and largest x, y, z of a node's points.
    xyz: (n_leaves, 3, slots), unused slots at infinity.
    point: (n_leaves, slots), which point of the cloud is in a slot, -1 for none.
    n_in: (n_leaves,) slots used.
    """

    box: Float
    xyz: Float
    point: Int
    n_in: Int


@cached()
def _mean_distances(tree: _Tree, n_points: int, neighbours: int) -> Float:
    wanted = neighbours + 1  # every point is its own nearest, at distance 0
    n_leaves, _, slots = tree.xyz.shape
    near, near_box = np.empty(n_leaves, dtype=np.int64), np.empty((6, n_leaves))
    gap2, d2, kept = np.empty(n_leaves), np.empty((n_leaves, slots)), np.empty(n_leaves * slots)
    flat_d2 = d2.reshape(-1)
    mean_m = np.zeros(n_points)
    farthest2 = np.inf
    for leaf in range(n_leaves):
        # A leaf holds enough points, so none of its points has to look farther than its diagonal.
        diagonal2 = _diagonal2(tree.box[n_leaves - 1 + leaf])
        if diagonal2 == 0.0:
            continue  # all of its points coincide
        n_near = _leaves_near(tree.box, leaf, n_leaves, diagonal2, near, near_box)
        for slot in range(tree.n_in[leaf]):
            x, y, z = tree.xyz[leaf, 0, slot], tree.xyz[leaf, 1, slot], tree.xyz[leaf, 2, slot]
            low2, n_low, high2 = 0.0, 0, min(farthest2 * MARGIN, diagonal2)
            rows, n_high = _measure(tree.xyz, near, near_box, n_near, x, y, z, high2, gap2, d2)
            while n_high < wanted and high2 < diagonal2:
                low2, n_low, high2 = high2, n_high, min(max(high2 * 1.5, diagonal2 / 64), diagonal2)
                rows, n_high = _measure(tree.xyz, near, near_box, n_near, x, y, z, high2, gap2, d2)
            limit2, next2 = _enclose(flat_d2, rows * slots, wanted, low2, n_low, high2, n_high)
            total_m, farthest2, n_kept = _sum_of_roots(flat_d2, rows * slots, limit2, kept)
            if n_kept < wanted:
                total_m, farthest2 = total_m + (wanted - n_kept) * math.sqrt(next2), next2
            mean_m[tree.point[leaf, slot]] = total_m / neighbours
    return mean_m


@cached()
def _build(xyz_m: Float, least_in_leaf: int) -> _Tree:
    """Halve the points at the median of their box's longest side, as often as least_in_leaf allows."""
    n_points = len(xyz_m)
    depth = 0
    while n_points >> (depth + 1) >= least_in_leaf:
        depth += 1
    n_leaves = 2**depth
    columns, index = np.empty((3, n_points)), np.empty(n_points, dtype=np.int64)
    for i in range(n_points):
        columns[0, i], columns[1, i], columns[2, i], index[i] = xyz_m[i, 0], xyz_m[i, 1], xyz_m[i, 2], i
    box = np.empty((2 * n_leaves - 1, 6))
    start, end = np.empty(len(box), dtype=np.int64), np.empty(len(box), dtype=np.int64)
    start[0], end[0] = 0, n_points
    for node in range(len(box)):
        longest = 0
        for axis in range(3):
            low, high = _extent(columns[axis], start[node], end[node])
            box[node, axis], box[node, 3 + axis] = low, high
            if high - low > box[node, 3 + longest] - box[node, longest]:
                longest = axis
        if node < n_leaves - 1:
            middle = (start[node] + end[node]) // 2
            _halve(columns, index, longest, start[node], end[node], middle)
            left, right = 2 * node + 1, 2 * node + 2
            start[left], end[left] = start[node], middle
            start[right], end[right] = middle, end[node]
    return _filled(box, columns, index, start, end)


@cached()
def _filled(box: Float, columns: Float, index: Int, start: Int, end: Int) -> _Tree:
    """Every leaf's points side by side, so that measuring them reads memory in order."""
    n_leaves = (len(box) + 1) // 2
    most_in_leaf = (len(index) + n_leaves - 1) // n_leaves
    slots = (most_in_leaf + LANES - 1) // LANES * LANES
    xyz, n_in = np.empty((n_leaves, 3, slots)), np.empty(n_leaves, dtype=np.int64)
    index_in = np.empty((n_leaves, slots), dtype=np.int64)
    for leaf in range(n_leaves):
        first = start[n_leaves - 1 + leaf]
        n_in[leaf] = end[n_leaves - 1 + leaf] - first
        for slot in range(slots):
            used = slot < n_in[leaf]
            index_in[leaf, slot] = index[first + slot] if used else -1
            for axis in range(3):
                xyz[leaf, axis, slot] = columns[axis, first + slot] if used else np.inf
    return _Tree(box, xyz, index_in, n_in)


@cached()
def _extent(values: Float, start: int, end: int) -> tuple[float, float]:
    low = high = values[start]
    for i in range(start + 1, end):
        low, high = min(low, values[i]), max(high, values[i])
    return low, high


@cached()
def _halve(columns: Float, index: Int, axis: int, start: int, end: int, middle: int) -> None:
    """Reorder points start..end - 1 so that none before `middle` lies beyond one from `middle` on (Hoare's select)."""
    key = columns[axis]
    low, high = start, end - 1
    # Pivots drawn by a fixed generator: the same every time, and no order of points makes it slow but by bad luck.
    drawn = np.uint32(end)
    while low < high:
        drawn = np.uint32(drawn * np.uint32(1664525) + np.uint32(1013904223))
        pivot = key[low + np.int64(drawn >> np.uint32(8)) % (high - low + 1)]
        i, j = low, high
        while i <= j:
            while key[i] < pivot:
                i += 1
            while key[j] > pivot:
                j -= 1
            if i <= j:
                for row in range(3):
                    columns[row, i], columns[row, j] = columns[row, j], columns[row, i]
                index[i], index[j] = index[j], index[i]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@cached()
def _diagonal2(box: Float) -> float:
    # Slightly more than the diagonal squared, so that rounding never puts two points of the box farther apart.
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return (x * x + y * y + z * z) * (1.0 + 1e-12)


@cached()
def _leaves_near(box: Float, leaf: int, n_leaves: int, reach2: float, near: Int, near_box: Float) -> int:
    """Write which leaves are nearer to a leaf than the reach, and their boxes (6, n); returns how many."""
    here = box[n_leaves - 1 + leaf]
    waiting = np.empty(64, dtype=np.int64)  # more than the depth of any tree
    waiting[0], n_waiting, n_near = 0, 1, 0
    while n_waiting > 0:
        n_waiting -= 1
        node = waiting[n_waiting]
        there, gap2 = box[node], 0.0
        for axis in range(3):
            gap = max(there[axis] - here[3 + axis], here[axis] - there[3 + axis], 0.0)
            gap2 += gap * gap
        # Not "<=": points just as far as the farthest one wanted do not change the distances.
        if gap2 < reach2:
            if node < n_leaves - 1:
                waiting[n_waiting], waiting[n_waiting + 1] = 2 * node + 2, 2 * node + 1
                n_waiting += 2
            else:
                near[n_near] = node - (n_leaves - 1)
                for side in range(6):
                    near_box[side, n_near] = there[side]
                n_near += 1
    return n_near


@cached()
def _measure(
    xyz: Float, near: Int, near_box: Float, n_near: int, x: float, y: float, z: float, limit2: float, gap2: Float,
    d2: Float,
) -> tuple[int, int]:  # fmt: skip
    """Write the squared distances to all points of the leaves nearer than the limit, a row of d2 for each leaf.

    Returns how many rows, and how many distances in them are within the limit.
    """
    for i in range(n_near):
        gap_x = max(near_box[0, i] - x, x - near_box[3, i], 0.0)
        gap_y = max(near_box[1, i] - y, y - near_box[4, i], 0.0)
        gap_z = max(near_box[2, i] - z, z - near_box[5, i], 0.0)
        gap2[i] = gap_x * gap_x + gap_y * gap_y + gap_z * gap_z
    rows, n_within = 0, 0
    for i in range(n_near):
        if gap2[i] < limit2:
            leaf = near[i]
            for slot in range(xyz.shape[2]):
                dx, dy, dz = xyz[leaf, 0, slot] - x, xyz[leaf, 1, slot] - y, xyz[leaf, 2, slot] - z
                squared = dx * dx + dy * dy + dz * dz
                d2[rows, slot] = squared
                n_within += squared <= limit2
            rows += 1
    return rows, n_within


@cached()
def _enclose(d2: Float, n: int, wanted: int, low2: float, n_low: int, high2: float, n_high: int) -> tuple[float, float]:
    """Two limits: the `wanted` smallest of n values are those within the first, then some equal to the second.

    low2 holds n_low, too few, and high2 holds n_high, enough. Between them
    the count is taken to grow evenly at first; halving then makes sure of an end.
    """
    tries = 0
    while n_high > wanted:
        if tries < 12:
            middle2 = low2 + (high2 - low2) * ((wanted - n_low) / (n_high - n_low))
        else:
            middle2 = 0.5 * (low2 + high2) if low2 > 0.0 else 1e-30 * high2
        if not low2 < middle2 < high2:
            return low2, high2  # no number lies between: what is left is equal
        n_middle = 0
        for i in range(n):
            n_middle += d2[i] <= middle2
        if n_middle >= wanted:
            high2, n_high = middle2, n_middle
        else:
            low2, n_low = middle2, n_middle
        tries += 1
    return high2, high2


@cached()
def _sum_of_roots(d2: Float, n: int, limit2: float, kept: Float) -> tuple[float, float, int]:
    """Of those of the first n values that are within the limit: the sum of their roots, the largest, how many."""
    # Every value is written, and the next one over it unless it counts: no branch to mispredict.
    # An unsigned index spares the compiled loop the question whether it counts from the end.
    filled = np.uint64(0)
    for i in range(n):
        kept[filled] = d2[i]
        filled += np.uint64(d2[i] <= limit2)
    total, largest2, n_kept = 0.0, 0.0, int(filled)
    for i in range(n_kept):
        largest2 = max(largest2, kept[i])
        kept[i] = math.sqrt(kept[i])
    for i in range(n_kept):
        total += kept[i]
    return total, largest2, n_kept


# Tolerance of the limit: the mean of equal numbers may round to less than each of them.
ROUNDING = 1e-12


def statistical_outliers(xyz_m: Float, neighbours: int, std_ratio: float) -> NDArray[np.bool_]:
    """Which of the finite points (N, 3) are outliers: (N,) bool. [Following]

    D_i is the mean distance to the nearest `neighbours` points, the point itself excluded; a point stays when D_i <= mu
    + std_ratio * sigma over the whole cloud (sigma with N - 1). A cloud of no more than `neighbours` points has no such
    D_i and no outliers.

    Open3D's filter finds the same set and is the tests' oracle, but on two kinds of clouds where it departs from the
    definition, because it keeps 0 < D_i < mu + std_ratio * sigma: it removes points with enough exact duplicates, and
    all points when their D_i are equal.
    """
    if len(xyz_m) <= neighbours:
        return np.zeros(len(xyz_m), dtype=np.bool_)
    mean_m = mean_neighbour_distances(xyz_m, neighbours)
    limit_m = mean_m.mean() + std_ratio * mean_m.std(ddof=1)
    outlier: NDArray[np.bool_] = mean_m > limit_m * (1.0 + ROUNDING)
    return outlier
