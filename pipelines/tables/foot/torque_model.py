"""What the table foot-torque is made of: torques over a stance, what tips the body, and what a swinging leg does to it.

The robot is [Foot, Table 2]'s, with hips and links that are ours (locomotion/robot.py).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadlog.control.locomotion.foot_trajectory import FootCycle, lateral_peak_m
from quadlog.control.locomotion.leg_dynamics import (
    KNEE_BEHIND,
    LEFT_FORE_RIGHT_HIND,
    abduction_inertia,
    diagonal_moment,
    hip_reaction,
    mass_behind,
    stance_feet,
    stance_joints,
    stance_torques,
    swing_reaction,
)
from quadlog.control.locomotion.robot import GRAVITY_MPS2, ROBOTS
from quadlog.messages import Float

ROBOT = ROBOTS["foot"]
LEG_KG, HEIGHT_M, STRIDE_M, PERIOD_S, ACCELERATION_MPS2 = 0.5, 0.2, 0.05, 0.5, 0.08
"""Table 2; the links' lengths are the robot's."""
WALK_STRIDE_M, WALK_PERIOD_S, LIFT_M = 0.04, 1.0, 0.02
"""Section 4; its robot weighs 10 kg, which Table 2 does not say."""
HALF_BODY_KG = ROBOT.mass_kg / 2
"""What a support leg of a trot carries."""
STANCE_POINTS, SWING_POINTS = 101, 401
RIGHT = -1.0
LENGTH_M, WIDTH_M = 2 * ROBOT.hip_x_m, 2 * (ROBOT.hip_y_m + ROBOT.lengths_m[0])
"""Between the feet: L_x and L_y + 2 L1."""
WEIGHT_N = ROBOT.mass_kg * GRAVITY_MPS2


class OffCentre(NamedTuple):
    """The robot's mass off its middle, standing, where all legs are alike.

    leg_mass_kg, behind_m: m and d of eq. 7; ahead_m: the centre of mass ahead of the middle of the hips; moment_nm:
    M g d with M = 4 m.
    """

    leg_mass_kg: float
    behind_m: float
    ahead_m: float
    moment_nm: float


def off_centre() -> OffCentre:
    """What eqs 7 and 8 are about."""
    mass, behind = mass_behind(ROBOT, RIGHT, ROBOT.standing_joints_rad[3:6])
    return OffCentre(mass, behind, -4 * mass * behind / ROBOT.mass_kg, 4 * mass * GRAVITY_MPS2 * behind)


def swing_inertia_kgm2() -> float:
    """J1 of eq. 11, standing."""
    return abduction_inertia(ROBOT, RIGHT, ROBOT.standing_joints_rad[3:6])


def ground_force(carried_kg: float) -> Float:
    """(3,) what the ground pushes a support foot with: it carries that mass and speeds it up."""
    return carried_kg * np.array([ACCELERATION_MPS2, 0.0, GRAVITY_MPS2])


def feet_of(side: float) -> Float:
    """(STANCE_POINTS, 3) a support foot from its hip."""
    return stance_feet(side, ROBOT.lengths, HEIGHT_M, STRIDE_M, STANCE_POINTS)


def torques_of(side: float, knee: float, carried_kg: float) -> Float:
    """(STANCE_POINTS, 3) joint torques over a stance."""
    joints = stance_joints(feet_of(side), side, ROBOT.lengths, knee)
    return stance_torques(joints, ground_force(carried_kg), side, ROBOT.lengths)


def touch_down_about_diagonal() -> tuple[float, float]:
    """N m about the diagonal, backwards positive, as left fore and right hind foot touch down under half the body each.

    First of the couples at both hips, then of the forces there, about the middle between the feet.
    """
    force = ground_force(HALF_BODY_KG)
    couples, forces, ahead = np.zeros(3), np.zeros(3), np.array([STRIDE_M / 2, 0.0, -HEIGHT_M])
    for leg, side in ((0, 1.0), (3, -1.0)):
        couples += hip_reaction(feet_of(side)[:1], force)[0]
        forces += np.cross(ROBOT.hips_m[leg] - ahead, force)
    # From right to left: turning about it is tipping backwards for the body's own -y.
    axis = -np.array([LENGTH_M, WIDTH_M, 0.0]) / np.hypot(LENGTH_M, WIDTH_M)
    return float(couples @ axis), float(forces @ axis)


def gravity_over_stance(pair: float) -> tuple[Float, Float]:
    """Feet ahead of the hips in metres (N,), and gravity's moment about the diagonal (N, 3), in section 4's walk."""
    feet_ahead = np.linspace(WALK_STRIDE_M / 2, -WALK_STRIDE_M / 2, STANCE_POINTS)
    ahead_m = off_centre().ahead_m
    moments = [diagonal_moment(WEIGHT_N, ahead_m - foot, LENGTH_M, WIDTH_M, pair) for foot in feet_ahead]
    return feet_ahead, np.array(moments)


def behind_share() -> float:
    """The part of a stance's way on which the centre of mass is behind the diagonal."""
    return float(np.clip((WALK_STRIDE_M / 2 - off_centre().ahead_m) / WALK_STRIDE_M, 0.0, 1.0))


def swing_hip_reaction(gravity_mps2: float) -> Float:
    """(SWING_POINTS,) N m on the body about the hip's own axis while a leg swings as in eq. 9, without its y.

    Stride, period and height are Table 2's, the lift is section 4's.
    """
    cycle = FootCycle(PERIOD_S, STRIDE_M, LIFT_M)
    t_s = np.linspace(0.0, cycle.swing_share * PERIOD_S, SWING_POINTS)
    feet = cycle.at(t_s)[0] + [0.0, RIGHT * ROBOT.lengths_m[0], -HEIGHT_M]
    joints = stance_joints(feet, RIGHT, ROBOT.lengths, KNEE_BEHIND)
    # Straight under the leg's plane, the hip's axis is the body's -y.
    return -swing_reaction(ROBOT, RIGHT, t_s, joints, gravity_mps2)[:, 1]


def curve_peak_m(k: float) -> float:
    """The peak of y(t) in section 4's walk, M taken as positive."""
    moment = diagonal_moment(WEIGHT_N, off_centre().ahead_m, LENGTH_M, WIDTH_M, LEFT_FORE_RIGHT_HIND)[0]
    return lateral_peak_m(abs(float(moment)), k, swing_inertia_kgm2(), WALK_PERIOD_S)


def scale_for(peak_m: float) -> float:
    """The k whose peak is so large."""
    return abs(curve_peak_m(1.0)) / peak_m
