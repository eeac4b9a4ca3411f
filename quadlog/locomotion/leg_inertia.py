"""A leg with mass: where it is heavy, how hard it is to swing aside, and how its swing turns the body.

All in the body, from the leg's own hip, on its abduction axis; the body moves evenly. side is +1 on the left and -1 on
the right. Rotors are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from quadlog.locomotion.robot import GRAVITY_MPS2, Robot
from quadlog.messages import Float


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


def abduction_inertia(robot: Robot, side: float, joints_rad: Float) -> float:
    """J1 in kg m^2 [Foot, eq. 11] of one posture (3,): the whole leg's about its abduction axis."""
    leg = leg_masses(robot, side, joints_rad[None])
    off_axis = leg.centres_m[0, :, 1:]
    return float(leg.masses_kg @ (off_axis**2).sum(axis=1) + leg.inertias_kgm2[0, :, 0, 0].sum())


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
