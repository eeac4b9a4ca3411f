"""planning-2: cells that A* and IA* search on walks through forests [Planning, Table 2]."""

from __future__ import annotations

import numpy as np

from quadlog.pipelines.tables.claims import Claim, Group, Table
from quadlog.pipelines.tables.judge import MEDIAN, SHARE, extreme, not_comparable, runs
from quadlog.pipelines.tables.searches import (
    CLAIMED,
    DENSITIES_PER_M2,
    PRESETS,
    cells,
    forest_of,
    lead,
)
from quadlog.pipelines.tables.study import Figures, Study, grid

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
RUNS = tuple(CELL_RATIO.tolist())
UNKNOWN = "The paper does not say how many replans a run has, nor how long its runs are."


def through_forest(preset: str, density_per_m2: float, number: int, seed: int) -> Figures:
    """A walk through a held-out forest."""
    of = PRESETS[preset]
    world = forest_of(density_per_m2, number, of.dilation, seed)
    return cells(world, lead(world, of), of)


def rows(preset: str, density: float) -> list[Claim]:
    """Table 2 by one preset in one forest."""
    where, which = {"preset": preset, "density_per_m2": density}, f"{preset}, {density:g} trees/m²"
    found = []
    for name, smallest in (("smallest", True), ("largest", False)):
        judge = runs(RUNS, min(RUNS) if smallest else max(RUNS), CLAIMED)
        quantity = f"{which}: {name} ratio A*/IA* of nine runs (1)"
        found.append(Claim(quantity, "ratio", where, judge, extreme(len(RUNS), smallest), of=f"{name} ratio"))
    median = runs(RUNS, float(np.median(RUNS)), CLAIMED)
    found.append(Claim(f"{which}: median ratio A*/IA* (1)", "ratio", where, median, MEDIAN, of="median ratio"))
    above = f"{which}: share of runs with a ratio above {CLAIMED:g} (1)"
    claimed = runs((1.0,) * len(RUNS), 1.0, 0.5, "all")
    found.append(Claim(above, "above", where, claimed, SHARE, of="more than 5 times"))
    for row, (name, column) in enumerate((("A*", "cells_astar"), ("IA*", "cells_ia_star"))):
        judge_ = not_comparable(float(CELLS[row].mean()), UNKNOWN)
        found.append(Claim(f"{which}: cells of {name} a run, mean (1)", column, where, judge_, of=f"cells of {name}"))
    return [
        *found,
        Claim(f"{which}: replans of a run, mean (1)", "replans", where),
        Claim(f"{which}: share of walks that arrive (1)", "arrived", where, statistic=SHARE),
    ]


def table(fast: bool, seed: int) -> Table:
    """Fast walks as often as the paper and no more."""
    walks = len(RUNS) if fast else 40
    points = grid(preset=PRESETS, density_per_m2=DENSITIES_PER_M2, number=range(walks), seed=[seed])
    return Table(
        title="Cells that A* and IA* search [Planning, Table 2]",
        caption="A robot walks through a forest towards a goal 15 to 25 m away, sees a window of 40 by 40 cells of "
        "0.1 m and replans after every cell. The paper prints nine runs in a forest of its own. Its trees, ties and "
        "what it counts are not printed: ours stand at random, 0.1 or 0.2 to a square metre. Preset `paper` takes the "
        "printed heuristic, `honest` an A* that spends as little as it can. One planner leads, both answer the same "
        "questions.",
        sizes=f"{walks} walks through each forest by each preset, seed {seed}.",
        study=Study(through_forest, points),
        groups=[
            Group(
                f"Table 2, preset {preset}",
                f"{PRESETS[preset].words} Two samples are compared, ours and the printed nine, by permutations. "
                "Intervals: of the median by order statistics; of the smallest and largest, what 95 % of tables of "
                "nine of our runs have; shares after Wilson; means after Student.",
                [row for density in DENSITIES_PER_M2 for row in rows(preset, density)],
            )
            for preset in PRESETS
        ],
    )
