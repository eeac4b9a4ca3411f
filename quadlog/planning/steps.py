"""The eight steps from a cell, and which of them a map allows: shared by the compiled searches."""

from __future__ import annotations

import numpy as np

from quadlog.compiled import inlined

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
