"""Walks as a robot really goes them: each planner leads its own, and the robot follows the smoothed paths."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quadlog.following.path import nearest_on_path
from quadlog.following.pure_pursuit import pure_pursuit
from quadlog.messages import Float
from quadlog.planning.polyline import arc_lengths
from quadlog.planning.protocol import Planner
from quadlog.planning.replan import Replanner, ReplanSettings
from quadlog.simulation.clearance import body_clearance, occupied_centres
from quadlog.simulation.kinematic import unicycle_step
from quadlog.simulation.planning_walk import MOST_REPLANS, PATIENCE, Instant, look
from quadlog.simulation.planning_worlds import World

# The robot's size is printed [Planning, section 4]. How it follows is not: these are ours, and no figure chose them.
BODY_M = (1.1, 0.5)
LOOKAHEAD_M, MAX_YAW_RATE_RADPS = 0.5, 1.5
TICK_S, TICKS_PER_REPLAN = 0.07, 5
"""A replan each 0.35 s, in which the robot walks one cell."""
AT_GOAL_M = 0.1


@dataclass(frozen=True, slots=True)
class PursuedWalk:
    """path_xy_m (T, 2) and yaw_rad (T,) in map, a tick apart, the last within AT_GOAL_M of the goal if it arrived.

    clearance_m: the least between body and obstacles, <= 0 where they touched.
    """

    path_xy_m: Float
    yaw_rad: Float
    clearance_m: float
    arrived: bool

    @property
    def length_m(self) -> float:
        """Of the way really walked."""
        return float(arc_lengths(self.path_xy_m)[-1])

    @property
    def duration_s(self) -> float:
        """From start to goal."""
        return (len(self.yaw_rad) - 1) * TICK_S

    @property
    def turning_radpm(self) -> float:
        """Changes of heading, left and right alike, for each metre."""
        return float(np.abs(np.diff(np.unwrap(self.yaw_rad))).sum()) / self.length_m


def pursue(world: World, planner: Planner, most_replans: int = MOST_REPLANS) -> PursuedWalk:
    """Walk from the world's start, looking at the goal, until there, stuck or out of replans; see walk_world.

    The goal must stand still.
    """
    replanner = Replanner(planner, ReplanSettings(world.dilation_m, world.dilation, stop_short_m=0.0))
    goal_m = world.goal.at(0)
    to_goal_m = goal_m - world.start_xy_m
    pose = (float(world.start_xy_m[0]), float(world.start_xy_m[1]), math.atan2(to_goal_m[1], to_goal_m[0]))
    path_m: Float = np.empty((0, 2))
    walked: list[Float] = []
    waited = 0
    while waited <= PATIENCE and len(walked) < most_replans:
        here_m = np.array(pose[:2])
        t_ns = round(1e9 * len(walked) * TICKS_PER_REPLAN * TICK_S)
        instant = look(world, here_m, t_ns)
        path = replanner.replan(t_ns, instant.window, instant.occupied, here_m, goal_m).path
        if path is not None:
            path_m = path.smooth_xy_m
        rows = _follow(pose, path_m, instant, world.speed_mps)
        there = np.flatnonzero(np.hypot(*(rows[:, :2] - goal_m).T) <= AT_GOAL_M)
        if len(there):
            return _walk([*walked, rows[: there[0] + 1]], arrived=True)
        # The last one is the next replan's first.
        walked.append(rows[:-1])
        x, y, yaw = rows[-1, :3].tolist()
        waited = 0 if (x, y) != pose[:2] else waited + 1
        pose = x, y, yaw
    return _walk(walked, arrived=False)


def _follow(pose: tuple[float, float, float], path_m: Float, instant: Instant, speed_mps: float) -> Float:
    """Ticks along a path (K, 2) until the next replan: pose and clearance, (TICKS_PER_REPLAN + 1, 4), the first now."""
    centres_m = occupied_centres(instant.occupied, instant.window)
    rows = np.empty((TICKS_PER_REPLAN + 1, 4))
    x, y, yaw = pose
    for row in rows:
        row[:3] = x, y, yaw
        row[3] = body_clearance(x, y, yaw, *BODY_M, centres_m, instant.window.cell_m)
        if len(path_m):
            near = nearest_on_path(path_m, x, y)
            command = pure_pursuit(x, y, yaw, path_m, near, LOOKAHEAD_M, speed_mps, MAX_YAW_RATE_RADPS)
            x, y, yaw = unicycle_step(x, y, yaw, command.v_mps, command.yaw_rate_radps, TICK_S)
    return rows


def _walk(walked: list[Float], arrived: bool) -> PursuedWalk:
    rows = np.concatenate(walked)
    return PursuedWalk(rows[:, :2], rows[:, 2], float(rows[:, 3].min()), arrived)
