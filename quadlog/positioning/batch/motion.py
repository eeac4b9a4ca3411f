"""How a coordinate moves between two knots: a second-order linear stochastic differential equation."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy.linalg import expm

from quadlog.messages import Float, Int
from quadlog.positioning.batch.spline import Timeline

ACCELERATION_LASTS_S = 0.1
"""Correlation time of a walker's acceleration, about half a step."""
TURN_STD_RADPS, TURN_LASTS_S = 0.5, 2.0
HEIGHT_LASTS_S, HEIGHT_SMOOTH_S = 20.0, 0.5
"""A height is forgotten within the first, and smooth over the second."""


@dataclass(frozen=True, slots=True)
class Motion:
    """q'' = -stiffness q - damping q' + w, with white noise w of spectral density `density`.

    start_std, start_rate_std: of the coordinate and its rate where a segment starts.
    """

    density: float
    damping: float = 0.0
    stiffness: float = 0.0
    start_std: float = 100.0
    start_rate_std: float = 1.0


def walking(acceleration_std_mps2: float) -> Motion:
    """Of a horizontal coordinate of a walker."""
    return Motion(acceleration_std_mps2**2 * ACCELERATION_LASTS_S)


def turning() -> Motion:
    """Of yaw, whose rate is a first-order Gauss-Markov process."""
    density = 2 * TURN_STD_RADPS**2 / TURN_LASTS_S
    return Motion(density, 1 / TURN_LASTS_S, start_std=2.0, start_rate_std=TURN_STD_RADPS)


def lifting(std_m: float) -> Motion:
    """Of a height about its known mean."""
    damping, stiffness = 1 / HEIGHT_LASTS_S + 1 / HEIGHT_SMOOTH_S, 1 / (HEIGHT_LASTS_S * HEIGHT_SMOOTH_S)
    rate_std = std_m * float(np.sqrt(stiffness))
    return Motion(2 * damping * rate_std**2, damping, stiffness, std_m, rate_std)


@lru_cache(maxsize=1000)
def transition(motion: Motion, dt_s: float) -> tuple[Float, Float]:
    """F (2, 2) and Q (2, 2) of x(t + dt) = F x(t) + noise of covariance Q [Van Loan]."""
    drift = np.array([[0.0, 1.0], [-motion.stiffness, -motion.damping]])
    noise = np.diag([0.0, motion.density])
    both = expm(np.block([[-drift, noise], [np.zeros((2, 2)), drift.T]]) * dt_s)
    step = both[2:, 2:].T
    return step, step @ both[:2, 2:]


@lru_cache(maxsize=1000)
def step_information(motions: tuple[Motion, ...], dt_s: float) -> Float:
    """(4D, 4D) information about two knots (q, q', q, q') dt_s apart from D motions between them."""
    size = len(motions)
    found = np.zeros((4, size, 4, size))
    for axis, motion in enumerate(motions):
        step, noise = transition(motion, dt_s)
        change = np.hstack([-step, np.eye(2)])
        found[:, axis, :, axis] = change.T @ np.linalg.solve(noise, change)
    return found.reshape(4 * size, 4 * size)


def motion_information(motions: tuple[Motion, ...], timeline: Timeline) -> Float:
    """(K - 1, 4D, 4D) information about neighbouring knots; the first of a segment is known to start_std about zero."""
    size, lengths_s = len(motions), np.diff(timeline.t_s).round(7).tolist()
    information = np.array([step_information(motions, each_s) for each_s in lengths_s])
    information *= timeline.connected[:, None, None]
    start = np.array([m.start_std for m in motions] + [m.start_rate_std for m in motions])
    at = np.arange(2 * size)
    for first in timeline.firsts.tolist():
        row, shift = min(first, len(timeline) - 2), 0 if first < len(timeline) - 1 else 2 * size
        information[row, at + shift, at + shift] += start**-2.0
    return information


@dataclass(frozen=True, slots=True)
class Track:
    """The way of a tag, or of a body, at T instants.

    t_ns: (T,) strictly increasing; position_m, velocity_mps: (T, 2) in map.
    covariance_m2, velocity_covariance_m2ps2: (T, 2, 2) of each of them.
    z_m, z_std_m: (T,) height in map; where it was given instead of tracked, that, and a std of zero.
    position_excess: (T,) or (1,), by how much covariance_m2 was raised above what the estimator works with.
    """

    t_ns: Int
    position_m: Float
    velocity_mps: Float
    covariance_m2: Float
    velocity_covariance_m2ps2: Float
    z_m: Float
    z_std_m: Float
    position_excess: Float = field(default_factory=lambda: np.ones(1))

    def __len__(self) -> int:
        return len(self.t_ns)
