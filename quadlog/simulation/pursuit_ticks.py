"""One tick of pursuit: where a robot is beside its path, what it is told to do next, and the row that says so."""

from __future__ import annotations

import math

from quadlog.following.lookahead import LookaheadControl
from quadlog.following.path_follower import FollowState, PathFollower
from quadlog.messages import Float
from quadlog.simulation.course_robot import CourseRobot

TICK_COLUMNS = (
    *("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad", "vx_mps", "vy_mps", "yaw_rate_radps"),
    *("ref_x_m", "ref_y_m", "error_m", "cross_track_m", "time_error_m", "heading_error_rad"),
    *("lookahead_m", "k_v", "k_w", "cmd_v_mps", "cmd_yaw_rate_radps"),
    *(f"tau_{joint:02d}_nm" for joint in range(12)),
    *(f"fz_{leg}_n" for leg in range(4)),
    "fallen",
)
"""What is written for every tick, in this order: control.parquet without its times."""
POSE, VELOCITY, REFERENCE, LOOKAHEAD, COMMAND, EFFORT, FALLEN = (
    TICK_COLUMNS.index(name) for name in ("x_m", "vx_mps", "ref_x_m", "lookahead_m", "cmd_v_mps", "tau_00_nm", "fallen")
)


class FollowedPath:
    """A path (K, 2) under way: where the robot is on it, and where it takes itself to be by the pose it knows."""

    def __init__(self, path_m: Float, speed_mps: float, max_yaw_rate_radps: float) -> None:
        self.speed_mps, self.max_yaw_rate_radps = speed_mps, max_yaw_rate_radps
        self.truth, self.known = PathFollower(path_m), PathFollower(path_m)


def follow_tick(
    row: Float, robot: CourseRobot, path: FollowedPath | None, lookahead: LookaheadControl, age_s: float, dt_s: float
) -> FollowState | None:
    """Writes a row (len(TICK_COLUMNS),) of NaN, the command for the next dt_s in it; returns where the robot truly is.

    path: age_s old; without one the robot is told to stand, and is nowhere. It is steered by the pose that it knows,
    disturbed as that may be; what is written of it is true.
    """
    x_m, y_m, yaw_rad = robot.pose.tolist()
    row[POSE:VELOCITY] = *robot.position_m.tolist(), *robot.rpy
    row[COMMAND], row[COMMAND + 1], row[FALLEN] = 0.0, 0.0, robot.fallen
    known_x_m, known_y_m, known_yaw_rad = robot.disturbances.measured(robot.t_s, robot.pose).tolist()
    place = None
    if path is not None:
        place = path.truth.step(x_m, y_m, yaw_rad)
        known = path.known.step(known_x_m, known_y_m, known_yaw_rad)
        ahead = lookahead.step(known.near.distance_m, dt_s, robot.velocity[0])
        command = path.known.pursue(
            known_x_m, known_y_m, known_yaw_rad, known, ahead.l_m, path.speed_mps, path.max_yaw_rate_radps
        )
        timed = path.truth.reference_at(age_s * path.speed_mps)
        away_m = math.hypot(timed.x_m - x_m, timed.y_m - y_m)
        near = place.near
        row[REFERENCE:LOOKAHEAD] = near.x_m, near.y_m, place.error_m, near.distance_m, away_m, place.heading_error_rad
        row[LOOKAHEAD:COMMAND] = ahead
        row[COMMAND], row[COMMAND + 1] = command.v_mps, command.yaw_rate_radps
    has_body = not math.isnan(robot.mass_kg)
    # A robot without a body has the speed that it is told at once.
    row[VELOCITY:REFERENCE] = robot.velocity if has_body else (row[COMMAND], 0.0, row[COMMAND + 1])
    row[EFFORT:FALLEN] = *robot.torques_nm.tolist(), *robot.foot_loads_n.tolist()
    return place
