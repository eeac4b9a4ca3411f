"""Legal steps on a grid, and what IA* keeps of the previous plan's route: from the robot to the waypoint from which it
searches on.
"""

from __future__ import annotations

import numpy as np

from quadlog.compiled import inlined, inner

# A robot that follows a smooth path is rarely farther than this from the cells it was planned on.
REANCHOR_CELLS = 5


@inlined
def _is_open(blocked, col, row, from_col, from_row, cutting):  # type: ignore[no-untyped-def]
    """Whether a step between neighbouring cells is allowed: its end is free, and so are both cells it passes."""
    if blocked[row, col]:
        return False
    # Beside a straight step these are the two cells it joins: free, or it would not have come to this.
    return cutting or not (blocked[row, from_col] or blocked[from_row, col])


@inner
def link(blocked, col, row, to_col, to_row, diagonal_first, cutting, cells):  # type: ignore[no-untyped-def]
    """Writes the cells of a direct way without its last one: how many, -1 when it is not free.

    A direct way has its diagonal steps on one side, its straight ones on the other.
    """
    steps, count = max(abs(to_col - col), abs(to_row - row)), 0
    diagonals = min(abs(to_col - col), abs(to_row - row))
    is_wide = abs(to_col - col) > abs(to_row - row)
    while count < steps:
        is_diagonal = count < diagonals if diagonal_first else count >= steps - diagonals
        next_col, next_row = col, row
        if is_diagonal or is_wide:
            next_col += 1 if to_col > col else -1
        if is_diagonal or not is_wide:
            next_row += 1 if to_row > row else -1
        if not _is_open(blocked, next_col, next_row, col, row, cutting):
            return -1
        cells[count, 0], cells[count, 1] = col, row
        col, row, count = next_col, next_row, count + 1
    return count


@inner
def anchor(blocked, route, dcol, drow, col, row, cutting, units, cells):  # type: ignore[no-untyped-def]
    """(index in the route where a robot in a cell gets onto it, cells of the way there), -1 when it is lost.

    That is the robot's own cell where it is on the route. Else it is the one, no more than REANCHOR_CELLS away, that
    makes the way over it to the route's end the shortest; it must be reached directly. That way, its last cell left
    out, becomes cells' first rows. Arguments as in kept_route.
    """
    rows, cols = blocked.shape
    best, best_cost, best_order, g = -1, 0, 0, 0
    for i in range(len(route)):
        at_col, at_row = route[i, 0] - dcol, route[i, 1] - drow
        if at_col == col and at_row == row:
            return i, 0
        if i > 0:
            is_diagonal = route[i, 0] != route[i - 1, 0] and route[i, 1] != route[i - 1, 1]
            g += units[1] if is_diagonal else units[0]
        across, along = abs(at_col - col), abs(at_row - row)
        if max(across, along) > REANCHOR_CELLS or at_col < 0 or at_row < 0 or at_col >= cols or at_row >= rows:
            continue
        cost = units[0] * abs(across - along) + units[1] * min(across, along) - g
        if best >= 0 and cost >= best_cost:
            continue
        for order in range(2):
            if link(blocked, col, row, at_col, at_row, order == 0, cutting, cells) >= 0:
                best, best_cost, best_order = i, cost, order
                break
    if best < 0:
        return -1, 0
    at_col, at_row = route[best, 0] - dcol, route[best, 1] - drow
    return best, link(blocked, col, row, at_col, at_row, best_order == 0, cutting, cells)


@inner
def kept_route(blocked, route, dcol, drow, start, goal, cutting, units, cells, from_end=False):  # type: ignore[no-untyped-def]
    """(cells kept, those of them that are new, their straight and diagonal steps); none when the route is of no use.

    route (L, 2), its window moved since by (dcol, drow): what is left of it for a robot at start, up to where it
    leaves the window. When a step of that is blocked now, nothing is kept. It is kept up to its waypoint, by
    f = g + (|dx| + |dy|) straight steps [Planning, eq. 2-4, with the unit of eq. 3 as the erratum has it: without it f
    rises at every step, and nothing would ever be kept]: the cell of least f, among equals the last; from_end: the
    cell that is reached by walking back from the end while f falls.
    start, goal (col, row) in the window; units: of a straight and a diagonal step; cells: the kept ones are written
    to its first rows, of which there must be len(route) + REANCHOR_CELLS.
    """
    rows, cols = blocked.shape
    first, linking = anchor(blocked, route, dcol, drow, start[0], start[1], cutting, units, cells)
    if first < 0:
        return 0, 0, 0, 0
    count = linking
    for i in range(first, len(route)):
        col, row = route[i, 0] - dcol, route[i, 1] - drow
        if col < 0 or row < 0 or col >= cols or row >= rows:
            break
        before_col, before_row = (cells[count - 1, 0], cells[count - 1, 1]) if count > 0 else (col, row)
        if not _is_open(blocked, col, row, before_col, before_row, cutting):
            return 0, 0, 0, 0
        cells[count, 0], cells[count, 1] = col, row
        count += 1
    straights, diagonals = 0, 0
    kept, kept_straights, kept_diagonals, kept_f, f_before = 0, 0, 0, 0, 0
    for i in range(count):
        col, row = cells[i, 0], cells[i, 1]
        if i > 0:
            is_diagonal = col != cells[i - 1, 0] and row != cells[i - 1, 1]
            diagonals += is_diagonal
            straights += not is_diagonal
        to_go = abs(goal[0] - col) + abs(goal[1] - row)
        f = units[0] * (straights + to_go) + units[1] * diagonals
        if i == 0 or f <= (f_before if from_end else kept_f):
            kept, kept_straights, kept_diagonals, kept_f = i + 1, straights, diagonals, f
        f_before = f
    return kept, linking, kept_straights, kept_diagonals


@inner
def join(way, length, kept_cells, kept):  # type: ignore[no-untyped-def]
    """Puts the kept cells, but for the waypoint, before the path in way's last rows: how many it has now.

    0 when there is no path; -1 when there is no room, for a route that goes round in circles.
    """
    if length == 0:
        return 0
    first = len(way) - length - kept + 1
    if first < 0:
        return -1
    for i in range(kept - 1):
        way[first + i, 0], way[first + i, 1] = kept_cells[i, 0], kept_cells[i, 1]
    return length + kept - 1


# East, north, west, south, then the diagonals between them: north-east, north-west, south-west, south-east.
# Straight steps come first, because among equal f they lead to the smaller g.
STEP_COL = np.array([1, 0, -1, 0, 1, -1, -1, 1])
STEP_ROW = np.array([0, 1, 0, -1, 1, 1, -1, -1])
STEP_COST = np.array([10, 10, 10, 10, 14, 14, 14, 14])
FIRST_DIAGONAL = 4


@inlined
def octile(dcol: int, drow: int) -> int:
    """Cost of the way over free cells: 14 for each diagonal step, 10 for the rest."""
    across, along = abs(dcol), abs(drow)
    # The same as 10 max + 4 min, in fewer branches.
    return 7 * (across + along) + 3 * abs(across - along)


@inlined
def legal_steps(padded, cell, width, corner_cutting):  # type: ignore[no-untyped-def]
    """The steps allowed from a cell, as bits 0..7 in STEP_COL's order. Unsigned indices spare numba's wrap-around."""
    here, up, one = np.uint64(cell), np.uint64(width), np.uint64(1)
    east, north, west, south = padded[here + one], padded[here + up], padded[here - one], padded[here - up]
    north_east, north_west = padded[here + up + one], padded[here + up - one]
    south_west, south_east = padded[here - up - one], padded[here - up + one]
    if not corner_cutting:
        north_east |= north | east
        north_west |= north | west
        south_west |= south | west
        south_east |= south | east
    straight = east | north << 1 | west << 2 | south << 3
    return 255 - (straight | north_east << 4 | north_west << 5 | south_west << 6 | south_east << 7)
