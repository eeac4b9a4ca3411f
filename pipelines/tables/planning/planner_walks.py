"""What planners spend on the same walks: presets, held-out seeds, totals of cells, and pictures of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float
from quadlog.metrics.intervals import FEWEST_VALUES, RESAMPLES
from quadlog.metrics.planning import Comparison, PlannerRow, compare_planners
from quadlog.pipelines.comparison.problems import Episode, ProblemSource
from quadlog.pipelines.comparison.run_planners import ask_everything
from quadlog.pipelines.comparison.sources import questions_along
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.tables.intervals import bootstrap_statistic
from quadlog.planning.registry import PLANNERS, make_planner
from quadlog.planning.rules import Rules
from quadlog.results.page.planners import question_panel
from quadlog.results.papers.table import PaperRow, Verdict
from quadlog.results.view import Panel, Spread, forest
from quadlog.simulation.worlds.replanning_walk import Outcome, walk_world
from quadlog.simulation.worlds.scenes import forest_world
from quadlog.simulation.worlds.world import WINDOW_CELLS, World

Columns = dict[str, NDArray[Any]]

HELD_OUT_SEED = 2000
"""Seeds of the planning tables start here; whatever was looked at before was drawn from smaller ones."""
DENSITIES_PER_M2 = (0.1, 0.2)
"""The papers print no trees: these are ours."""


@dataclass(frozen=True, slots=True)
class Preset:
    """As `quadlog compare-planners --preset` has it: rules, baseline, whose plans are walked, what counts as a cell.

    dilation: of `inflation.INFLATIONS`. ia_star: by which reading of its waypoint IA* plans.
    """

    name: str
    rules: Rules
    baseline: str
    leader: str
    counted: str
    dilation: str
    ia_star: str = "ia_star"


PAPER = Preset("paper", Rules(heuristic="manhattan"), "astar_paper", "ia_star", "generated", "square")
PAPER_END = replace(PAPER, name="paper, from the end", leader="ia_star_end", ia_star="ia_star_end")
HONEST = Preset("honest", Rules(), "astar", "astar", "expanded", "euclidean")
PRESETS = (PAPER, PAPER_END, HONEST)
READINGS = {
    "ia_star": "the waypoint is the cell of least f of the whole old route",
    "ia_star_end": "the waypoint is sought by walking back from the end of the old route while f falls",
}
"""Both are what [Planning, section 2.2] may mean by \"searched out from the end vertex\"."""


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

    source = ProblemSource(preset.name, preset.name, walks, len(worlds))
    columns = ask_everything(source, (preset.baseline, *names), preset.rules, Silent(), curvatures=False).columns
    episode, cells = columns["episode"], columns[preset.counted]
    baseline, ia_star = (columns["planner"] == name for name in (preset.baseline, preset.ia_star))
    left_out = tuple(
        float(cells[baseline & (episode == lost)].sum() / max(cells[ia_star & (episode == lost)].sum(), 1))
        for lost in np.flatnonzero(~np.array(arrived)).tolist()
    )
    whole = np.array(arrived)[episode]
    columns = {name: column[whole] for name, column in columns.items()}
    return Spent(columns, _compare(columns, preset.baseline, preset.counted, seed), len(worlds), left_out)


def extreme_row(
    quantity: str, printed: Float, ours: Float, smallest: bool, contrary: float, rng: np.random.Generator
) -> PaperRow:
    """The smallest or largest of as many runs as the paper prints (R,): ours is its mean over tables of R of our runs.

    ours (N,): of independent runs. The printed one is that of a single table: it fails where it lies outside of what
    95 % of the tables drawn from our runs have. It reproduces where the interval of ours holds it and leaves out the
    contrary, of FEWEST_VALUES runs or more.
    """
    extreme = np.min if smallest else np.max
    tables = extreme(ours[rng.integers(len(ours), size=(RESAMPLES, len(printed)))], axis=1)
    low, high = np.percentile(tables, [2.5, 97.5])
    rank = np.arange(len(ours) + 1) / len(ours)
    # The chance of each of our runs, in order, to be the extreme one of R that are drawn.
    weights = np.diff(1 - (1 - rank) ** len(printed) if smallest else rank ** len(printed))

    def mean_extreme(values: Float, axis: int) -> Float:
        mean: Float = np.sort(values, axis=axis) @ weights
        return mean

    value, interval = bootstrap_statistic(ours, mean_extreme, rng)
    paper = float(extreme(printed))
    is_clear = not interval[0] <= contrary <= interval[1]
    verdict = Verdict.YES if is_clear and interval[0] <= paper <= interval[1] else Verdict.UNDECIDED
    if not low <= paper <= high:
        verdict = Verdict.NO
    if len(ours) < FEWEST_VALUES:
        verdict = Verdict.UNDECIDED
    spread = f"95 % of tables of {len(printed)} of our runs have {low:.2f} to {high:.2f}"
    note = f"{spread}; the {'least' if smallest else 'largest'} of all {len(ours)} is {extreme(ours):.2f}."
    return PaperRow(quantity, value, paper, *interval, verdict, note)


def _compare(columns: Columns, baseline: str, counted: str, seed: int) -> Comparison:
    rng = np.random.default_rng([HELD_OUT_SEED + seed, *b"intervals"])
    incremental = [name for name, planner in PLANNERS.items() if planner.incremental]
    return compare_planners(columns, rng, baseline, counted, incremental)


def ratio_panel(spent: Mapping[str, tuple[Spent, str]], printed: Mapping[str, Float], what: str) -> Panel:
    """A row for each label's (source, planner) and for each printed table: its ratios, their median and interval."""
    rows = {label: Spread(float(np.median(of_runs)), None, of_runs, "text") for label, of_runs in printed.items()}
    for label, (of, planner) in spent.items():
        row = of.row(planner)
        assert row.ratio_expanded is not None
        interval = None if row.ratio_low is None or row.ratio_high is None else (row.ratio_low, row.ratio_high)
        rows[label] = Spread(row.ratio_expanded, interval, of.ratios(planner))
    return forest(what, rows, "A* / planner", log=True, marks=[1.0])


def first_run_panel(spent: Spent, what: str) -> Panel:
    """Cells of every planner in each replan of the first run [Planning, Fig. 18]."""
    columns, first = spent.columns, spent.columns["episode"] == 0
    cells = {row.planner: columns[spent.comparison.counted][first & (columns["planner"] == row.planner)]
             for row in spent.comparison.rows}  # fmt: skip
    return question_panel(what, cells, "replan")


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
