"""Tables 1 and 2 of [Planning] as printed, run by run, and what follows from them by arithmetic."""

from __future__ import annotations

import numpy as np

LENGTH_M = np.array(
    [
        [26.59, 21.53, 20.03, 21.33, 22.74, 17.52, 21.87, 17.89, 19.03, 15.33],
        [26.53, 21.38, 19.90, 21.51, 23.02, 16.95, 21.21, 17.48, 18.49, 14.63],
    ]
)
"""Table 1, (2, 10): of A* and of IA*."""
TIME_S = np.array(
    [
        [90.2, 73.71, 73.0, 71.34, 80.31, 64.12, 75.73, 62.24, 65.71, 59.24],
        [96.2, 78.46, 75.3, 72.31, 83.43, 68.54, 79.56, 64.45, 65.39, 55.43],
    ]
)
"""Table 1, (2, 10): of A* and of IA*."""
CELLS = np.array(
    [
        [39257, 38128, 38319, 53006, 41264, 42973, 23180, 41864, 19185],
        [5510, 4435, 4071, 9035, 5610, 3712, 4177, 5861, 3120],
    ]
)
"""Table 2, (2, 9): searched by A* and by IA*."""
PRINTED_RATIO = np.array([7.12, 8.60, 9.41, 5.86, 7.35, 11.57, 5.5, 7.14, 6.15])
"""Table 2, (9,): of the cells. Three are cut off, not rounded, and one has a single digit."""
CELL_RATIO = CELLS[0] / CELLS[1]
"""(9,) what the printed totals give."""
LENGTH_RUNS, CELL_RUNS = LENGTH_M.shape[1], CELLS.shape[1]
