"""What planners did: of one run's replans, and of several planners on the same replans of one source.

What a planner was asked for and what work it did is over all its replans: `replans`, `success_rate`, the totals and the
mean of cells (a search that floods the window before it fails is work too), `fallback_share`. Ratio, sub-optimality,
times, lengths, turns are paired, over replans that all solved: one that gives up on hard ones would look cheap.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float, Int
from quadlog.metrics.intervals import Interval, median_interval, ratio_interval_in_time
from quadlog.metrics.summary import Metric, Metrics, Samples, finite_samples, is_short

COUNTS = ("expanded", "generated", "touched")
ROUNDING = 1e-9  # √2 summed in another order is the same cost

Table = Mapping[str, NDArray[Any]]


class Ratio(NamedTuple):
    """What a planner spent over what another did: the values of E episodes (E,), their median, and its interval."""

    value: float
    of_episodes: Float
    interval: Interval | None


@dataclass(frozen=True, slots=True)
class Comparison:
    """What planners did on one source, in the order in which they came, and what that rests on.

    rows: of planners.parquet, values by column, None where one does not apply.
    counted: which of COUNTS is a cell in the ratio. baseline: what the ratio compares with, perhaps no row at all.
    paired: what each planner did on the R replans that all solved, columns (R,) and us_repeats (R, K), by its name.
    ratios: of cells of the baseline over those of each planner that has one.
    """

    source: str
    rows: list[dict[str, Any]]
    baseline: str
    counted: str
    paired: Mapping[str, Table]
    ratios: Mapping[str, Ratio]

    @property
    def episodes(self) -> NDArray[np.int64]:
        """(R,) of the paired replans, sorted."""
        return next(iter(self.paired.values()))["episode"]

    def ratio(self, column: str, over: str, under: str, confidence: float = 0.95) -> Ratio | None:
        """What one planner spent over what the other did, see `ratio_of`; None where one of them did not run."""
        if not {over, under} <= self.paired.keys():
            return None
        return ratio_of(self.paired[over][column], self.paired[under][column], self.episodes, confidence)


def ratio_of(parts: NDArray[Any], wholes: NDArray[Any], episode: Int, confidence: float = 0.95) -> Ratio | None:
    """Of what was spent on R replans, (R,) or K times (R, K) each, over what another planner spent.

    episode (R,): sorted; those in which `wholes` are 0 are left out, None if all are. The interval is of independent
    episodes, of a question's repeats, or within one episode of consecutive replans; None where there are too few.
    """
    if parts.ndim == 2:
        parts, wholes = (each[0] if len(parts) == 1 else np.median(each, axis=1) for each in (parts, wholes))
    values, number = np.unique(episode, return_inverse=True)
    over, under = (np.bincount(number, each) if len(number) > 1 else each for each in (parts, wholes))
    ratios = np.divide(over, under, out=np.full(len(under), np.nan), where=under > 0)
    finite = ratios[np.isfinite(ratios)]
    if not len(finite):
        return None
    is_series = len(values) == 1 < len(number)
    interval = ratio_interval_in_time(parts, wholes, confidence) if is_series else median_interval(finite, confidence)
    return Ratio(float(np.median(finite)), ratios, interval)


def compare_planners(
    table: Table, baseline: str = "astar", counted: str = "expanded", incremental: Collection[str] = ()
) -> Comparison:
    """Compare the planners of one source, from the columns of its replans.parquet, (N,) each, the same replans for all.

    A column us_repeats (N, K) has the microseconds of each time that a question was asked, of which `us` is the median.
    incremental: the planners that build on the plan before; only they have a fallback_share.
    """
    names = list(dict.fromkeys(table["planner"].tolist()))
    number = np.array([names.index(each) for each in table["planner"].tolist()])
    order = np.lexsort((table["replan"], table["episode"], number)).reshape(len(names), -1)
    of = {name: {column: each[rows] for column, each in table.items()} for name, rows in zip(names, order, strict=True)}
    solved = np.logical_and.reduce([own["found"] for own in of.values()])
    paired = {name: {column: each[solved] for column, each in own.items()} for name, own in of.items()}
    comparison = Comparison(str(table["source"][0]), [], baseline, counted, paired, {})
    ratios = {name: ratio for name in names if (ratio := comparison.ratio(counted, baseline, name)) is not None}
    compared = {"baseline": baseline, "counted": counted}
    rows = [_row(name, of[name], paired[name], ratios.get(name), name in incremental) | compared for name in names]
    return Comparison(comparison.source, rows, baseline, counted, paired, ratios)


def _row(planner: str, own: Table, paired: Table, ratio: Ratio | None, incremental: bool) -> dict[str, Any]:
    """suboptimality: cost / optimal cost - 1; fallback_share: of the replans but the first of each episode."""
    low, high = (None if ratio is None else ratio.interval) or (None, None)
    totals = {f"{name}_total": int(own[name].sum()) for name in COUNTS}
    is_first = np.diff(own["episode"], prepend=-1) != 0
    excess = _excess(paired["cost"], paired["optimal_cost"])
    excess = excess[np.isfinite(excess)]
    return {
        "source": str(own["source"][0]),
        "planner": planner,
        "episodes": int(is_first.sum()),
        "replans": len(is_first),
        "success_rate": float(np.mean(own["found"])),
        **totals,
        "expanded_mean": totals["expanded_total"] / len(is_first),
        "ratio_expanded": None if ratio is None else ratio.value,
        "ratio_low": low,
        "ratio_high": high,
        "suboptimality_mean": _some(np.mean, excess),
        "suboptimality_p95": _some(np.percentile, excess, 95),
        "fallback_share": _some(np.mean, own["from_scratch"][~is_first]) if incremental else None,
        "us_median": _some(np.median, paired["us"]),
        "us_p95": _some(np.percentile, paired["us"], 95),
        "length_m_total": _some(np.sum, paired["length_m"]),
        "turn_rad_total": _some(np.sum, paired["turn_rad"]),
    }


def _excess(cost: Float, optimal: Float) -> Float:
    """(N,) fractions above the optimum; NaN where there is none, or a robot at its goal, 0 / 0."""
    excess = np.divide(cost, optimal, out=np.full(len(cost), np.nan), where=optimal > 0) - 1
    return np.where(np.abs(excess) < ROUNDING, 0.0, excess)


def _some(figure: Any, values: NDArray[Any], *of: int) -> float | None:
    """The figure of some values; None where there are none."""
    return float(figure(values, *of)) if len(values) else None


def ratio_to_astar(t_ns: Int, expanded: Int, astar_expanded: Int) -> Metrics:
    """ratio_to_astar of N replans, from the cells (N,) that the planner and A* close; none where it closes none."""
    ratio = ratio_of(astar_expanded, expanded, np.zeros(len(expanded), np.int64))
    interval = None if ratio is None or is_short(t_ns) else ratio.interval
    return {} if ratio is None else {"ratio_to_astar": Metric(ratio.value, len(expanded), "", interval)}


def search_samples(replans: Table) -> dict[str, Samples]:
    """Of node counts, success, fallback_share, which is of incremental planners only, and sub-optimality.

    replans: of one planner, columns (N,) of plans.parquet, t_ns rising; costs are NaN where there is none.
    """
    t_ns, excess = replans["t_ns"], _excess(replans["cost"], replans["optimal_cost"])
    excess = np.where(replans["found"], excess, np.nan)
    totals = {f"{name}_total": finite_samples(t_ns, replans[name], "sum") for name in ("expanded", "generated")}
    return totals | {
        "expanded_mean": finite_samples(t_ns, replans["expanded"], "mean"),
        "success_rate": finite_samples(t_ns, replans["found"], "mean"),
        "fallback_share": finite_samples(t_ns[1:], replans["from_scratch"][1:], "mean"),
        "suboptimality_mean": finite_samples(t_ns, excess, "mean"),
    }
