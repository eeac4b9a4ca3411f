"""Where the body should be now and within the horizon, for a wanted speed and yaw rate over the ground under it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadlog.compiled import inlined
from quadlog.locomotion.footholds import slope_angles
from quadlog.locomotion.record import Record
from quadlog.messages import Float

# The reference waits for a robot that is farther away from it than this: it was pushed, or cannot keep up.
LEASH_M, LEASH_RAD = 0.06, 0.15
# How fast attitude and height follow the ground that the feet report.
SLOPE_TIME_S = 0.15

_LAYOUT = np.dtype(
    [
        ("rpy", "f8", 3),
        ("position_m", "f8", 3),
        ("velocity_mps", "f8", 3),
        ("yaw_rate_radps", "f8"),
        ("height_m", "f8"),
    ]
)


class WantedMotion(NamedTuple):
    """A speed forward and a yaw rate, as pure pursuit commands them."""

    speed_mps: float
    yaw_rate_radps: float


class BodyReference(Record):
    """Integrates the wanted motion, tick after tick (`follow`), and lies on the plane of the feet.

    rpy (3,), position_m (3,) of the body's origin in map, velocity_mps (3,) and a yaw rate wanted now.
    """

    rpy: Float
    position_m: Float
    velocity_mps: Float

    def __init__(self, position_m: Float, yaw_rad: float, height_m: float) -> None:
        super().__init__(_LAYOUT)
        self.rpy[2], self.position_m[:] = yaw_rad, position_m
        self.record["height_m"] = height_m

    def ahead(self, dt_s: float, states: Float) -> None:
        """Writes the states (N, 12) wanted at the ends of the next steps, as `centroidal` has them, of the origin."""
        roll, pitch, yaw = self.rpy.tolist()
        (x, y, z), (vx, vy, vz) = self.position_m.tolist(), self.velocity_mps.tolist()
        yaw_rate = float(self.record["yaw_rate_radps"][0])
        speed = math.cos(yaw) * vx + math.sin(yaw) * vy
        rows = []
        for _ in range(len(states)):
            middle = yaw + 0.5 * yaw_rate * dt_s
            x, y, z = x + speed * math.cos(middle) * dt_s, y + speed * math.sin(middle) * dt_s, z + vz * dt_s
            yaw += yaw_rate * dt_s
            going = speed * math.cos(yaw), speed * math.sin(yaw), vz
            rows.append((roll, pitch, yaw, x, y, z, 0.0, 0.0, yaw_rate, *going))
        states[:] = rows


@inlined
def follow(reference, dt, speed, yaw_rate, measured, yaw, plane):  # type: ignore[no-untyped-def]
    """Takes the reference on by dt; measured (3,) position and yaw; plane (3,) is that of the feet's centres."""
    to = reference[0]
    rpy, position, velocity = to.rpy, to.position_m, to.velocity_mps
    to.yaw_rate_radps = yaw_rate
    turned = (rpy[2] + yaw_rate * dt - yaw + math.pi) % (2 * math.pi) - math.pi
    rpy[2] = yaw + min(max(turned, -LEASH_RAD), LEASH_RAD)
    cos, sin = math.cos(rpy[2]), math.sin(rpy[2])
    slope = cos * plane[0] + sin * plane[1]
    # The speed is along the ground.
    level = speed / math.hypot(1.0, slope)
    velocity[0], velocity[1], velocity[2] = cos * level, sin * level, slope * level
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
