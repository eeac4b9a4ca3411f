"""Where the next foot goes, and how the ground lies under the feet."""

from __future__ import annotations

import math

from quadlog.compiled import inner
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
    foot_m[0] = (
        position_m[0]
        + arm_x
        - half_turn * arm_y
        + velocity_mps[0] * ahead_s
        + CAPTURE_S * (velocity_mps[0] - wanted_mps[0])
    )
    foot_m[1] = (
        position_m[1]
        + arm_y
        + half_turn * arm_x
        + velocity_mps[1] * ahead_s
        + CAPTURE_S * (velocity_mps[1] - wanted_mps[1])
    )
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
