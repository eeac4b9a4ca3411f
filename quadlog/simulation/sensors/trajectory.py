"""Trajectories: smooth closed routes through a site, and walks along them at a slowly varying speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from quadlog.geometry import wrap_angle
from quadlog.messages import Float
from quadlog.simulation.robot.height_field import HeightField

_TABLE_STEP_M = 0.01


class Motion(NamedTuple):
    """N instants: position_m (N, 2) and yaw (N,) in map; speed and acceleration (N,) along it, yaw rate (N,).

    height_m (N,) is that of the walker's base above z = 0; roll and pitch (N,)
    tilt it, as R_z(yaw) R_y(pitch) R_x(roll). Speed is that over the map.
    """

    position_m: Float
    yaw_rad: Float
    speed_mps: Float
    acceleration_mps2: Float
    yaw_rate_radps: Float
    height_m: Float
    roll_rad: Float
    pitch_rad: Float


class Walk(Protocol):
    """Anything whose motion is known at every instant.

    One that knows what an ideal IMU measures has a method inertial, from t_s (N,) to angular rates (N, 3) and specific
    force (N, 3) along base's axes.
    """

    def at(self, t_s: Float) -> Motion:
        """The motion at t_s (N,), seconds since the recording's start."""
        ...


class Route:
    """A closed curve with continuous curvature through waypoints (K, 2), parametrised by distance walked."""

    def __init__(self, waypoints_m: Float) -> None:
        closed_m = np.concatenate([waypoints_m, waypoints_m[:1]])
        chord_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed_m, axis=0), axis=1))])
        self._curve = CubicSpline(chord_m, closed_m, bc_type="periodic")
        parameter = np.linspace(0.0, chord_m[-1], int(np.ceil(chord_m[-1] / _TABLE_STEP_M)) + 1)
        middle = (parameter[1:] + parameter[:-1]) / 2
        pace = [np.linalg.norm(self._curve(u, 1), axis=1) for u in (parameter[:-1], middle, parameter[1:])]
        # Simpson's rule on every step of the table.
        steps_m = np.diff(parameter) * (pace[0] + 4 * pace[1] + pace[2]) / 6
        distance_m = np.concatenate([[0.0], np.cumsum(steps_m)])
        self.length_m = float(distance_m[-1])
        self._parameter = CubicSpline(distance_m, parameter)

    def at(self, distance_m: Float) -> tuple[Float, Float, Float]:
        """Position (N, 2), heading (N,) and curvature (N,) in 1/m, left positive, after distance_m (N,)."""
        parameter = self._parameter(np.asarray(distance_m) % self.length_m)
        first, second = self._curve(parameter, 1), self._curve(parameter, 2)
        curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / np.linalg.norm(first, axis=1) ** 3
        return self._curve(parameter), np.arctan2(first[:, 1], first[:, 0]), curvature


@dataclass(frozen=True, slots=True)
class RouteWalk:
    """Along a route from start_m at mean speed; the distance sways by sway_m about the even walk every period_s."""

    route: Route
    start_m: float
    speed_mps: float
    sway_m: float
    period_s: float

    def at(self, t_s: Float) -> Motion:
        """See Walk."""
        rate = 2 * np.pi / self.period_s
        distance_m = self.start_m + self.speed_mps * t_s + self.sway_m * np.sin(rate * t_s)
        speed_mps = self.speed_mps + self.sway_m * rate * np.cos(rate * t_s)
        position_m, yaw_rad, curvature = self.route.at(distance_m)
        acceleration_mps2 = -self.sway_m * rate**2 * np.sin(rate * t_s)
        return _level(position_m, wrap_angle(yaw_rad), speed_mps, acceleration_mps2, curvature * speed_mps)


@dataclass(frozen=True, slots=True)
class PacingWalk:
    """Up and down a straight line between two points of map, once in period_s, always facing the second."""

    from_m: tuple[float, float]
    to_m: tuple[float, float]
    period_s: float

    def at(self, t_s: Float) -> Motion:
        """See Walk."""
        rate = 2 * np.pi / self.period_s
        ends_m = np.array([self.from_m, self.to_m])
        along_m = ends_m[1] - ends_m[0]
        half_m = float(np.linalg.norm(along_m)) / 2
        position_m = ends_m.mean(axis=0) - np.cos(rate * t_s)[:, None] * along_m / 2
        yaw_rad = np.full(len(t_s), np.arctan2(along_m[1], along_m[0]))
        speed_mps = half_m * rate * np.sin(rate * t_s)
        return _level(position_m, yaw_rad, speed_mps, half_m * rate**2 * np.cos(rate * t_s), np.zeros(len(t_s)))


def _level(position_m: Float, yaw_rad: Float, speed_mps: Float, acceleration_mps2: Float, yaw_rate: Float) -> Motion:
    zero = np.zeros(len(position_m))
    return Motion(position_m, yaw_rad, speed_mps, acceleration_mps2, yaw_rate, zero, zero, zero)


ROBOT_FEET_M = (0.4, 0.26)
"""Between a quadruped's front and hind feet, and left and right ones."""


@dataclass(frozen=True, slots=True)
class OnTerrain:
    """A walk over a terrain: base as high as the four feet on average, tilted further as the ground under them.

    feet_m: between front and hind, left and right feet; None for who keeps the body as it is, such as a person.
    """

    walk: Walk
    terrain: HeightField
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
