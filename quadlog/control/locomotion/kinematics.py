"""Where a leg's foot is, how to bring it somewhere, and how fast it moves [Tracking, eqs 1-2, corrected].

From the hip, with side = +1 on the left and -1 on the right, and r = L2 cos(t2) + L3 cos(t2 + t3):
x = L2 sin(t2) + L3 sin(t2 + t3), y = side L1 cos(t1) + r sin(t1), z = side L1 sin(t1) - r cos(t1). Joint axes are
(1, 0, 0), (0, -1, 0) and (0, -1, 0); with a knee angle t3 >= 0 the knee is behind. Lengths L1, L2, L3 as (3,).
"""

from __future__ import annotations

import math

from quadlog.messages import Float

# Shorter, a distance has no direction that floats could tell.
NO_DISTANCE_M = 1e-9


def leg_position(joints_rad: Float, side: float, lengths: Float, foot_m: Float) -> None:
    """Writes the foot (3,) from the hip, in the body, of a leg's joints (3,)."""
    t1, t2, t23 = joints_rad[0], joints_rad[1], joints_rad[1] + joints_rad[2]
    reach, aside = lengths[1] * math.cos(t2) + lengths[2] * math.cos(t23), side * lengths[0]
    foot_m[0] = lengths[1] * math.sin(t2) + lengths[2] * math.sin(t23)
    foot_m[1] = aside * math.cos(t1) + reach * math.sin(t1)
    foot_m[2] = aside * math.sin(t1) - reach * math.cos(t1)


def leg_jacobian(joints_rad: Float, side: float, lengths: Float, jacobian: Float) -> None:
    """Writes (3, 3): the foot's velocity from the hip, in the body, per joint velocity."""
    t1, t2, t23 = joints_rad[0], joints_rad[1], joints_rad[1] + joints_rad[2]
    cos, sin = math.cos(t1), math.sin(t1)
    shank_x, shank_r = lengths[2] * math.sin(t23), lengths[2] * math.cos(t23)
    x, reach, aside = lengths[1] * math.sin(t2) + shank_x, lengths[1] * math.cos(t2) + shank_r, side * lengths[0]
    jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = 0.0, reach, shank_r
    jacobian[1, 0], jacobian[1, 1], jacobian[1, 2] = reach * cos - aside * sin, -sin * x, -sin * shank_x
    jacobian[2, 0], jacobian[2, 1], jacobian[2, 2] = reach * sin + aside * cos, cos * x, cos * shank_x


def leg_inverse(foot_m: Float, side: float, lengths: Float, joints_rad: Float) -> bool:
    """Writes the joints (3,), knee behind, for a foot (3,) from the hip; False when it is out of reach.

    Then the foot comes as near as it can in the leg's plane: stretched or folded towards the target.
    """
    aside, thigh, shank = lengths[0], lengths[1], lengths[2]
    x, y, z = foot_m[0], foot_m[1], foot_m[2]
    across = math.hypot(y, z)
    down = math.sqrt(max((across - aside) * (across + aside), 0.0))
    abduction = math.atan2(y, -z) - side * math.atan2(aside, down)
    if abduction > math.pi:
        abduction -= 2 * math.pi
    elif abduction <= -math.pi:
        abduction += 2 * math.pi
    wanted = math.hypot(x, down)
    distance = min(max(wanted, abs(thigh - shank)), thigh + shank)
    knee = (distance * distance - thigh * thigh - shank * shank) / (2 * thigh * shank)
    joints_rad[0] = abduction
    joints_rad[2] = math.acos(min(max(knee, -1.0), 1.0))
    # Folded onto the hip itself, thigh and shank being equally long, any direction of the thigh is right.
    if distance > NO_DISTANCE_M:
        bend = (distance * distance + thigh * thigh - shank * shank) / (2 * thigh * distance)
        joints_rad[1] = math.atan2(x, down) - math.acos(min(max(bend, -1.0), 1.0))
    else:
        joints_rad[1] = -0.5 * math.pi
    return across >= aside and abs(wanted - distance) <= 1e-12


def foot_positions(joints_rad: Float, hips_m: Float, lengths: Float, feet_m: Float) -> None:
    """Writes the feet (4, 3) in the body of joints (12,); hips_m: (4, 3), the left legs first in each pair."""
    for leg in range(4):
        leg_position(joints_rad[3 * leg : 3 * leg + 3], 1.0 - 2.0 * (leg % 2), lengths, feet_m[leg])
        for axis in range(3):
            feet_m[leg, axis] += hips_m[leg, axis]


def joints_for(feet_m: Float, hips_m: Float, lengths: Float, joints_rad: Float) -> bool:
    """Writes the joints (12,) for feet (4, 3) in the body; False when one of them is out of reach."""
    reached = True
    for leg in range(4):
        reached &= leg_inverse(
            feet_m[leg] - hips_m[leg], 1.0 - 2.0 * (leg % 2), lengths, joints_rad[3 * leg : 3 * leg + 3]
        )
    return reached
