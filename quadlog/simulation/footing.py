"""How a walker stands on uneven ground, and how its frame is turned into map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.simulation.terrain import Terrain
from quadlog.simulation.walk import Motion, Walk

ROBOT_FEET_M = (0.4, 0.26)
"""Between a quadruped's front and hind feet, and left and right ones."""


@dataclass(frozen=True, slots=True)
class OnTerrain:
    """A walk over a terrain: base as high as the four feet on average, tilted further as the ground under them.

    feet_m: between front and hind, left and right feet; None for who keeps the body as it is, such as a person.
    """

    walk: Walk
    terrain: Terrain
    feet_m: tuple[float, float] | None = None

    def at(self, t_s: Float) -> Motion:
        """See Walk."""
        motion = self.walk.at(t_s)
        if self.feet_m is None:
            return motion._replace(height_m=self.terrain.height_at(motion.position_m))
        forward = np.column_stack([np.cos(motion.yaw_rad), np.sin(motion.yaw_rad)]) * self.feet_m[0] / 2
        left = np.column_stack([-np.sin(motion.yaw_rad), np.cos(motion.yaw_rad)]) * self.feet_m[1] / 2
        feet = [motion.position_m + fore * forward + side * left for fore in (1, -1) for side in (1, -1)]
        front_left, front_right, hind_left, hind_right = (self.terrain.height_at(foot) for foot in feet)
        rise = (front_left + front_right - hind_left - hind_right) / (2 * self.feet_m[0])
        bank = (front_left + hind_left - front_right - hind_right) / (2 * self.feet_m[1])
        # The plane z = rise x + bank y, of the body's axes as they lie over the map: nose down is pitch up.
        return motion._replace(
            height_m=(front_left + front_right + hind_left + hind_right) / 4,
            roll_rad=motion.roll_rad + np.arctan2(bank, np.hypot(1.0, rise)),
            pitch_rad=motion.pitch_rad - np.arctan(rise),
        )


def turned_into_map(motion: Motion, vectors: Float) -> Float:
    """Vectors (N, 3) of the walker's own frame at N instants, turned into map's axes: (N, 3)."""
    x, y, z = vectors.T
    cos, sin = np.cos(motion.roll_rad), np.sin(motion.roll_rad)
    y, z = cos * y - sin * z, sin * y + cos * z
    cos, sin = np.cos(motion.pitch_rad), np.sin(motion.pitch_rad)
    x, z = cos * x + sin * z, cos * z - sin * x
    cos, sin = np.cos(motion.yaw_rad), np.sin(motion.yaw_rad)
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, z])


def turned_from_level(motion: Motion, vectors: Float) -> Float:
    """Vectors (N, 3) along the heading, to its left and up, as the tilted walker sees them: (N, 3)."""
    x, y, z = vectors.T
    cos, sin = np.cos(motion.pitch_rad), np.sin(motion.pitch_rad)
    x, z = cos * x - sin * z, sin * x + cos * z
    cos, sin = np.cos(motion.roll_rad), np.sin(motion.roll_rad)
    return np.column_stack([x, cos * y + sin * z, cos * z - sin * y])


def position_in_map(motion: Motion, place_m: Float) -> Float:
    """Where points (N, 3) of the walker's own frame are in map at N instants: (N, 3)."""
    base_m = np.column_stack([motion.position_m, motion.height_m])
    return base_m + turned_into_map(motion, place_m)
