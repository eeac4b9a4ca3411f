"""planning-2: cells that A* and IA* search on walks through forests [Planning, Table 2].

Its presets, forests and figures are also those of the other tables on planning.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quadlog.pipelines.comparison.compare import ask_everything
from quadlog.pipelines.comparison.sources import ProblemSource, questions_along
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.tables.claims import HELD_OUT_SEED, Claim, Figures, Group, Study, StudyTable, grid
from quadlog.pipelines.tables.judge import MEDIAN, SHARE, extreme, not_comparable, runs
from quadlog.planning.registry import make_planner
from quadlog.planning.rules import Rules
from quadlog.simulation.worlds.replanning_walk import WorldWalk, walk_world
from quadlog.simulation.worlds.scenes import forest_world
from quadlog.simulation.worlds.world import WINDOW_CELLS, World

DENSITIES_PER_M2 = (0.1, 0.2)
"""The papers print no trees: these are ours."""
CLAIMED = 5.0
"""Both papers say that IA* is more than so many times as efficient."""


@dataclass(frozen=True, slots=True)
class Preset:
    """As `quadlog compare-planners --preset` has it: rules, baseline, whose plans are walked, what counts as a cell.

    dilation: of `goal_projection.INFLATIONS`. ia_star: by which reading of its waypoint IA* plans.
    """

    rules: Rules
    baseline: str
    leader: str
    counted: str
    dilation: str
    ia_star: str = "ia_star"

    @property
    def words(self) -> str:
        """How it plans."""
        return (
            f"{self.baseline} against {self.ia_star}, where {READINGS[self.ia_star]}, by the rules: {self.rules}; "
            f"{self.counted} cells count; obstacles grown by 3 cells ({self.dilation})."
        )


PAPER = Preset(Rules(heuristic="manhattan"), "astar_paper", "ia_star", "generated", "square")
PRESETS = {
    "paper": PAPER,
    "paper, from the end": replace(PAPER, leader="ia_star_end", ia_star="ia_star_end"),
    "honest": Preset(Rules(), "astar", "astar", "expanded", "euclidean"),
}
FAST_PRESETS = ("paper", "honest")
READINGS = {
    "ia_star": "the waypoint is the cell of least f of the whole old route",
    "ia_star_end": "the waypoint is sought by walking back from the end of the old route while f falls",
}
"""Both are what [Planning, section 2.2] may mean by \"searched out from the end vertex\"."""


def forest_of(density_per_m2: float, number: int, dilation: str, seed: int, window_cells: int = WINDOW_CELLS) -> World:
    """One of the held-out forests, the same for every preset but for the growth."""
    rng = np.random.default_rng([HELD_OUT_SEED + seed, number, *b"planning forest"])
    return forest_world(density_per_m2, rng, window_cells=window_cells, dilation=dilation)


def lead(world: World, preset: Preset) -> WorldWalk:
    """The walk of the preset's leader, one cell a replan."""
    return walk_world(world, make_planner(preset.leader, preset.rules))


def cells(world: World, walk: WorldWalk, preset: Preset) -> Figures:
    """What both planners spend on the questions of a walk; one that does not arrive has no ratio.

    A walk that turns in a ring has no end, and the papers print whole ways.
    """
    if not walk.arrived:
        return {"arrived": 0.0}
    source = ProblemSource("walk", "walk", lambda: iter([questions_along(world, walk)]), 1)
    names = (preset.baseline, preset.ia_star)
    columns = ask_everything(source, names, preset.rules, Silent())
    astar, ia_star = (float(columns[preset.counted][columns["planner"] == name].sum()) for name in names)
    ratio = astar / max(ia_star, 1.0)
    found = {"arrived": 1.0, "replans": float(len(walk.instants)), "cells_astar": astar, "cells_ia_star": ia_star}
    return found | {"ratio": ratio, "above": float(ratio > CLAIMED)}


CELLS = np.array(
    [
        [39257, 38128, 38319, 53006, 41264, 42973, 23180, 41864, 19185],
        [5510, 4435, 4071, 9035, 5610, 3712, 4177, 5861, 3120],
    ]
)
"""Table 2, (2, 9): searched by A* and by IA*."""
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


def table(fast: bool, seed: int) -> StudyTable:
    """Fast walks as often as the paper and no more, by one reading of IA*'s waypoint."""
    walks, presets = (len(RUNS), FAST_PRESETS) if fast else (40, PRESETS)
    points = grid(preset=presets, density_per_m2=DENSITIES_PER_M2, number=range(walks), seed=[seed])
    return StudyTable(
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
