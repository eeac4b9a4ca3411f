"""One tick between two maps: where the robot is beside its plan, and what it is told to do next."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from quadlog.following.lookahead import LookaheadControl
from quadlog.following.path_follower import PathFollower
from quadlog.messages import Float
from quadlog.simulation.course_walk import COLUMNS, CourseRobot

if TYPE_CHECKING:
    from quadlog.simulation.resimulation import PursuitSettings

TICK_COLUMNS = (*COLUMNS, "clearance_m", "fallen")
"""What is written for every tick, in this order."""
POSE, REFERENCE, LOOKAHEAD, COMMAND, EFFORT, CLEARANCE, FALLEN = (
    TICK_COLUMNS.index(name)
    for name in ("x_m", "ref_x_m", "lookahead_m", "cmd_v_mps", "tau_00_nm", "clearance_m", "fallen")
)


class FollowedPlan:
    """A plan (K, 2) under way: where the robot is on it, and where it takes itself to be by the pose it knows."""

    def __init__(self, path_m: Float) -> None:
        self.truth, self.known = PathFollower(path_m), PathFollower(path_m)


def follow_tick(
    row: Float,
    robot: CourseRobot,
    plan: FollowedPlan | None,
    lookahead: LookaheadControl,
    age_s: float,
    settings: PursuitSettings,
    dt_s: float,
) -> None:
    """Writes a row (len(TICK_COLUMNS),) but for its clearance, the command for the next dt_s in it.

    plan: age_s old; without one the robot is told to stand. It is steered by the pose that it knows, disturbed as
    that may be; what is written of it is true.
    """
    x_m, y_m, yaw_rad = robot.pose.tolist()
    row[POSE : POSE + 6] = *robot.position_m.tolist(), *robot.rpy
    row[COMMAND], row[COMMAND + 1], row[FALLEN] = 0.0, 0.0, robot.fallen
    known_x_m, known_y_m, known_yaw_rad = robot.disturbances.measured(robot.t_s, robot.pose).tolist()
    if plan is not None:
        place = plan.truth.step(x_m, y_m, yaw_rad)
        known = plan.known.step(known_x_m, known_y_m, known_yaw_rad)
        ahead = lookahead.step(known.near.distance_m, dt_s, robot.velocity[0])
        command = plan.known.pursue(
            known_x_m, known_y_m, known_yaw_rad, known, ahead.l_m, settings.speed_mps, settings.max_yaw_rate_radps
        )
        planned = plan.truth.reference_at(age_s * settings.speed_mps)
        away_m = math.hypot(planned.x_m - x_m, planned.y_m - y_m)
        near = place.near
        row[REFERENCE : REFERENCE + 6] = (
            near.x_m,
            near.y_m,
            place.error_m,
            near.distance_m,
            away_m,
            place.heading_error_rad,
        )
        row[LOOKAHEAD : LOOKAHEAD + 3] = ahead
        row[COMMAND], row[COMMAND + 1] = command.v_mps, command.yaw_rate_radps
    has_body = not math.isnan(robot.mass_kg)
    # A robot without a body has the speed that it is told at once.
    row[POSE + 6 : POSE + 9] = robot.velocity if has_body else (row[COMMAND], 0.0, row[COMMAND + 1])
    row[EFFORT : EFFORT + 16] = *robot.torques_nm.tolist(), *robot.foot_loads_n.tolist()
