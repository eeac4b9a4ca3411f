"""What planning cost, and how good the paths were."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int
from quadlog.metrics.metric import Metric, Metrics
from quadlog.planning.protocol import Bool


@dataclass(frozen=True, slots=True)
class Replans:
    """N replans of one planner in time order, (N,) each: the columns of plans.parquet.

    cost, optimal_cost: NaN where there is none.
    astar_expanded: cells A* closes on the same queries, None where that was not counted.
    """

    found: Bool
    expanded: Int
    generated: Int
    cost: Float
    optimal_cost: Float
    from_scratch: Bool
    astar_expanded: Int | None = None


def search_metrics(replans: Replans, incremental: bool) -> Metrics:
    """Node counts, success, sub-optimality as a fraction of the optimal cost; those that do not apply are absent.

    incremental: whether the planner builds on the plan before. Only then is there a
    fallback_share, the share of replans that had to start from scratch; the first
    one always does and is left out.
    """
    metrics: Metrics = {}
    n = len(replans.found)
    if n == 0:
        return metrics
    expanded = int(np.sum(replans.expanded))
    metrics["expanded_total"] = Metric(float(expanded), n, "")
    metrics["generated_total"] = Metric(float(np.sum(replans.generated)), n, "")
    metrics["expanded_mean"] = Metric(expanded / n, n, "")
    metrics["success_rate"] = Metric(float(np.mean(replans.found)), n, "")
    if replans.astar_expanded is not None and expanded > 0:
        metrics["ratio_to_astar"] = Metric(float(np.sum(replans.astar_expanded)) / expanded, n, "")
    if incremental and n > 1:
        metrics["fallback_share"] = Metric(float(np.mean(replans.from_scratch[1:])), n - 1, "")
    # A robot that is at its goal already has nothing to be worse than: 0 / 0.
    compared = np.asarray(replans.found) & (np.asarray(replans.optimal_cost, dtype=np.float64) > 0)
    if compared.any():
        excess = replans.cost[compared] / replans.optimal_cost[compared] - 1
        metrics["suboptimality_mean"] = Metric(float(np.mean(excess)), int(compared.sum()), "")
    return metrics
