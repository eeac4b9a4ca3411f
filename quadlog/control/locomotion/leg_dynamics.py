"""The masses of a leg, and the torques of a stance [Foot, eqs 3 and 5-8, corrected].

Joint angles and frames are those of quadlog.control.locomotion.kinematics. side is +1 on the left and -1 on the right.
Lengths L1, L2, L3 as (3,) in metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.kinematics import leg_inverse, leg_jacobian, leg_position
from quadlog.control.locomotion.robot import Robot
from quadlog.messages import GRAVITY_MPS2, Float

KNEE_BEHIND, KNEE_IN_FRONT = 1.0, -1.0
"""Where the knee is, seen from the line between hip and foot: behind as an elbow, or in front."""
LEFT_FORE_RIGHT_HIND, RIGHT_FORE_LEFT_HIND = 1.0, -1.0
"""The two pairs of support legs: the sign of the diagonal's slope, seen from above."""


def diagonal_m(length_m: float, width_m: float) -> float:
    """D: how far the two support feet are from one another."""
    return math.hypot(length_m, width_m)


def diagonal_moment(weight_n: float, ahead_m: float, length_m: float, width_m: float, pair: float) -> Float:
    """(3,) gravity's moment in N m about the support diagonal, in the body; positive y tips it onto its nose.

    ahead_m: the centre of mass ahead of the middle between the support feet, neither left nor right of it. length_m,
    width_m: between the feet, L_x and L_y + 2 L1. pair: LEFT_FORE_RIGHT_HIND or RIGHT_FORE_LEFT_HIND.
    Eq. 8 is ahead_m = -4 m d / (all mass): the total is M g d (L_y + 2 L1) / D with M = 4 m. The part about x
    alternates with the pair.
    """
    lever = weight_n * ahead_m * width_m / diagonal_m(length_m, width_m) ** 2
    return lever * np.array([pair * length_m, width_m, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class LegMasses:
    """A leg's links, abduction link, thigh, and shank with foot, in each of N postures.

    masses_kg: (3,); centres_m: (N, 3, 3) their centres of mass, link by link; inertias_kgm2: (N, 3, 3, 3) of each
    about its own centre; axes: (N, 3, 3) of the joints.
    """

    masses_kg: Float
    centres_m: Float
    inertias_kgm2: Float
    axes: Float


def leg_masses(robot: Robot, side: float, joints_rad: Float) -> LegMasses:
    """The masses of a robot's leg at joints (N, 3)."""
    count, (aside_m, thigh_m, _) = len(joints_rad), robot.lengths_m
    mirror = np.array([1.0, side, 1.0])
    to_next = np.array([[0.0, side * aside_m, 0.0], [0.0, 0.0, -thigh_m], [0.0, 0.0, 0.0]])
    turn, place = Rotation.identity(count), np.zeros((count, 3))
    centres, inertias, axes = np.empty((count, 3, 3)), np.empty((count, 3, 3, 3)), np.empty((count, 3, 3))
    for k, (link, axis) in enumerate(zip(robot.links, np.array([[1, 0, 0], [0, -1, 0], [0, -1, 0]]), strict=True)):
        axes[:, k] = turn.apply(axis)
        turn = turn * Rotation.from_rotvec(np.asarray(joints_rad)[:, k, None] * axis)
        centres[:, k] = place + turn.apply(mirror * link.centre_m)
        matrix = turn.as_matrix()
        inertias[:, k] = matrix @ np.diag(link.inertia_kgm2) @ matrix.transpose(0, 2, 1)
        place = place + turn.apply(to_next[k])
    return LegMasses(np.array([link.mass_kg for link in robot.links]), centres, inertias, axes)


def mass_behind(robot: Robot, side: float, joints_rad: Float) -> tuple[float, float]:
    """Mass m in kg and d in metres [Foot, eq. 7] of one posture (3,): thigh and shank, and how far behind the hip."""
    leg = leg_masses(robot, side, joints_rad[None])
    mass = float(leg.masses_kg[1:].sum())
    return mass, -float(leg.masses_kg[1:] @ leg.centres_m[0, 1:, 0]) / mass


def swing_reaction(
    robot: Robot, side: float, t_s: Float, joints_rad: Float, gravity_mps2: float = GRAVITY_MPS2
) -> Float:
    """(N, 3) the couple in N m with which a leg in the air turns the body at its hip, of joints (N, 3) at times (N,).

    It is the moment of the leg's weight about the hip less what its angular momentum gains. Rates are those of cubic
    splines through the samples, so that these should be close together and the motion smooth.
    """
    leg = leg_masses(robot, side, joints_rad)
    velocities = CubicSpline(t_s, leg.centres_m)(t_s, 1)
    rates = CubicSpline(t_s, joints_rad)(t_s, 1)
    # A link turns with all joints before it.
    angular = np.cumsum(rates[:, :, None] * leg.axes, axis=1)
    spin = np.einsum("nkij,nkj->ni", leg.inertias_kgm2, angular)
    momentum = np.einsum("k,nki->ni", leg.masses_kg, np.cross(leg.centres_m, velocities)) + spin
    gain: Float = CubicSpline(t_s, momentum)(t_s, 1)
    weight = np.cross(leg.centres_m, [0.0, 0.0, -gravity_mps2])
    return np.einsum("k,nki->ni", leg.masses_kg, weight) - gain


def stance_feet(side: float, lengths: Float, height_m: float, stride_m: float, count: int) -> Float:
    """(count, 3) a foot during a stance, evenly from half a stride ahead of the hip to half a stride behind [eq. 5].

    It stays straight under its leg's plane, height_m below the hip.
    """
    feet = np.empty((count, 3))
    feet[:, 0] = np.linspace(stride_m / 2, -stride_m / 2, count)
    feet[:, 1], feet[:, 2] = side * lengths[0], -height_m
    return feet


def stance_joints(feet_m: Float, side: float, lengths: Float, knee: float) -> Float:
    """(N, 3) joints for feet (N, 3) from the hip, in the body; NaN where a foot is out of reach [eq. 3, corrected].

    knee: KNEE_BEHIND or KNEE_IN_FRONT.
    """
    joints, near = np.empty((len(feet_m), 3)), np.empty(3)
    for row, foot in zip(joints, np.asarray(feet_m), strict=True):
        if not leg_inverse(foot, side, lengths, row):
            row[:] = np.nan
        elif knee < 0:
            # The same triangle, mirrored in the line from hip to foot, in the leg's plane.
            leg_position(np.array([0.0, row[1], row[2]]), side, lengths, near)
            row[1:] = 2 * math.atan2(near[0], -near[2]) - row[1], -row[2]
    return joints


def stance_torques(joints_rad: Float, force_n: Float, side: float, lengths: Float) -> Float:
    """(N, 3) motor torques in N m of joints (N, 3) that hold a force (3,) of the ground on the foot [eq. 6].

    torque = -J' force: motors and ground do no work together on links without mass.
    """
    torques, jacobian = np.empty((len(joints_rad), 3)), np.empty((3, 3))
    for row, joints in zip(torques, joints_rad, strict=True):
        leg_jacobian(joints, side, lengths, jacobian)
        row[:] = -jacobian.T @ force_n
    return torques


def hip_reaction(feet_m: Float, force_n: Float) -> Float:
    """(N, 3) the couple in N m with which a leg turns the body at its hip, beside the force itself, of feet (N, 3).

    Its parts along the axes of abduction and hip are the motors' torques, taken backwards.
    """
    return np.cross(feet_m, force_n)
