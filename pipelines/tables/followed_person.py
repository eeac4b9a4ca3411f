"""Rows of the table following-2 on Figs 17 and 18: how near a robot keeps to a person, and how far from obstacles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from quadlog.messages import Float
from quadlog.pipelines.tables.judging import bootstrap_ratio, share_interval
from quadlog.pipelines.tables.person_ahead import AHEAD_M, follow_world
from quadlog.pipelines.tables.planner_walks import DENSITIES_PER_M2, HELD_OUT_SEED, PAPER
from quadlog.planning.registry import make_planner
from quadlog.results.paper_rows import PaperRow, RowGroup
from quadlog.simulation.clearance import occupied_centres
from quadlog.simulation.planning_walk import Outcome, walk_world
from quadlog.simulation.planning_worlds import GROWTH_M, World

WHERE = {0.0: "Fig. 17, without obstacles", **{each: f"Fig. 18, {each:g} trees/m²" for each in DENSITIES_PER_M2}}
"""Trees to a square metre, and what the table calls them."""


@dataclass(frozen=True, slots=True)
class Followed:
    """One walk behind a person. mean_m, most_m: straight to the person, at the replans.

    clear_m: the least from the robot's centre to the edge of an obstacle, inf without any.
    """

    arrived: bool
    mean_m: float
    most_m: float
    clear_m: float


def follow(world: World) -> Followed:
    """Led by IA* as the paper's robot is."""
    walk = walk_world(world, make_planner(PAPER.leader, PAPER.rules))
    away_m = np.array([np.hypot(*(each.goal_xy_m - each.robot_xy_m)) for each in walk.instants])
    centres_m = occupied_centres(world.occupied, world.window)
    clear_m = np.inf
    if len(centres_m):
        clear_m = float(cKDTree(centres_m).query(walk.path_xy_m)[0].min()) - world.window.cell_m / 2
    return Followed(walk.outcome is Outcome.ARRIVED, float(away_m.mean()), float(away_m.max()), clear_m)


def person_group(walks: int, seed: int) -> RowGroup:
    """Both figures in numbers, of which the paper prints none."""
    rows: list[PaperRow] = []
    for number, (density, where) in enumerate(WHERE.items()):
        followed = [follow(follow_world(density, each, PAPER, seed)) for each in range(walks)]
        rows += _rows(followed, where, np.random.default_rng([HELD_OUT_SEED + seed, number, *b"person"]))
    text = (
        f"Following a person who walks {AHEAD_M:g} m of way ahead, without and with obstacles, as the paper shows "
        f"outdoors in pictures. Preset paper, led by {PAPER.leader}, one cell a replan; obstacles grow by "
        f"{GROWTH_M:g} m, which the robot's centre keeps off. The person stands still in the end, and there a walk "
        "ends. Intervals: bootstrap over the walks; shares of walks after Wilson."
    )
    return RowGroup("Figs 17 and 18: behind a person", text, tuple(rows))


def _rows(followed: list[Followed], where: str, rng: np.random.Generator) -> list[PaperRow]:
    arrived = sum(each.arrived for each in followed)
    share, interval = share_interval(arrived, len(followed))
    rows = [
        PaperRow(
            f"{where}: share of walks that come to the person (1)",
            share,
            None,
            *interval,
            note=f"{arrived} of {len(followed)}.",
        )
    ]
    columns = {
        "distance to the person, mean (m)": [each.mean_m for each in followed],
        "largest distance to the person, mean over the walks (m)": [each.most_m for each in followed],
        "least distance to an obstacle, mean over the walks (m)": [each.clear_m for each in followed],
    }
    for called, values in columns.items():
        if np.isfinite(values).all():
            rows.append(_mean_row(f"{where}: {called}", np.array(values), rng))
    return rows


def _mean_row(quantity: str, values: Float, rng: np.random.Generator) -> PaperRow:
    mean, interval = bootstrap_ratio(values, np.ones(len(values)), rng)
    return PaperRow(quantity, mean, None, *interval, note=f"{values.min():.2f} to {values.max():.2f}.")
