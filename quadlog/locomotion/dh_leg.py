"""A leg as a chain of four links after Denavit and Hartenberg [Foot, Table 1 and eq. 1; the rest corrected].

Frame {0} lies at the hip, on the abduction axis: x down, y left, z forward, so that body = BODY_FROM_DH @ dh. The joint
angles are those of quadlog.locomotion.kinematics. side is +1 on the left and -1 on the right, whose leg Table 1 gives;
the left leg's is its mirror image. Lengths L1, L2, L3 as (3,) in metres.
"""

from __future__ import annotations

import math

import numpy as np

from quadlog.locomotion.kinematics import leg_inverse, leg_position
from quadlog.messages import Float

BODY_FROM_DH: Float = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""(3, 3) turns a vector of frame {0} into the body: (x, y, z) = (P_z, P_y, -P_x)."""
KNEE_BEHIND, KNEE_IN_FRONT = 1.0, -1.0
"""Where the knee is, seen from the line between hip and foot: behind as an elbow, or in front."""


def dh_rows(side: float, lengths: Float) -> Float:
    """(4, 3) of Table 1: d in metres, a in metres and alpha in radians of every link."""
    aside, thigh, shank = lengths
    return np.array([[0.0, 0.0, 0.0], [-side * aside, 0.0, math.pi / 2], [0.0, thigh, 0.0], [0.0, shank, 0.0]])


def dh_transform(theta_rad: float, d_m: float, a_m: float, alpha_rad: float) -> Float:
    """(4, 4) the pose of a frame in the one before it [Foot, eq. 1]."""
    cos, sin, cos_a, sin_a = math.cos(theta_rad), math.sin(theta_rad), math.cos(alpha_rad), math.sin(alpha_rad)
    return np.array(
        [
            [cos, -sin, 0.0, a_m],
            [sin * cos_a, cos * cos_a, -sin_a, -sin_a * d_m],
            [sin * sin_a, cos * sin_a, cos_a, cos_a * d_m],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def dh_frames(joints_rad: Float, side: float, lengths: Float) -> Float:
    """(4, 4, 4) the poses in frame {0} of {1}, {2}, {3}, which turn with the joints (3,), and of {4} at the foot."""
    frames, pose = np.empty((4, 4, 4)), np.eye(4)
    for link, (theta, row) in enumerate(zip((*joints_rad, 0.0), dh_rows(side, lengths), strict=True)):
        pose = pose @ dh_transform(float(theta), *row)
        frames[link] = pose
    return frames


def dh_position(joints_rad: Float, side: float, lengths: Float) -> Float:
    """(3,) the foot in frame {0}, in metres, of a leg's joints (3,) [Foot, eq. 2, corrected]."""
    return dh_frames(joints_rad, side, lengths)[3, :3, 3]


def dh_jacobian(joints_rad: Float, side: float, lengths: Float) -> Float:
    """(3, 3) the foot's velocity in frame {0} per joint velocity [Foot, eq. 4, corrected].

    A joint moves the foot along its axis, the z of its frame, times the lever from that frame to the foot.
    """
    frames = dh_frames(joints_rad, side, lengths)
    levers = frames[3, :3, 3] - frames[:3, :3, 3]
    return np.cross(frames[:3, :3, 2], levers).T


def dh_inverse(foot_m: Float, side: float, lengths: Float, knee: float) -> tuple[Float, bool]:
    """Joints (3,) for a foot (3,) in frame {0}, and whether it is within reach [Foot, eq. 3, corrected].

    knee: KNEE_BEHIND or KNEE_IN_FRONT. Out of reach, the foot comes as near as it can in the leg's plane, stretched or
    folded towards the target, as in kinematics.leg_inverse.
    """
    joints, near = np.empty(3), np.empty(3)
    reached = leg_inverse(BODY_FROM_DH @ np.asarray(foot_m, dtype=np.float64), side, lengths, joints)
    if knee < 0:
        # The same triangle, mirrored in the line from hip to foot, in the leg's plane.
        leg_position(np.array([0.0, joints[1], joints[2]]), side, lengths, near)
        joints[1:] = 2 * math.atan2(near[0], -near[2]) - joints[1], -joints[2]
    return joints, bool(reached)
