"""What planners did: of one run's replans, and of several planners on the same replans of one source.

Two kinds of figures. What a planner was asked for and what work it did is over
all its replans: `replans`, `success_rate`, the totals and the mean of cells
(a search that floods the window before it fails is work too), `fallback_share`.
What compares planners is paired, over the replans that all of them solved,
because a planner that gives up on the hard ones would look cheap and short:
ratio, sub-optimality, times, lengths, turns.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float, Int
from quadlog.metrics.intervals import Interval, median_interval, ratio_interval_in_time
from quadlog.metrics.metric import Metric, Metrics
from quadlog.metrics.summary import Samples, finite_samples
from quadlog.planning.protocol import Bool

COUNTS = ("expanded", "generated", "touched")
# √2 summed in another order is the same cost.
ROUNDING = 1e-9

Table = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class PlannerRow:
    """One row of planners.parquet: figures of one planner on one source; None where one does not apply.

    ratio_expanded: cells of the baseline / cells of this planner, the median over episodes; above 1 is better.
    ratio_low, ratio_high: its 95 % interval. suboptimality: cost / optimal cost - 1.
    fallback_share: of the replans but the first of each episode, those that an incremental planner began from scratch.
    """

    source: str
    planner: str
    episodes: int
    replans: int
    success_rate: float
    expanded_total: int
    generated_total: int
    touched_total: int
    expanded_mean: float
    ratio_expanded: float | None
    ratio_low: float | None
    ratio_high: float | None
    suboptimality_mean: float | None
    suboptimality_p95: float | None
    fallback_share: float | None
    us_median: float | None
    us_p95: float | None
    length_m_total: float | None
    turn_rad_total: float | None


@dataclass(frozen=True, slots=True)
class Comparison:
    """The rows of one source, in the order in which its planners came, and what they rest on.

    counted: which of COUNTS is a cell in the ratio. baseline: what the ratio compares with, perhaps no row at all.
    paired_replans: those that all planners solved; paired_episodes: those E that have any.
    episode_ratios: per planner (E,), in order of episodes. NaN where the planner spent no cell: such an episode has no
    finite ratio, and is left out of the median and the interval, which can only make the planner look worse.
    """

    source: str
    rows: tuple[PlannerRow, ...]
    baseline: str
    counted: str
    paired_replans: int
    paired_episodes: int
    episode_ratios: Mapping[str, Float]


@dataclass(frozen=True, slots=True)
class _Aligned:
    """The table with a line per planner and a column per replan, in order of episode and replan: (P, R) each."""

    source: str
    planners: tuple[str, ...]
    columns: Mapping[str, NDArray[Any]]
    paired: Bool  # (R,)

    @property
    def episode(self) -> NDArray[np.int64]:
        """(R,), sorted."""
        return self.columns["episode"][0]

    @property
    def is_first(self) -> Bool:
        """(R,) whether a replan is the first of its episode."""
        return np.concatenate([[True], self.episode[1:] != self.episode[:-1]])


def compare_planners(
    table: Table,
    rng: np.random.Generator,
    baseline: str = "astar",
    counted: str = "expanded",
    incremental: Collection[str] = (),
) -> Comparison:
    """Compare the planners of one source, from the columns of its replans.parquet, (N,) each.

    rng: for the intervals; every planner resamples the same episodes, whatever the others are.
    incremental: the planners that build on the plan before; only they have a fallback_share.
    Raises ValueError for a table without rows, of several sources, or whose planners have not the same replans.
    """
    assert counted in COUNTS, counted
    replans = _align(table)
    cells = dict(zip(replans.planners, replans.columns[counted], strict=True))
    seed = int(rng.integers(2**63))
    ratios, intervals = {}, {}
    if baseline in cells:
        for name in replans.planners:
            ratios[name] = _episode_ratios(replans, cells[baseline], cells[name])
            intervals[name] = _interval(replans, cells[baseline], cells[name], ratios[name], seed)
    rows = tuple(
        _row(replans, at, ratios.get(name), intervals.get(name), name in incremental)
        for at, name in enumerate(replans.planners)
    )
    episodes = len(np.unique(replans.episode[replans.paired]))
    return Comparison(replans.source, rows, baseline, counted, int(replans.paired.sum()), episodes, ratios)


def _align(table: Table) -> _Aligned:
    sources = sorted(set(np.asarray(table["source"]).tolist()))
    if len(sources) != 1:
        raise ValueError(f"planners are compared on one source, not on {len(sources)}")
    planner, episode, replan = (np.asarray(table[name]) for name in ("planner", "episode", "replan"))
    names = tuple(dict.fromkeys(planner.tolist()))
    order = np.lexsort((replan, episode))
    lines = [order[planner[order] == name] for name in names]
    asked = np.stack([episode[lines[0]], replan[lines[0]]])
    if (np.diff(asked) == 0).all(axis=0).any():
        raise ValueError(f"{names[0]} has a replan twice")
    for name, line in zip(names, lines, strict=True):
        if not np.array_equal(np.stack([episode[line], replan[line]]), asked):
            raise ValueError(f"{name} has not the same replans as {names[0]}")
    index = np.stack(lines)
    columns = {name: np.asarray(column)[index] for name, column in table.items()}
    return _Aligned(sources[0], names, columns, columns["found"].astype(bool).all(axis=0))


def _episode_ratios(replans: _Aligned, baseline: NDArray[Any], cells: NDArray[Any]) -> Float:
    """(E,) cells of the baseline / cells of a planner, (R,) each, in every episode with paired replans."""
    _, episode = np.unique(replans.episode[replans.paired], return_inverse=True)
    # As weights they would be float64, which holds every sum of cells exactly up to 2^53.
    of_baseline, of_planner = (np.bincount(episode, each[replans.paired]) for each in (baseline, cells))
    ratios: Float = np.divide(of_baseline, of_planner, out=np.full(len(of_planner), np.nan), where=of_planner > 0)
    return ratios


def _interval(
    replans: _Aligned, baseline: NDArray[Any], cells: NDArray[Any], ratios: Float, seed: int
) -> Interval | None:
    """Over episodes; a single one cannot be resampled, and blocks of its replans stand in."""
    rng = np.random.default_rng(seed)
    if len(ratios) == 1:
        return ratio_interval_in_time(baseline[replans.paired], cells[replans.paired], rng)
    return median_interval(ratios[np.isfinite(ratios)], rng)


def _row(replans: _Aligned, at: int, ratios: Float | None, interval: Interval | None, incremental: bool) -> PlannerRow:
    mine = {name: column[at] for name, column in replans.columns.items()}
    paired = {name: column[replans.paired] for name, column in mine.items()}
    totals = {f"{name}_total": int(mine[name].sum()) for name in COUNTS}
    finite = ratios[np.isfinite(ratios)] if ratios is not None else np.empty(0)
    low, high = interval or (None, None)
    later = mine["from_scratch"][~replans.is_first]
    excess = _excess(paired["cost"], paired["optimal_cost"])
    return PlannerRow(
        source=replans.source,
        planner=replans.planners[at],
        episodes=int(replans.is_first.sum()),
        replans=len(replans.episode),
        success_rate=float(np.mean(mine["found"])),
        **totals,
        expanded_mean=totals["expanded_total"] / len(replans.episode),
        ratio_expanded=_some(np.median, finite),
        ratio_low=low,
        ratio_high=high,
        suboptimality_mean=_some(np.mean, excess),
        suboptimality_p95=_some(_p95, excess),
        fallback_share=_some(np.mean, later) if incremental else None,
        us_median=_some(np.median, paired["us"]),
        us_p95=_some(_p95, paired["us"]),
        length_m_total=_some(np.sum, paired["length_m"]),
        turn_rad_total=_some(np.sum, paired["turn_rad"]),
    )


def _excess(cost: Float, optimal: Float) -> Float:
    """Fractions above the optimum, where there is one; a robot at its goal already has nothing to be worse than."""
    known = optimal > 0
    excess: Float = cost[known] / optimal[known] - 1
    return np.where(np.abs(excess) < ROUNDING, 0.0, excess)


def _p95(values: NDArray[Any]) -> float:
    return float(np.percentile(values, 95))


def _some(figure: Any, values: NDArray[Any] | Sequence[float]) -> float | None:
    """The figure of some values; None where there are none."""
    return float(figure(values)) if len(values) else None


@dataclass(frozen=True, slots=True)
class Replans:
    """N replans of one planner at t_ns, rising, (N,) each: the columns of plans.parquet.

    cost, optimal_cost: NaN where there is none.
    """

    t_ns: Int
    found: Bool
    expanded: Int
    generated: Int
    cost: Float
    optimal_cost: Float
    from_scratch: Bool


def ratio_to_astar(expanded: Int, astar_expanded: Int) -> Metrics:
    """ratio_to_astar of N replans, from the cells (N,) that the planner and A* close; none where it closes none."""
    if not np.any(expanded):
        return {}
    ratio = float(np.sum(astar_expanded)) / int(np.sum(expanded))
    return {"ratio_to_astar": Metric(ratio, len(expanded), "")}


def search_samples(replans: Replans) -> dict[str, Samples]:
    """Of node counts, success, and sub-optimality as a fraction of the optimal cost.

    fallback_share is of incremental planners only: the share of replans that had to start from scratch, without the
    first one, which always does.
    """
    # A robot that is at its goal already has nothing to be worse than: 0 / 0.
    compared = np.asarray(replans.found, np.bool_) & (np.asarray(replans.optimal_cost, np.float64) > 0)
    excess = np.full(len(compared), np.nan)
    excess[compared] = replans.cost[compared] / replans.optimal_cost[compared] - 1
    return {
        "expanded_total": finite_samples(replans.t_ns, replans.expanded, "sum"),
        "generated_total": finite_samples(replans.t_ns, replans.generated, "sum"),
        "expanded_mean": finite_samples(replans.t_ns, replans.expanded, "mean"),
        "success_rate": finite_samples(replans.t_ns, replans.found, "mean"),
        "fallback_share": finite_samples(replans.t_ns[1:], replans.from_scratch[1:], "mean"),
        "suboptimality_mean": finite_samples(replans.t_ns, excess, "mean"),
    }
