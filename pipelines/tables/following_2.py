"""following-2: cells that A* and IA* search behind a person [Following, Table 2, Figs 14-16]."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadlog.geometry import arc_lengths
from quadlog.mapping.goal_projection import INFLATIONS
from quadlog.messages import Float
from quadlog.pipelines.tables.claims import HELD_OUT_SEED, Claim, Figures, Group, Study, StudyTable, grid
from quadlog.pipelines.tables.judge import EXACT, MEDIAN, SHARE, Statistic, beyond, not_comparable
from quadlog.pipelines.tables.planning_2 import CLAIMED, DENSITIES_PER_M2, FAST_PRESETS, PRESETS, cells, forest_of, lead
from quadlog.planning.planners.astar import AStar
from quadlog.simulation.worlds.scenes import FOLLOWING_CELLS, SCENES
from quadlog.simulation.worlds.world import WaypointTrack, World

# None of these is printed. The site of Figs 14 and 15 has room for a person 4 m ahead.
AHEAD_M, SPEED_MPS = 4.0, 0.6
ASIDE_M, TURN_EACH_M = 2.0, 4.0
SITES = {"static-obstacles": "static obstacles", "dynamic-obstacle": "a dynamic obstacle"}
"""Scenes of quadlog.simulation.worlds.scenes, and what the table calls them."""


def behind_person(preset: str, place: str, number: int, seed: int) -> Figures:
    """A walk behind a person, on one of the sites or through a forest of so many trees to a square metre."""
    of = PRESETS[preset]
    if place in SITES:
        world = replace(SCENES[place](), dilation=of.dilation)
    else:
        world = follow_world(float(place), number, of.dilation, seed)
    return cells(world, lead(world, of), of)


def follow_world(density_per_m2: float, number: int, dilation: str, seed: int) -> World:
    """A held-out forest whose goal is a person, AHEAD_M of way before a robot that is as fast.

    The person strolls to the forest's goal over places up to ASIDE_M beside the straight line, one for each
    TURN_EACH_M of it, round the growth of trees, and stands there in the end.
    """
    world = forest_of(density_per_m2, number, dilation, seed, FOLLOWING_CELLS)
    rng = np.random.default_rng([HELD_OUT_SEED + seed, number, *b"stroll"])
    way_m = _stroll(world, rng)
    arc_m = arc_lengths(way_m)
    first = min(int(np.searchsorted(arc_m, AHEAD_M)), len(arc_m) - 1)
    t_ns = np.rint(1e9 * (arc_m[first:] - arc_m[first]) / SPEED_MPS).astype(np.int64)
    return replace(world, goal=WaypointTrack(t_ns, way_m[first:]), speed_mps=SPEED_MPS)


def _stroll(world: World, rng: np.random.Generator) -> Float:
    """(L, 2) cells' centres in map from start to goal; a place that cannot be reached is left out."""
    # Grown alike for all presets, so that the person takes the same way in all.
    blocked = INFLATIONS["square"](world.occupied, world.dilation_m / world.window.cell_m)
    planner = AStar()
    way = [np.asarray(world.window.cell_of(world.start_xy_m[None]), dtype=np.int32)]
    for place_m in _places(world.start_xy_m, world.goal.at(0), rng):
        (col, row), (to_col, to_row) = way[-1][-1].tolist(), world.window.cell_of(place_m).tolist()
        way.append(planner.plan(blocked, (col, row), (to_col, to_row)).cells[1:])
        if not len(way[-1]):
            way.pop()
    return world.window.centre_of(np.concatenate(way))


def _places(start_m: Float, goal_m: Float, rng: np.random.Generator) -> Float:
    """(K, 2) in map, the goal last."""
    along_m = goal_m - start_m
    length_m = float(np.hypot(*along_m))
    left = np.array([-along_m[1], along_m[0]]) / length_m
    count = int(length_m // TURN_EACH_M)
    share = np.arange(1, count + 1) / (count + 1)
    aside_m = rng.uniform(-ASIDE_M, ASIDE_M, size=count)
    return np.concatenate([start_m + share[:, None] * along_m + aside_m[:, None] * left, goal_m[None]])


FORESTS = {f"{density:g}": f"{density:g} trees/m²" for density in DENSITIES_PER_M2}
WHY_NOT = "Round an obstacle a way leads away from its goal, and IA* keeps none of the steps that do."


def ratio_rows(preset: str) -> list[Claim]:
    """The claim by one preset: on either site, a single walk, and in the forests."""
    of = PRESETS[preset]

    def row(place: str, called: str, statistic: Statistic) -> Claim:
        quantity = f"{preset}, {called}ratio {of.baseline}/{of.ia_star} (1)"
        judge = beyond(CLAIMED, printed=CLAIMED)
        if not statistic.is_drawn:
            judge = not_comparable(CLAIMED, "One walk on a site of our own.", judge.said)
        where = {"preset": preset, "place": place}
        return Claim(quantity, "ratio", where, judge, statistic, why_not=WHY_NOT, of="more than 5 times")

    forests = [row(place, f"{called}: median ", MEDIAN) for place, called in FORESTS.items()]
    arrived = [
        Claim(f"{preset}, {called}: share of walks that arrive (1)", "arrived", where, statistic=SHARE)
        for place, called in FORESTS.items()
        for where in [{"preset": preset, "place": place}]
    ]
    return [*(row(site, f"{called}: ", EXACT) for site, called in SITES.items()), *forests, *arrived]


def table(fast: bool, seed: int) -> StudyTable:
    """Fast takes fewer walks, by one reading of IA*'s waypoint."""
    walks, presets = (6, FAST_PRESETS) if fast else (40, PRESETS)
    points = grid(preset=presets, place=SITES, number=[0], seed=[seed])
    points += grid(preset=presets, place=FORESTS, number=range(walks), seed=[seed])
    return StudyTable(
        title="Cells that A* and incremental A* search behind a person [Following, Table 2]",
        caption=f"A robot follows a person among obstacles on a map of {FOLLOWING_CELLS} by {FOLLOWING_CELLS} cells of "
        f"0.1 m. The figures of the table are lost; its text says that A* visits more than {CLAIMED:g} times the cells "
        "of incremental A*, which is IA* here. Two walks on the site of 5 m, where the person waits behind what stands "
        f"or crosses there, and walks through forests, where the person strolls {AHEAD_M:g} m ahead at "
        f"{SPEED_MPS:g} m/s. All but the map and the site is our choice.",
        sizes=f"{walks} walks in each forest, seed {seed}.",
        study=Study(behind_person, points),
        groups=[
            Group(
                f"Table 2, preset {preset}",
                f"{of.words} {of.leader} leads, one cell a replan. Either site is one walk, and not judged. "
                "Intervals: of medians by order statistics; shares after Wilson.",
                ratio_rows(preset),
            )
            for preset, of in PRESETS.items()
        ],
    )
