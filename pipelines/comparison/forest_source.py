"""Simulated walks through random forests, as [Planning, section 4] has them: 40 by 40 cells, a goal far beyond."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from quadlog.errors import UsageError
from quadlog.pipelines.comparison.source import Episode, Question, Source
from quadlog.planning.query import make_query
from quadlog.planning.registry import make_planner
from quadlog.planning.rules import Rules
from quadlog.simulation.planning_forest import MOST_PER_M2, forest_world
from quadlog.simulation.planning_walk import WorldWalk, walk_world
from quadlog.simulation.planning_worlds import World

PREFIX = "forest:"


def forest_source(name: str, episodes: int, leader: str, rules: Rules, dilation: str, seed: int) -> Source:
    """Walks through `name`, as forest:0.2 for 0.2 trees/m²; every planner is asked what the leader was asked.

    dilation: of `inflation.INFLATIONS`. Raises UsageError for a density that is none.
    """
    density_per_m2 = _density(name)

    def walks() -> Iterator[Episode]:
        for number in range(episodes):
            rng = np.random.default_rng([seed, number, *b"planning forest"])
            world = forest_world(density_per_m2, rng, dilation=dilation)
            yield questions_along(world, walk_world(world, make_planner(leader, rules)))

    about = (
        f"simulated walks of 15 to 25 m through {density_per_m2:g} trees/m², led by {leader} one cell a replan, window "
        f"40 by 40 cells of 0.1 m, obstacles grown by 0.3 m ({dilation}), seed {seed}"
    )
    return Source(name, about, walks, episodes)


def questions_along(world: World, walk: WorldWalk) -> Iterator[Question]:
    """What was to be planned at each instant of a walk through a world."""
    for instant in walk.instants:
        occupied = instant.occupied
        query = make_query(
            instant.window, occupied, instant.robot_xy_m, instant.goal_xy_m, world.dilation_m, world.dilation
        )
        yield Question(instant.t_ns, query, occupied)


def _density(name: str) -> float:
    try:
        density_per_m2 = float(name.removeprefix(PREFIX))
    except ValueError:
        density_per_m2 = -1.0
    if not 0 <= density_per_m2 <= MOST_PER_M2:
        raise UsageError(f"{name}: trees per m² between 0 and {MOST_PER_M2:g}, as in  forest:0.2")
    return density_per_m2
