"""A walking person as a lidar sees one: upright cylinders for trunk, head and swinging legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.simulation.walk import Walk

_STRIDE_S = 1.1
_LEG_SWING_M = 0.22


@dataclass(frozen=True, slots=True)
class BodyPart:
    """An upright cylinder between two heights; left_m is its place across the body, swing_m how far it swings."""

    radius_m: float
    low_m: float
    high_m: float
    left_m: float = 0.0
    swing_m: float = 0.0


BODY = (
    BodyPart(radius_m=0.2, low_m=0.8, high_m=1.48),
    BodyPart(radius_m=0.1, low_m=1.48, high_m=1.72),
    BodyPart(radius_m=0.08, low_m=0.0, high_m=0.8, left_m=0.1, swing_m=_LEG_SWING_M),
    BodyPart(radius_m=0.08, low_m=0.0, high_m=0.8, left_m=-0.1, swing_m=-_LEG_SWING_M),
)


def part_centres(walk: Walk, t_s: Float) -> Float:
    """(N, parts, 2) centres of the body's cylinders in map at t_s (N,)."""
    motion = walk.at(t_s)
    swing = np.sin(2 * np.pi * t_s / _STRIDE_S)
    forward = np.column_stack([np.cos(motion.yaw_rad), np.sin(motion.yaw_rad)])
    left = np.column_stack([-forward[:, 1], forward[:, 0]])
    centres = [motion.position_m + left * part.left_m + forward * (part.swing_m * swing)[:, None] for part in BODY]
    return np.stack(centres, axis=1)


def ray_ranges(origins_m: Float, directions: Float, centres_m: Float) -> Float:
    """(N,) range at which each ray first meets the body, inf where it does not.

    origins_m and directions (N, 3) in map, unit length; centres_m (N, parts, 2) at each ray's own instant.
    """
    nearest_m = np.full(len(origins_m), np.inf)
    for index, part in enumerate(BODY):
        np.minimum(nearest_m, _cylinder_ranges(origins_m, directions, centres_m[:, index], part), out=nearest_m)
    return nearest_m


def _cylinder_ranges(origins_m: Float, directions: Float, centres_m: Float, part: BodyPart) -> Float:
    """A ray is inside where it is inside the endless cylinder and between its two heights at once."""
    offset_m = origins_m[:, :2] - centres_m
    flat = directions[:, :2]
    # |offset + t flat|^2 = radius^2
    a = np.maximum(np.sum(flat**2, axis=1), 1e-12)
    half_b = np.sum(offset_m * flat, axis=1)
    root = half_b**2 - a * (np.sum(offset_m**2, axis=1) - part.radius_m**2)
    reach = np.sqrt(np.maximum(root, 0.0))
    slope = np.where(np.abs(directions[:, 2]) < 1e-12, 1e-12, directions[:, 2])
    heights = (np.array([part.low_m, part.high_m]) - origins_m[:, 2:]) / slope[:, None]
    enter_m = np.maximum((-half_b - reach) / a, heights.min(axis=1))
    leave_m = np.minimum((-half_b + reach) / a, heights.max(axis=1))
    return np.where((root > 0) & (enter_m < leave_m) & (enter_m > 0), enter_m, np.inf)
