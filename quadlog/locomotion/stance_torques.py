"""What a leg's motors do while its foot pushes off the ground, and what of it the body feels [Foot, eqs 5-6].

All in the body: x forward, y left, z up; feet from the leg's own hip, on its abduction axis. Links weigh nothing here.
side is +1 on the left and -1 on the right; lengths L1, L2, L3 as (3,) in metres.
"""

from __future__ import annotations

import numpy as np

from quadlog.locomotion.dh_leg import BODY_FROM_DH, dh_inverse
from quadlog.locomotion.kinematics import leg_jacobian
from quadlog.messages import Float


def stance_feet(side: float, lengths: Float, height_m: float, stride_m: float, count: int) -> Float:
    """(count, 3) a foot during a stance, evenly from half a stride ahead of the hip to half a stride behind [eq. 5].

    It stays straight under its leg's plane, height_m below the hip.
    """
    feet = np.empty((count, 3))
    feet[:, 0] = np.linspace(stride_m / 2, -stride_m / 2, count)
    feet[:, 1], feet[:, 2] = side * lengths[0], -height_m
    return feet


def stance_joints(feet_m: Float, side: float, lengths: Float, knee: float) -> Float:
    """(N, 3) joints for feet (N, 3), NaN where a foot is out of reach; knee as dh_inverse takes it."""
    joints = np.empty((len(feet_m), 3))
    for row, foot in zip(joints, np.asarray(feet_m), strict=True):
        found, reached = dh_inverse(BODY_FROM_DH.T @ foot, side, lengths, knee)
        row[:] = found if reached else np.nan
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
