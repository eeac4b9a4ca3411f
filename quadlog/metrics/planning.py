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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import arc_lengths
from quadlog.messages import Float, Int
from quadlog.metrics.intervals import Interval, corrected_confidence, median_interval, ratio_interval_in_time
from quadlog.metrics.summary import Metric, Metrics, Samples, finite_samples
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


class Ratio(NamedTuple):
    """What a planner spent over what another did: the values of E episodes (E,), their median, and its interval."""

    value: float
    of_episodes: Float
    interval: Interval | None


@dataclass(frozen=True, slots=True)
class Spending:
    """What planners spent on the R replans that all of them solved: cells or microseconds, (R,) or K times (R, K) each.

    episode (R,): sorted.
    """

    of: Mapping[str, NDArray[Any]]
    episode: NDArray[np.int64]

    def ratio(self, over: str, under: str, confidence: float = 0.95) -> Ratio | None:
        """None where one of them is not known, or `under` spent nothing in any episode; such episodes are left out.

        The interval is of episodes that are independent, of the repeats of a single question, or within one episode of
        replans that follow one another; None where there are too few.
        """
        if not len(self.episode) or not {over, under} <= self.of.keys():
            return None
        parts, wholes = (np.asarray(self.of[name], dtype=np.float64) for name in (over, under))
        if parts.ndim == 2:
            single = len(parts) == 1
            parts, wholes = (each[0] if single else np.median(each, axis=1) for each in (parts, wholes))
        is_one, over_all, under_all = len(self.episode) > 1 and self.episode[0] == self.episode[-1], parts, wholes
        if len(self.episode) > 1:
            _, number = np.unique(self.episode, return_inverse=True)
            over_all, under_all = (np.bincount(number, each).astype(np.float64) for each in (parts, wholes))
        ratios = np.divide(over_all, under_all, out=np.full(len(under_all), np.nan), where=under_all > 0)
        finite = ratios[np.isfinite(ratios)]
        if not len(finite):
            return None
        interval = ratio_interval_in_time(parts, wholes, confidence) if is_one else median_interval(finite, confidence)
        return Ratio(float(np.median(finite)), ratios, interval)

    def beats_all(self, best: str) -> bool:
        """Whether every other planner is shown to spend more, with an interval that allows for the choice."""
        others = [name for name in self.of if name != best]
        found = [self.ratio(name, best, corrected_confidence(len(others))) for name in others]
        return all(each is not None and each.interval is not None and each.interval[0] > 1 for each in found)


@dataclass(frozen=True, slots=True)
class Comparison:
    """The rows of one source, in the order in which its planners came, and what they rest on.

    counted: which of COUNTS is a cell in the ratio. baseline: what the ratio compares with, perhaps no row at all.
    paired_replans: those that all planners solved; paired_episodes: those E that have any.
    ratios: of the baseline over each planner that has one, see `Spending.ratio`.
    cells, us: what each spent on the paired replans, in cells and in microseconds.
    """

    source: str
    rows: tuple[PlannerRow, ...]
    baseline: str
    counted: str
    paired_replans: int
    paired_episodes: int
    ratios: Mapping[str, Ratio]
    cells: Spending
    us: Spending


def compare_planners(
    table: Table, baseline: str = "astar", counted: str = "expanded", incremental: Collection[str] = ()
) -> Comparison:
    """Compare the planners of one source, from the columns of its replans.parquet, (N,) each.

    A column us_repeats (N, K) has the microseconds of each time that a question was asked, else `us` stands for it.
    incremental: the planners that build on the plan before; only they have a fallback_share.
    Raises ValueError for a table without rows, of several sources, or whose planners have not the same replans.
    """
    assert counted in COUNTS, counted
    source, planners, columns = _by_planner(table)
    paired: Bool = np.logical_and.reduce(columns["found"], axis=0, dtype=np.bool_)
    episode = columns["episode"][0]

    def spending(column: str) -> Spending:
        return Spending(
            {name: each[paired] for name, each in zip(planners, columns[column], strict=True)}, episode[paired]
        )

    cells, us = spending(counted), spending("us_repeats" if "us_repeats" in table else "us")
    ratios = {name: ratio for name in planners if (ratio := cells.ratio(baseline, name)) is not None}
    rows = []
    for at, name in enumerate(planners):
        own = {column: each[at] for column, each in columns.items()}
        rows.append(_row(source, name, own, paired, ratios.get(name), name in incremental))
    episodes = len(np.unique(episode[paired]))
    return Comparison(source, tuple(rows), baseline, counted, int(paired.sum()), episodes, ratios, cells, us)


def _by_planner(table: Table) -> tuple[str, list[str], dict[str, NDArray[Any]]]:
    """The source, its planners, and columns (P, R) with a line per planner, in order of episode and replan."""
    sources = sorted(set(np.asarray(table["source"]).tolist()))
    if len(sources) != 1:
        raise ValueError(f"planners are compared on one source, not on {len(sources)}")
    planner, episode, replan = (np.asarray(table[name]) for name in ("planner", "episode", "replan"))
    names = list(dict.fromkeys(planner.tolist()))
    order = np.lexsort((replan, episode))
    lines = [order[planner[order] == name] for name in names]
    asked = np.stack([episode[lines[0]], replan[lines[0]]])
    if (np.diff(asked) == 0).all(axis=0).any():
        raise ValueError(f"{names[0]} has a replan twice")
    for name, line in zip(names, lines, strict=True):
        if not np.array_equal(np.stack([episode[line], replan[line]]), asked):
            raise ValueError(f"{name} has not the same replans as {names[0]}")
    return sources[0], names, {name: np.asarray(column)[np.stack(lines)] for name, column in table.items()}


def _row(source: str, planner: str, mine: Table, paired: Bool, ratio: Ratio | None, incremental: bool) -> PlannerRow:
    both = {name: column[paired] for name, column in mine.items()}
    totals = {f"{name}_total": int(mine[name].sum()) for name in COUNTS}
    low, high = (None if ratio is None else ratio.interval) or (None, None)
    is_first = np.concatenate([[True], np.diff(mine["episode"]) != 0])
    later = mine["from_scratch"][~is_first]
    excess = _excess(both["cost"], both["optimal_cost"])
    excess = excess[np.isfinite(excess)]
    return PlannerRow(
        source=source,
        planner=planner,
        episodes=int(is_first.sum()),
        replans=len(paired),
        success_rate=float(np.mean(mine["found"])),
        **totals,
        expanded_mean=totals["expanded_total"] / len(paired),
        ratio_expanded=None if ratio is None else ratio.value,
        ratio_low=low,
        ratio_high=high,
        suboptimality_mean=_some(np.mean, excess),
        suboptimality_p95=_some(_p95, excess),
        fallback_share=_some(np.mean, later) if incremental else None,
        us_median=_some(np.median, both["us"]),
        us_p95=_some(_p95, both["us"]),
        length_m_total=_some(np.sum, both["length_m"]),
        turn_rad_total=_some(np.sum, both["turn_rad"]),
    )


def _excess(cost: Float, optimal: Float) -> Float:
    """(N,) fractions above the optimum; NaN where there is none, or a robot at its goal, 0 / 0."""
    excess = np.full(len(cost), np.nan)
    np.divide(cost, optimal, out=excess, where=optimal > 0)
    excess -= 1
    return np.where(np.abs(excess) < ROUNDING, 0.0, excess)


def _p95(values: NDArray[Any]) -> float:
    return float(np.percentile(values, 95))


def _some(figure: Any, values: NDArray[Any] | Sequence[float]) -> float | None:
    """The figure of some values; None where there are none."""
    return float(figure(values)) if len(values) else None


def ratio_to_astar(expanded: Int, astar_expanded: Int) -> Metrics:
    """ratio_to_astar of N replans, from the cells (N,) that the planner and A* close; none where it closes none."""
    ratio = Spending({"astar": astar_expanded, "own": expanded}, np.zeros(len(expanded), np.int64)).ratio(
        "astar", "own"
    )
    return {} if ratio is None else {"ratio_to_astar": Metric(ratio.value, len(expanded), "", ratio.interval)}


def search_samples(replans: Table) -> dict[str, Samples]:
    """Of node counts, success, and sub-optimality as a fraction of the optimal cost.

    replans: of one planner, columns (N,) of plans.parquet, t_ns rising; costs are NaN where there is none.
    fallback_share is of incremental planners only: the share of replans that had to start from scratch, without the
    first one, which always does.
    """
    excess = np.where(replans["found"], _excess(replans["cost"], replans["optimal_cost"]), np.nan)
    return {
        "expanded_total": finite_samples(replans["t_ns"], replans["expanded"], "sum"),
        "generated_total": finite_samples(replans["t_ns"], replans["generated"], "sum"),
        "expanded_mean": finite_samples(replans["t_ns"], replans["expanded"], "mean"),
        "success_rate": finite_samples(replans["t_ns"], replans["found"], "mean"),
        "fallback_share": finite_samples(replans["t_ns"][1:], replans["from_scratch"][1:], "mean"),
        "suboptimality_mean": finite_samples(replans["t_ns"], excess, "mean"),
    }


def path_change_m(before_m: Float, after_m: Float) -> float:
    """How far a new path (K, 2) lies from the one before (L, 2), both in map: the mean distance of its points from it.

    Only as much of the new path counts as was left of the old one from where the new one begins: what is added beyond
    is no change of mind. 0 for a path that goes on as planned.
    """
    arc_before, arc_after = arc_lengths(before_m), arc_lengths(after_m)
    left = arc_before[-1] - arc_before[np.hypot(*(before_m - after_m[0]).T).argmin()]
    return float(_distances_to_path(after_m[arc_after <= left + ROUNDING], before_m).mean())


def _distances_to_path(points_m: Float, path_m: Float) -> Float:
    """(N,) distances of points (N, 2) from a polyline (L, 2)."""
    if len(path_m) == 1:
        single: Float = np.hypot(*(points_m - path_m[0]).T)
        return single
    begin, step = path_m[:-1], np.diff(path_m, axis=0)
    along = ((points_m[:, None] - begin) * step).sum(axis=2) / np.maximum((step**2).sum(axis=1), 1e-300)
    nearest = begin + np.clip(along, 0.0, 1.0)[..., None] * step
    distances: Float = np.hypot(*np.moveaxis(points_m[:, None] - nearest, 2, 0)).min(axis=1)
    return distances


def join_turn_rad(path_m: Float, joint: int) -> float:
    """How much a path (K, 2) without repeats turns at the point `joint`, left or right alike; 0 at its ends."""
    if not 0 < joint < len(path_m) - 1:
        return 0.0
    (ax, ay), (bx, by) = path_m[joint] - path_m[joint - 1], path_m[joint + 1] - path_m[joint]
    return float(abs(np.arctan2(ax * by - ay * bx, ax * bx + ay * by)))
