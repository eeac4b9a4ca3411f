from __future__ import annotations

import numpy as np
import pytest

from quadlog.mapping.grid import Window
from quadlog.pipelines.tables.planning.claims import Coherence, coherence_of, coherence_rows, collision_rows
from quadlog.planning.registry import make_planner
from quadlog.simulation.worlds.replanning_walk import walk_world
from quadlog.simulation.worlds.scenes import SCENES
from quadlog.simulation.worlds.world import World, standing


def test_a_walk_over_open_ground_never_changes_its_mind():
    window = Window(-60, -60, 0.1, (120, 120))
    world = World(window, np.zeros(window.shape, dtype=bool), np.array([0.05, 0.05]), standing(4.05, 0.05))
    for name in ("astar", "ia_star", "ia_star_end"):
        coherence = coherence_of(walk_world(world, make_planner(name)))
        assert coherence.change_m == pytest.approx(0.0, abs=1e-12)
        assert coherence.start_turn_rad == pytest.approx(0.0, abs=1e-12)


def test_in_the_papers_scene_a_star_changes_sides_and_ia_star_does_not():
    world = SCENES["coherence"]()
    astar, ia_star = (coherence_of(walk_world(world, make_planner(name))) for name in ("astar", "ia_star"))
    assert astar.change_m > 2 * ia_star.change_m
    assert astar.join_turn_rad is None
    assert ia_star.join_turn_rad is not None


def verdicts(rows):
    return [row.reproduces for row in rows]


def test_collisions_by_hand():
    rng = np.random.default_rng(0)
    of_astar = np.arange(40) < 20
    clean, arrived = np.zeros(40, dtype=bool), np.ones(40, dtype=bool)
    claimed = collision_rows(np.stack([of_astar, clean], axis=1), arrived, "here", rng)
    assert [row.ours for row in claimed] == [1.0, 0.5, -0.5]
    assert verdicts(claimed) == ["yes", "yes", "yes"]
    lost = collision_rows(np.stack([of_astar, clean], axis=1), arrived & (np.arange(40) > 0), "here", rng)
    assert verdicts(lost)[0] == "no"
    assert verdicts(collision_rows(np.stack([clean, of_astar], axis=1), arrived, "here", rng)) == [
        "no",
        "undecided",
        "no",
    ]
    nothing = collision_rows(np.stack([clean, clean], axis=1), arrived, "here", rng)
    assert verdicts(nothing) == ["yes", "undecided", "undecided"]
    few = collision_rows(np.stack([of_astar, clean], axis=1)[:4], arrived[:4], "here", rng)
    assert verdicts(few) == ["undecided", "yes", "undecided"]


def test_coherence_is_judged_in_pairs():
    rng = np.random.default_rng(0)
    pairs = [(Coherence(0.1 + d, 0.1, None), Coherence(0.05 + d, 0.2, 0.3)) for d in np.linspace(0, 1, 10)]
    change, turn, join = coherence_rows(pairs, "here", rng)
    assert verdicts([change, turn, join]) == ["yes", "no", None]
    assert (change.ours, turn.ours, join.ours) == pytest.approx((-0.05, 0.1, 0.3))
