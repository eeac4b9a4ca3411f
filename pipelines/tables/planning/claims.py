"""Two claims of [Planning] that are printed in words: no collision with IA*, and more coherent paths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from quadlog.messages import Float
from quadlog.metrics.planning import join_turn_rad, path_change_m
from quadlog.pipelines.tables.intervals import bootstrap_statistic, claim, claim_of_mean, judge_number, share_interval
from quadlog.planning.protocol import Bool
from quadlog.results.papers.table import PaperRow
from quadlog.simulation.worlds.replanning_walk import WorldWalk


def collision_text(body_m: tuple[float, float]) -> str:
    """How collisions were counted and judged."""
    return (
        "With A* the robot may collide with an obstacle, the paper says, while IA*'s route gets to the target with no "
        "collision; it shows one pair of walks in a picture. A walk collides where the robot's body of "
        f"{body_m[0]:g} by {body_m[1]:g} m, as printed, touches a trunk on the way that it walks. Claimed of IA*: "
        "every walk arrives and touches nothing. Claimed of A*: some walk touches. Claimed of both: IA* touches less "
        "often in the same forests. Shares after Wilson; difference: bootstrap over the forests, in pairs. Intervals: "
        "95 %."
    )


def collision_rows(touched: Bool, arrived: Bool, where: str, rng: np.random.Generator) -> list[PaperRow]:
    """Touched (W, 2): whether A* and IA* touched a trunk on each walk; arrived (W,): whether IA* came to the goal."""
    walks, (of_astar, of_ia_star) = len(touched), touched.T
    clean = int((arrived & ~of_ia_star).sum())
    share, interval = share_interval(clean, walks)
    verdict = judge_number(1.0, 1e-6, share, interval)
    note = f"{clean} of {walks}; {int(of_ia_star.sum())} touch. Claimed: all."
    quantity = f"{where}: share of IA*'s walks that arrive and touch nothing (1)"
    rows = [PaperRow(quantity, share, None, *interval, verdict, note)]
    count = int(of_astar.sum())
    share, interval = share_interval(count, walks)
    quantity = f"{where}: share of A*'s walks that touch a trunk (1)"
    rows.append(claim(quantity, 0.0, share, interval, f"{count} of {walks}. Claimed: some."))
    quantity = f"{where}: share of walks that touch, IA* less A* (1)"
    less = of_ia_star * 1.0 - of_astar
    return [*rows, claim_of_mean(quantity, 0.0, less, rng, "Claimed: less than 0.", above=False)]


@dataclass(frozen=True, slots=True)
class Coherence:
    """How plans follow one another on a walk, means over its replans.

    change_m: distance of a path from the one before, see path_change_m. start_turn_rad: how much the direction of a
    path's first step differs from that of the one before. join_turn_rad: the turn where an old route ends and a new one
    begins; None where none was ever kept.
    """

    change_m: float
    start_turn_rad: float
    join_turn_rad: float | None


COHERENCE = (
    "IA*'s paths are more coherent than A*'s, the paper says, so that the robot's orientation fluctuates less; its "
    "conclusions say that IA* changes the course more often. It prints no number. Ours: the mean distance of a path "
    "from the one before, as far as that reached; how much the direction of the first step changes from one plan to "
    "the next; and how much IA*'s path turns where the old route ends and the new one begins. Each planner leads its "
    "own walk, cell by cell. Means over the walks, in pairs. Intervals: bootstrap over the walks."
)
MEASURES: dict[str, Callable[[Coherence], float]] = {
    "change of the path between replans, IA* less A* (m)": lambda each: each.change_m,
    "turn of the first step between replans, IA* less A* (rad)": lambda each: each.start_turn_rad,
}


def coherence_of(walk: WorldWalk) -> Coherence:
    """Of consecutive plans of a walk cell by cell; a replan without a path is left out."""
    found = [(each.window, plan) for each, plan in zip(walk.instants, walk.plans, strict=True) if plan.found]
    paths_m = [window.centre_of(plan.cells) for window, plan in found]
    changes_m = [path_change_m(before, after) for before, after in pairwise(paths_m)]
    steps = [path_m[1] - path_m[0] for path_m in paths_m if len(path_m) > 1]
    turns = [join_turn_rad(np.array([[0.0, 0.0], a, a + b]), 1) for a, b in pairwise(steps)]
    joins = [
        join_turn_rad(path_m, plan.reused_cells - 1)
        for path_m, (_, plan) in zip(paths_m, found, strict=True)
        if 1 < plan.reused_cells < len(path_m)
    ]
    return Coherence(_mean(changes_m), _mean(turns), _mean(joins) if joins else None)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else 0.0


def coherence_rows(
    walks: Sequence[tuple[Coherence, Coherence]], where: str, rng: np.random.Generator
) -> list[PaperRow]:
    """Of A* and IA* on the same forests, W pairs."""
    rows: list[PaperRow] = []
    for called, measure in MEASURES.items():
        of_astar, of_ia_star = np.array([[measure(each) for each in pair] for pair in walks]).T
        note = f"A* {of_astar.mean():.3g}, IA* {of_ia_star.mean():.3g}. Claimed: less than 0."
        rows.append(claim_of_mean(f"{where}: {called}", 0.0, of_ia_star - of_astar, rng, note, above=False))
    turns: Float = np.array([pair[1].join_turn_rad for pair in walks if pair[1].join_turn_rad is not None])
    if len(turns):
        mean, interval = bootstrap_statistic(turns, np.mean, rng)
        rows.append(PaperRow(f"{where}: turn of IA*'s path where it joins (rad)", mean, None, *interval))
    return rows
