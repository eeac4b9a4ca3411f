"""planning-1: ways that robots really walk, each led by its own planner [Planning, Table 1, Figs 5, 16, 17]."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np

from quadlog.control.following.path import nearest_on_path
from quadlog.control.following.pure_pursuit import PathFollower
from quadlog.geometry import arc_lengths, wrap_angle
from quadlog.messages import Float
from quadlog.pipelines.tables.claims import Change, Claim, Figures, Group, Ratio, Study, StudyTable, grid
from quadlog.pipelines.tables.judge import MEAN, SHARE, SIZE, always, beyond, not_comparable, runs, share_of
from quadlog.pipelines.tables.planning_2 import DENSITIES_PER_M2, FAST_PRESETS, PRESETS, forest_of
from quadlog.planning.protocol import Planner
from quadlog.planning.query import Growth
from quadlog.planning.registry import make_planner
from quadlog.planning.replan import Replanner
from quadlog.simulation.robot.unicycle_robot import unicycle_step
from quadlog.simulation.worlds import replanning_walk as walks
from quadlog.simulation.worlds.world import SPEED_MPS, World, body_clearance, occupied_centres

# The robot's size is printed [Planning, section 4]. How it follows is not: these are ours, and no figure chose them.
BODY_M = (1.1, 0.5)
LOOKAHEAD_M, MAX_YAW_RATE_RADPS = 0.5, 1.5
TICK_S, TICKS_PER_REPLAN = 0.07, 5
"""A replan each 0.35 s, in which the robot walks one cell."""
AT_GOAL_M = 0.1


def pursue(world: World, planner: Planner) -> Figures:
    """Walk from the world's start, looking at the goal, until there, stuck or out of replans; see walk_world.

    The goal must stand still. Whether it arrived and whether its body touched an obstacle; of one that arrived, length
    and time of the way really walked.
    """
    replanner = Replanner(planner, Growth(world.dilation_m, world.dilation))
    goal_m = world.goal.at(0)
    to_goal_m = goal_m - world.start_xy_m
    pose = (float(world.start_xy_m[0]), float(world.start_xy_m[1]), math.atan2(to_goal_m[1], to_goal_m[0]))
    follower: PathFollower | None = None
    walked: list[Float] = []
    waited = 0
    while waited <= walks.PATIENCE and len(walked) < walks.MOST_REPLANS:
        here_m = np.array(pose[:2])
        t_ns = round(1e9 * len(walked) * TICKS_PER_REPLAN * TICK_S)
        instant = walks.look(world, here_m, t_ns)
        path = replanner.replan(t_ns, instant.window, instant.occupied, here_m, goal_m).path
        if path is not None:
            follower = PathFollower(path.smooth_xy_m)
        rows = _follow(pose, follower, instant, world.speed_mps)
        there = np.flatnonzero(np.hypot(*(rows[:, :2] - goal_m).T) <= AT_GOAL_M)
        if len(there):
            return _figures(np.concatenate([*walked, rows[: there[0] + 1]]), arrived=True)
        # The last one is the next replan's first.
        walked.append(rows[:-1])
        x, y, yaw = rows[-1, :3].tolist()
        waited = 0 if (x, y) != pose[:2] else waited + 1
        pose = x, y, yaw
    return _figures(np.concatenate(walked), arrived=False)


def _follow(
    pose: tuple[float, float, float], follower: PathFollower | None, instant: walks.ReplanInstant, speed_mps: float
) -> Float:
    """Ticks until the next replan, along a path if there is one: pose and clearance, (TICKS_PER_REPLAN + 1, 4), the
    first now.
    """
    centres_m = occupied_centres(instant.occupied, instant.window)
    rows = np.empty((TICKS_PER_REPLAN + 1, 4))
    x, y, yaw = pose
    for row in rows:
        row[:3] = x, y, yaw
        row[3] = body_clearance(x, y, yaw, *BODY_M, centres_m, instant.window.cell_m)
        if follower is not None:
            place = follower.step(x, y, yaw)
            command = follower.pursue(x, y, yaw, place, LOOKAHEAD_M, speed_mps, MAX_YAW_RATE_RADPS)
            x, y, yaw = unicycle_step(x, y, yaw, command.v_mps, command.yaw_rate_radps, TICK_S)
    return rows


def _figures(rows: Float, arrived: bool) -> dict[str, float]:
    """Of rows (T, 4) a tick apart: pose and clearance, <= 0 where the body touches."""
    touched = bool(rows[:, 3].min() <= 0)
    found = {"arrived": float(arrived), "touched": float(touched), "clean": float(arrived and not touched)}
    if arrived:
        found["length_m"] = float(arc_lengths(rows[:, :2])[-1])
        found["time_s"] = (len(rows) - 1) * TICK_S
    return found


def coherence(walk: walks.WorldWalk) -> Figures:
    """How plans follow one another on a walk cell by cell, means over its replans; one without a path is left out.

    change_m: distance of a path from the one before, see path_change_m. start_turn_rad: how much the direction of a
    path's first step differs from that of the one before.
    """
    found = [(each.window, plan) for each, plan in zip(walk.instants, walk.plans, strict=True) if plan.found]
    paths_m = [window.centre_of(plan.cells) for window, plan in found]
    steps = [path_m[1] - path_m[0] for path_m in paths_m if len(path_m) > 1]
    changes_m = [path_change_m(before, after) for before, after in pairwise(paths_m)]
    turns_rad = np.abs(wrap_angle(np.diff([math.atan2(*step[::-1]) for step in steps])))
    return {
        "change_m": float(np.mean(changes_m or [0])),
        "start_turn_rad": float(turns_rad.mean()) if len(turns_rad) else 0.0,
    }


def path_change_m(before_m: Float, after_m: Float) -> float:
    """How far a new path (K, 2) lies from the one before (L, 2): the mean distance of its points from it.

    Only as much of the new path counts as was left of the old one from where the new one begins: what is added beyond
    is no change of mind. 0 for a path that goes on as planned.
    """
    arc_before, arc_after = arc_lengths(before_m), arc_lengths(after_m)
    left = arc_before[-1] - arc_before[np.hypot(*(before_m - after_m[0]).T).argmin()]
    return float(np.mean([abs(nearest_on_path(before_m, *at).distance_m) for at in after_m[arc_after <= left + 1e-9]]))


PLANNERS = ("A*", "IA*")


def through_forest(preset: str, density_per_m2: float, number: int, planner: str, seed: int) -> Figures:
    """A robot's walk through a held-out forest, and one cell by cell, both led by the planner."""
    of = PRESETS[preset]
    name = of.baseline if planner == "A*" else of.ia_star
    world = forest_of(density_per_m2, number, of.dilation, seed)
    walked = pursue(world, make_planner(name, of.rules))
    return {**walked, **coherence(walks.walk_world(world, make_planner(name, of.rules)))}


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
LENGTH_RATIO, TIME_RATIO = LENGTH_M[1] / LENGTH_M[0], TIME_S[1] / TIME_S[0]
SET_BY = "Set by how far our goals are away."
EVEN = f"Ours walks at {SPEED_MPS:g} m/s throughout and loses nothing by turning; the printed robot is not published."


PAIRED: dict[str, Any] = {"part": {"planner": "IA*"}, "whole": {"planner": "A*"}, "pair": ("number",)}
LESS, MORE = share_of(lambda ratios: ratios < 1), share_of(lambda ratios: ratios > 1)


def length_rows(preset: str, density: float) -> list[Claim]:
    """Table 1 by one preset in one forest, of the walks on which both arrive."""
    where, which = {"preset": preset, "density_per_m2": density}, f"{preset}, {density:g} trees/m²"
    printed = tuple(LENGTH_RATIO.tolist())
    mean, less = runs(printed, float(LENGTH_RATIO.mean()), 1.0), runs(printed, float(np.mean(LENGTH_RATIO < 1)), 0.5)
    time, more = (not_comparable(float(each.mean()), EVEN) for each in (TIME_RATIO, TIME_RATIO > 1))
    rows: list[Claim] = []
    for what, column, judge, statistic in (
        ("length of IA* over that of A*, mean", "length_m", mean, MEAN),
        ("length: share of walks in which IA* is shorter", "length_m", less, LESS),
        ("time of IA* over that of A*, mean", "time_s", time, MEAN),
        ("time: share of walks in which IA* is slower", "time_s", more, MORE),
    ):
        rows.append(Ratio(f"{which}: {what} (1)", column, where, judge, statistic, of=what, **PAIRED))
    for at, name in enumerate(PLANNERS):
        mine = {**where, "planner": name}
        for column, unit, of_both, why in (("length_m", "m", LENGTH_M, SET_BY), ("time_s", "s", TIME_S, EVEN)):
            what = f"{column.partition('_')[0]}, mean, {name}"
            judge = not_comparable(float(of_both[at].mean()), why)
            rows.append(Claim(f"{which}: {what} ({unit})", column, mine, judge, SIZE, of=what))
    return rows


def collision_rows(preset: str, density: float) -> list[Claim]:
    """The claims on collisions."""
    where, which = {"preset": preset, "density_per_m2": density}, f"{preset}, {density:g} trees/m²"
    may = not_comparable(None, "Claimed: it may. One collision would do, so that no share contradicts it.", "may touch")
    clean, touched, less = (
        "share of IA*'s walks that arrive and touch nothing",
        "share of A*'s walks that touch a trunk",
        "share of walks that touch, IA* less A*",
    )
    every, below = always("Claimed: all."), beyond(0.0, above=False, why="Claimed: less than 0.")
    return [
        Claim(f"{which}: {clean} (1)", "clean", {**where, "planner": "IA*"}, every, SHARE, of=clean),
        Claim(f"{which}: {touched} (1)", "touched", {**where, "planner": "A*"}, may, SHARE, of=touched),
        Change(f"{which}: {less} (1)", "touched", where, below, of=less, **PAIRED),
    ]


COHERENCE = {
    "change_m": "change of the path between replans, IA* less A* (m)",
    "start_turn_rad": "turn of the first step between replans, IA* less A* (rad)",
}


def coherence_rows(preset: str, density: float) -> list[Claim]:
    """The claims on coherence."""
    where, which = {"preset": preset, "density_per_m2": density}, f"{preset}, {density:g} trees/m²"
    below = beyond(0.0, above=False, why="Claimed: less than 0.")
    return [Change(f"{which}: {what}", column, where, below, of=what, **PAIRED) for column, what in COHERENCE.items()]


SETTINGS = [(preset, density) for preset in PRESETS for density in DENSITIES_PER_M2]


def table(fast: bool, seed: int) -> StudyTable:
    """Fast walks as often as the paper and no more, by one reading of IA*'s waypoint."""
    walks, presets = (LENGTH_M.shape[1], FAST_PRESETS) if fast else (40, PRESETS)
    factors = {"preset": presets, "density_per_m2": DENSITIES_PER_M2, "number": range(walks), "planner": PLANNERS}
    return StudyTable(
        title="Lengths and times of the ways of A* and IA* [Planning, Table 1]",
        caption="Two robots walk through the same forest to the same goal, one led by A*, one by IA*. The paper prints "
        "ten pairs of walks of a simulated quadruped in a forest of its own. Our trees stand at random, 0.1 or 0.2 to "
        "a square metre, with goals 15 to 25 m away, and a kinematic robot walks.",
        sizes=f"{walks} walks of each planner through each forest and preset, seed {seed}.",
        study=Study(through_forest, grid(**factors, seed=[seed])),
        groups=[
            *(
                Group(
                    f"Table 1, preset {preset}",
                    f"{PRESETS[preset].words} Each leads its own walk through the same forests. A kinematic robot "
                    f"follows the smoothed path by pure pursuit, looking {LOOKAHEAD_M:g} m ahead at {SPEED_MPS:g} m/s, "
                    "the mean speed of A* in Table 1; the rest is our choice. Two samples are compared, ours and the "
                    "printed ten, by permutations. Intervals: Student; shares after Wilson.",
                    [row for density in DENSITIES_PER_M2 for row in length_rows(preset, density)],
                )
                for preset in PRESETS
            ),
            Group(
                "Arrives with no collision",
                "With A* the robot may collide, the paper says, while IA*'s route gets there with no collision; it "
                "shows one pair of walks. One collides where the robot's body of "
                f"{BODY_M[0]:g} by {BODY_M[1]:g} m, as printed, touches a trunk. Intervals: Student; shares: Wilson.",
                [row for setting in SETTINGS for row in collision_rows(*setting)],
            ),
            Group(
                "Coherence of the paths [Planning, Fig. 5]",
                "IA*'s paths are more coherent than A*'s, the paper says, so that the robot's orientation fluctuates "
                "less; its conclusions say that IA* changes the course more often. Ours: the mean distance of a path "
                "from the one before, and how much the direction of the first step changes. Intervals: Student.",
                [row for setting in SETTINGS for row in coherence_rows(*setting)],
            ),
        ],
    )
