"""The walk again, open loop: a simulated robot driven by the commands that the log's own robot was given.

It differs from the log by what simulation and reality differ by, and drifts apart for ever: nothing brings it back.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from quadlog.geometry import turned, wrap_angle
from quadlog.messages import NS_PER_S, Float, Int
from quadlog.planning.protocol import Bool
from quadlog.simulation.course_walk import COMMAND, LEFT, PLAN_ERROR, POSE, REFERENCE, TICK_COLUMNS, Driver

if TYPE_CHECKING:
    from quadlog.simulation.robot.walking_robot import WalkingRobot


def held(t_ns: Int, commands_ns: Int, twist: Float, hold_s: float) -> tuple[Float, Bool]:
    """(T, 3) the commands (N, 3) in force at t_ns (T,), and (T,) where one to move is older than hold_s.

    There they are 0, as before the first: a robot whose commands fail to come stops.
    """
    last = np.searchsorted(commands_ns, t_ns, side="right") - 1
    stale = (last >= 0) & (t_ns - commands_ns[last] > hold_s * NS_PER_S) & twist[last].any(axis=1)
    return np.where(((last >= 0) & ~stale)[:, None], twist[last], 0.0), stale


def walk_commanded(
    robot: WalkingRobot, driver: Driver, t_ns: Int, twist: Float, logged: Float
) -> dict[str, Float | Int | Bool]:
    """The columns of control.parquet at t_ns (T,), of the driver's robot, which walks by twist (T, 3) from where it is.

    logged (T, 3): x_m, y_m, yaw_rad of the log's robot, NaN where unknown. The reference path is its way, the heading
    error that beside its heading at the instant.
    """
    rows = np.full((len(t_ns), len(TICK_COLUMNS)), np.nan)
    for row, (ahead_mps, left_mps, yaw_rate_radps) in zip(rows, twist.tolist(), strict=True):
        driver.steer(row, None, None)
        row[COMMAND], row[COMMAND + 1], row[LEFT] = ahead_mps, yaw_rate_radps, left_mps
        robot.walk(driver.every, ahead_mps, yaw_rate_radps, left_mps)
    way = logged[np.isfinite(logged).all(axis=1)]
    if len(way):
        xy_m = rows[:, POSE : POSE + 2]
        near = way[cKDTree(way[:, :2]).query(xy_m)[1]]
        aside_m = turned(-near[:, 2], xy_m - near[:, :2])[:, 1]
        apart_m, apart_rad = np.hypot(*(logged[:, :2] - xy_m).T), wrap_angle(rows[:, POSE + 5] - logged[:, 2])
        rows[:, REFERENCE:PLAN_ERROR] = np.column_stack(
            [near[:, :2], np.hypot(*(near[:, :2] - xy_m).T), aside_m, apart_m, apart_rad]
        )
    columns = dict(zip(TICK_COLUMNS, rows.T, strict=True))
    return {"t_ns": t_ns, **columns, "fallen": columns["fallen"] > 0}
