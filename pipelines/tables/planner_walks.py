"""What planners spend on the same walks: presets, held-out seeds, and totals of cells episode by episode."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float
from quadlog.metrics.planner_comparison import Comparison, PlannerRow, compare_planners
from quadlog.pipelines.comparison.asking import ask_everything
from quadlog.pipelines.comparison.forest_source import questions_along
from quadlog.pipelines.comparison.source import Episode, Source
from quadlog.pipelines.progress import Silent
from quadlog.pipelines.tables.judging import Interval
from quadlog.planning.registry import PLANNERS, make_planner
from quadlog.planning.rules import Rules
from quadlog.simulation.planning_forest import forest_world
from quadlog.simulation.planning_walk import Outcome, walk_world
from quadlog.simulation.planning_worlds import WINDOW_CELLS, World

Columns = dict[str, NDArray[Any]]

HELD_OUT_SEED = 2000
"""Seeds of the planning tables start here; whatever was looked at before was drawn from smaller ones."""
DENSITIES_PER_M2 = (0.1, 0.2)
"""The papers print no trees: these are ours."""
RESAMPLES = 2000


@dataclass(frozen=True, slots=True)
class Preset:
    """As `quadlog compare-planners --preset` has it: rules, baseline, whose plans are walked, what counts as a cell.

    dilation: of `inflation.INFLATIONS`.
    """

    name: str
    rules: Rules
    baseline: str
    leader: str
    counted: str
    dilation: str


PAPER = Preset("paper", Rules(heuristic="manhattan"), "astar_paper", "ia_star", "generated", "square")
HONEST = Preset("honest", Rules(), "astar", "astar", "expanded", "euclidean")
PRESETS = (PAPER, HONEST)


@dataclass(frozen=True)
class Spent:
    """The answers of several planners on walks that arrived: columns of replans.parquet, and how they compare.

    walks: how many set out. left_out: cells of the baseline / cells of IA* on each walk that did not arrive.
    """

    columns: Columns
    comparison: Comparison
    walks: int
    left_out: tuple[float, ...]

    def ratios(self, planner: str) -> Float:
        """(E,) cells of the baseline / cells of the planner, walk by walk; one without cells is left out."""
        ratios = self.comparison.episode_ratios[planner]
        finite: Float = ratios[np.isfinite(ratios)]
        return finite

    def cells(self, planner: str) -> Float:
        """(E,) cells that a planner spent on each walk."""
        mine = self.columns["planner"] == planner
        _, episode = np.unique(self.columns["episode"][mine], return_inverse=True)
        return np.bincount(episode, self.columns[self.comparison.counted][mine]).astype(np.float64)

    def row(self, planner: str) -> PlannerRow:
        """The planner's figures over all walks."""
        return next(row for row in self.comparison.rows if row.planner == planner)

    @property
    def arrived(self) -> int:
        """Walks that came to their goal."""
        return self.comparison.rows[0].episodes

    @property
    def replans(self) -> float:
        """Replans of a walk, on average."""
        return self.comparison.rows[0].replans / self.arrived

    def counting(self, counted: str, seed: int) -> Spent:
        """The same answers with something else for a cell."""
        return Spent(self.columns, _compare(self.columns, self.comparison.baseline, counted, seed), self.walks, ())


def forest_of(density_per_m2: float, number: int, preset: Preset, seed: int, window_cells: int = WINDOW_CELLS) -> World:
    """One of the held-out forests, the same for every preset but for the growth."""
    rng = np.random.default_rng([HELD_OUT_SEED + seed, number, *b"planning forest"])
    return forest_world(density_per_m2, rng, window_cells=window_cells, dilation=preset.dilation)


def spend(
    worlds: Sequence[World], preset: Preset, names: Sequence[str], leader: str, seed: int, cells_per_replan: int = 1
) -> Spent:
    """Walk through each world, led by one planner, and put every question on the way to all, the baseline first.

    A walk that does not arrive is left out: the papers print whole ways, and one that turns in a ring has no end.
    """
    arrived: list[bool] = []

    def walks() -> Iterator[Episode]:
        for world in worlds:
            walk = walk_world(world, make_planner(leader, preset.rules), cells_per_replan=cells_per_replan)
            arrived.append(walk.outcome is Outcome.ARRIVED)
            yield questions_along(world, walk)

    source = Source(preset.name, preset.name, walks, len(worlds))
    columns = ask_everything(source, (preset.baseline, *names), preset.rules, Silent(), curvatures=False).columns
    episode, cells = columns["episode"], columns[preset.counted]
    baseline, ia_star = (columns["planner"] == name for name in (preset.baseline, "ia_star"))
    left_out = tuple(
        float(cells[baseline & (episode == lost)].sum() / max(cells[ia_star & (episode == lost)].sum(), 1))
        for lost in np.flatnonzero(~np.array(arrived)).tolist()
    )
    whole = np.array(arrived)[episode]
    columns = {name: column[whole] for name, column in columns.items()}
    return Spent(columns, _compare(columns, preset.baseline, preset.counted, seed), len(worlds), left_out)


def of_printed_runs(
    values: Float, runs: int, statistic: Callable[..., Any], rng: np.random.Generator
) -> tuple[float, Interval]:
    """A statistic of as many runs as the paper prints: of the first, and where 95 % of such tables would have it.

    values (E,): of independent episodes; statistic: numpy's, with an axis. Tables are drawn from all E.
    """
    drawn = values[rng.integers(len(values), size=(RESAMPLES, runs))]
    low, high = np.percentile(statistic(drawn, axis=1), [2.5, 97.5])
    return float(statistic(values[:runs], axis=0)), (float(low), float(high))


def _compare(columns: Columns, baseline: str, counted: str, seed: int) -> Comparison:
    rng = np.random.default_rng([HELD_OUT_SEED + seed, *b"intervals"])
    incremental = [name for name, planner in PLANNERS.items() if planner.incremental]
    return compare_planners(columns, rng, baseline, counted, incremental)
