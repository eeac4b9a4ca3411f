"""What IA* keeps of the previous plan's route: from the robot to the waypoint from which it searches on."""

from __future__ import annotations

from quadlog.compiled import inlined, inner, kernel

REANCHOR_CELLS = 5
"""A robot that follows a smooth path is rarely farther than this from the cells it was planned on."""
ROOM_CELLS = REANCHOR_CELLS
"""The cells kept are at most so many more than the route's."""


@inlined
def _is_open(blocked, col, row, from_col, from_row, cutting):  # type: ignore[no-untyped-def]
    """Whether a step between neighbouring cells is allowed: its end is free, and so are both cells it passes."""
    if blocked[row, col]:
        return False
    # Beside a straight step these are the two cells it joins: free, or it would not have come to this.
    return cutting or not (blocked[row, from_col] or blocked[from_row, col])


@inner
def _link(blocked, col, row, to_col, to_row, diagonal_first, cutting, cells):  # type: ignore[no-untyped-def]
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
def _anchor(blocked, route, dcol, drow, col, row, cutting, straight, diagonal, cells):  # type: ignore[no-untyped-def]
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
            g += diagonal if is_diagonal else straight
        across, along = abs(at_col - col), abs(at_row - row)
        if max(across, along) > REANCHOR_CELLS or at_col < 0 or at_row < 0 or at_col >= cols or at_row >= rows:
            continue
        cost = straight * abs(across - along) + diagonal * min(across, along) - g
        if best >= 0 and cost >= best_cost:
            continue
        for order in range(2):
            if _link(blocked, col, row, at_col, at_row, order == 0, cutting, cells) >= 0:
                best, best_cost, best_order = i, cost, order
                break
    if best < 0:
        return -1, 0
    at_col, at_row = route[best, 0] - dcol, route[best, 1] - drow
    return best, _link(blocked, col, row, at_col, at_row, best_order == 0, cutting, cells)


@kernel
def kept_route(blocked, route, asked, cells):  # type: ignore[no-untyped-def]
    """(cells kept, those of them that are new, their diagonal steps, the last of them, the goal); 0 when the route is
    of no use. The last two are flat indices in the grid with a border of one cell.

    route (L, 2), its window moved since by (dcol, drow): what is left of it for a robot at start, up to where it
    leaves the window. When a step of that is blocked now, nothing is kept. It is kept up to its waypoint, by
    f = g + (|dx| + |dy|) straight steps [Planning, eq. 2-4, with the unit of eq. 3 as the erratum has it: without it f
    rises at every step, and nothing would ever be kept]: the cell of least f, among equals the last; from_end: the
    cell that is reached by walking back from the end while f falls.
    asked: (dcol, drow, start's col and row, goal's col and row, whether corners are cut, costs of a straight and a
    diagonal step, from_end); cells: the kept ones are written to its first rows, of which there must be len(route) +
    ROOM_CELLS.
    """
    dcol, drow, col, row, goal_col, goal_row, cutting, straight, diagonal, from_end = asked
    rows, cols = blocked.shape
    for at_col, at_row in ((col, row), (goal_col, goal_row)):
        if at_col < 0 or at_row < 0 or at_col >= cols or at_row >= rows or blocked[at_row, at_col]:
            return 0, 0, 0, 0, 0
    first, linking = _anchor(blocked, route, dcol, drow, col, row, cutting, straight, diagonal, cells)
    if first < 0:
        return 0, 0, 0, 0, 0
    count = linking
    for i in range(first, len(route)):
        col, row = route[i, 0] - dcol, route[i, 1] - drow
        if col < 0 or row < 0 or col >= cols or row >= rows:
            break
        before_col, before_row = (cells[count - 1, 0], cells[count - 1, 1]) if count > 0 else (col, row)
        if not _is_open(blocked, col, row, before_col, before_row, cutting):
            return 0, 0, 0, 0, 0
        cells[count, 0], cells[count, 1] = col, row
        count += 1
    diagonals, kept, kept_diagonals, kept_f, f_before = 0, 0, 0, 0, 0
    for i in range(count):
        col, row = cells[i, 0], cells[i, 1]
        if i > 0:
            diagonals += col != cells[i - 1, 0] and row != cells[i - 1, 1]
        to_go = abs(goal_col - col) + abs(goal_row - row)
        f = straight * (i - diagonals + to_go) + diagonal * diagonals
        if i == 0 or f <= (f_before if from_end else kept_f):
            kept, kept_diagonals, kept_f = i + 1, diagonals, f
        f_before = f
    last = (cells[kept - 1, 1] + 1) * (cols + 2) + cells[kept - 1, 0] + 1
    return kept, linking, kept_diagonals, last, (goal_row + 1) * (cols + 2) + goal_col + 1


@inlined
def join(way, length, kept_cells, kept):  # type: ignore[no-untyped-def]
    """Puts the kept cells, but for the waypoint, before the path in way's last rows: how many it has now.

    0 when there is no path; -1 when there is no room, for a route that goes round in circles.
    """
    first = len(way) - length - kept + 1
    if length == 0 or first < 0:
        return 0 if length == 0 else -1
    for i in range(kept - 1):
        way[first + i, 0], way[first + i, 1] = kept_cells[i, 0], kept_cells[i, 1]
    return length + kept - 1
