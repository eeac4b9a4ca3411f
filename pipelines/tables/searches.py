"""Walks led by planners, and what A* and IA* search on the way: the planning tables' presets, forests and figures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quadlog.pipelines.comparison.problems import ProblemSource
from quadlog.pipelines.comparison.run_planners import ask_everything
from quadlog.pipelines.comparison.sources import questions_along
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.tables.study import HELD_OUT_SEED, Figures
from quadlog.planning.registry import make_planner
from quadlog.planning.rules import Rules
from quadlog.simulation.worlds.replanning_walk import Outcome, WorldWalk, walk_world
from quadlog.simulation.worlds.scenes import forest_world
from quadlog.simulation.worlds.world import WINDOW_CELLS, World

DENSITIES_PER_M2 = (0.1, 0.2)
"""The papers print no trees: these are ours."""
CLAIMED = 5.0
"""Both papers say that IA* is more than so many times as efficient."""


@dataclass(frozen=True, slots=True)
class Preset:
    """As `quadlog compare-planners --preset` has it: rules, baseline, whose plans are walked, what counts as a cell.

    dilation: of `inflation.INFLATIONS`. ia_star: by which reading of its waypoint IA* plans.
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
    if walk.outcome is not Outcome.ARRIVED:
        return {"arrived": 0.0}
    source = ProblemSource("walk", "walk", lambda: iter([questions_along(world, walk)]), 1)
    names = (preset.baseline, preset.ia_star)
    columns = ask_everything(source, names, preset.rules, Silent(), curvatures=False).columns
    astar, ia_star = (float(columns[preset.counted][columns["planner"] == name].sum()) for name in names)
    ratio = astar / max(ia_star, 1.0)
    found = {"arrived": 1.0, "replans": float(len(walk.instants)), "cells_astar": astar, "cells_ia_star": ia_star}
    return found | {"ratio": ratio, "above": float(ratio > CLAIMED)}
