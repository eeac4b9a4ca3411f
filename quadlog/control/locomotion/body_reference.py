"""Where the body should be now and within the horizon, and where its feet should land on the ground under it."""

from __future__ import annotations

import math
from typing import Annotated

from quadlog.compiled import inlined, inner, kernel
from quadlog.control.locomotion.numba_record import Record
from quadlog.messages import Float

CAPTURE_S = 0.06
"""How far ahead a foot is put per speed that the robot is too fast: the capture point's gain, tuned on rough ground."""
_FLAT_M4 = 1e-8


@inner
def foothold(
    position_m: Float,
    yaw_rad: float,
    velocity_mps: Float,
    wanted_mps: Float,
    wanted_yaw_rate_radps: float,
    standing_foot_m: Float,
    until_landing_s: float,
    stance_s: float,
    plane: Float,
    foot_m: Float,
) -> None:
    """Writes where in map a foot (3,) should land: under the middle of its hip's way during the stance [Raibert].

    position_m, velocity_mps: (3,) of the body; wanted_mps: (3,) where it should go, all in map.
    standing_foot_m: (3,) the foot in the body when standing, of which x and y count.
    plane: (3,) of the ground, see fit_plane; the height is taken from it.
    """
    yaw = yaw_rad + wanted_yaw_rate_radps * until_landing_s
    cos, sin = math.cos(yaw), math.sin(yaw)
    arm_x = cos * standing_foot_m[0] - sin * standing_foot_m[1]
    arm_y = sin * standing_foot_m[0] + cos * standing_foot_m[1]
    ahead_s = until_landing_s + 0.5 * stance_s
    half_turn = 0.5 * stance_s * wanted_yaw_rate_radps
    for axis, arm, across in ((0, arm_x, -arm_y), (1, arm_y, arm_x)):
        too_fast_mps = velocity_mps[axis] - wanted_mps[axis]
        foot_m[axis] = position_m[axis] + arm + half_turn * across + velocity_mps[axis] * ahead_s
        foot_m[axis] += CAPTURE_S * too_fast_mps
    foot_m[2] = plane[0] * foot_m[0] + plane[1] * foot_m[1] + plane[2]


@inner
def fit_plane(contacts_m: Float, plane: Float) -> None:
    """Writes (3,) a, b, c of z = a x + b y + c, the least-squares plane through contacts (N, 3), the feet's last ones.

    Through contacts on one line it is level across that line; through one point it is level.
    """
    n = len(contacts_m)
    x = y = z = 0.0
    for i in range(n):
        x += contacts_m[i, 0] / n
        y += contacts_m[i, 1] / n
        z += contacts_m[i, 2] / n
    xx = xy = yy = xz = yz = 0.0
    for i in range(n):
        dx, dy, dz = contacts_m[i, 0] - x, contacts_m[i, 1] - y, contacts_m[i, 2] - z
        xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
        xz, yz = xz + dx * dz, yz + dy * dz
    determinant = xx * yy - xy * xy
    if determinant > _FLAT_M4 * n * n:
        plane[0] = (yy * xz - xy * yz) / determinant
        plane[1] = (xx * yz - xy * xz) / determinant
    else:
        # The pseudo-inverse of a matrix of rank 1 is itself over its trace squared.
        spread = (xx + yy) * (xx + yy)
        plane[0] = (xx * xz + xy * yz) / spread if spread > _FLAT_M4 * n * n else 0.0
        plane[1] = (xy * xz + yy * yz) / spread if spread > _FLAT_M4 * n * n else 0.0
    plane[2] = z - plane[0] * x - plane[1] * y


@inner
def slope_angles(plane: Float, yaw_rad: float) -> tuple[float, float]:
    """Roll and pitch of a body that stands parallel to a plane (3,) and looks along yaw; uphill its pitch is < 0."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    ahead, left = cos * plane[0] + sin * plane[1], cos * plane[1] - sin * plane[0]
    pitch = -math.atan(ahead)
    return math.atan(left * math.cos(pitch)), pitch


# The reference waits for a robot that is farther away from it than this: it was pushed, or cannot keep up.
LEASH_M, LEASH_RAD = 0.06, 0.15
# How fast attitude and height follow the ground that the feet report.
SLOPE_TIME_S = 0.15


class BodyReference(Record):
    """Integrates the wanted motion, tick after tick (`follow`), and lies on the plane of the feet.

    rpy (3,), position_m (3,) of the body's origin in map, velocity_mps (3,) and a yaw rate wanted now.
    """

    rpy: Annotated[Float, 3]
    position_m: Annotated[Float, 3]
    velocity_mps: Annotated[Float, 3]
    yaw_rate_radps: float
    left_mps: float
    height_m: float

    def __init__(self, position_m: Float, yaw_rad: float, height_m: float) -> None:
        super().__init__()
        self.rpy[2], self.position_m[:] = yaw_rad, position_m
        self.record["height_m"] = height_m


@kernel
def states_ahead(reference, dt_s, states):  # type: ignore[no-untyped-def]
    """Writes the states (N, 12) wanted at the ends of the next steps, as `mpc` has them, of the body's origin."""
    now = reference[0]
    yaw, yaw_rate = now.rpy[2], now.yaw_rate_radps
    x, y, z = now.position_m[0], now.position_m[1], now.position_m[2]
    speed, left = math.cos(yaw) * now.velocity_mps[0] + math.sin(yaw) * now.velocity_mps[1], now.left_mps
    for k in range(len(states)):
        middle = yaw + 0.5 * yaw_rate * dt_s
        cos, sin = math.cos(middle), math.sin(middle)
        x, y = x + (speed * cos - left * sin) * dt_s, y + (speed * sin + left * cos) * dt_s
        z += now.velocity_mps[2] * dt_s
        yaw += yaw_rate * dt_s
        to = states[k]
        to[0], to[1], to[2], to[3], to[4], to[5] = now.rpy[0], now.rpy[1], yaw, x, y, z
        to[6], to[7], to[8] = 0.0, 0.0, yaw_rate
        cos, sin = math.cos(yaw), math.sin(yaw)
        to[9], to[10], to[11] = speed * cos - left * sin, speed * sin + left * cos, now.velocity_mps[2]


@inlined
def follow(reference, dt, speed, yaw_rate, measured, yaw, plane, left=0.0):  # type: ignore[no-untyped-def]
    """Takes the reference on by dt, at a speed ahead and one to the left.

    measured (3,) position and yaw; plane (3,) is that of the feet's centres.
    """
    to = reference[0]
    rpy, position, velocity = to.rpy, to.position_m, to.velocity_mps
    to.yaw_rate_radps = yaw_rate
    turned = (rpy[2] + yaw_rate * dt - yaw + math.pi) % (2 * math.pi) - math.pi
    rpy[2] = yaw + min(max(turned, -LEASH_RAD), LEASH_RAD)
    cos, sin = math.cos(rpy[2]), math.sin(rpy[2])
    slope = cos * plane[0] + sin * plane[1]
    aside = cos * plane[1] - sin * plane[0]
    # The speeds are along the ground.
    level, beside = speed / math.hypot(1.0, slope), left / math.hypot(1.0, aside)
    to.left_mps = beside
    velocity[0], velocity[1] = cos * level - sin * beside, sin * level + cos * beside
    velocity[2] = slope * level + aside * beside
    ahead_x = position[0] + velocity[0] * dt - measured[0]
    ahead_y = position[1] + velocity[1] * dt - measured[1]
    within = LEASH_M / max(math.hypot(ahead_x, ahead_y), LEASH_M)
    position[0], position[1] = measured[0] + within * ahead_x, measured[1] + within * ahead_y
    share = min(dt / SLOPE_TIME_S, 1.0)
    roll, pitch = slope_angles(plane, rpy[2])
    rpy[0] += share * (roll - rpy[0])
    rpy[1] += share * (pitch - rpy[1])
    ground = plane[0] * position[0] + plane[1] * position[1] + plane[2]
    position[2] += velocity[2] * dt
    position[2] += share * (ground + to.height_m - position[2])
