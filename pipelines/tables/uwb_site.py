"""The site of [Following]'s positioning experiment, and ranges simulated there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float

RANGE_STD_M = 0.1
"""What [Following] reports of its ranges. Its raw ranges are not published, so this is what ours are drawn with."""
STATIONS_M = np.array([[0.0, -2.4, 0.0], [0.0, 1.6, 0.0], [6.0, 0.0, 0.0]])
"""Heights are not printed for this experiment; the distances say that the tags were level with the stations."""
BOX_LOW_M, BOX_HIGH_M = np.array([0.5, -2.0]), np.array([5.5, 2.0])
"""Where tags may be among the stations: in and around their triangle, but not close to a station."""
BOX_WORDS = "0.5 to 5.5 m by -2 to 2 m"
METHODS = ("linear", "weighted", "paper", "gauss_newton", "huber")
LINEAR_METHODS = ("linear", "weighted", "paper")


@dataclass(frozen=True, slots=True)
class PaperTag:
    """A tag of the experiment: where the paper says it was, where its distances (3,) say it was, and its figures."""

    name: str
    printed_m: tuple[float, float]
    true_m: tuple[float, float]
    distance_m: tuple[float, float, float]
    range_figure: str
    coordinate_figure: str


ROBOT = PaperTag("robot", (0.0, 2.4), (0.8, 0.0), (2.53, 1.79, 5.20), "Fig. 9", "Fig. 12")
PERSON = PaperTag("person", (0.0, 0.8), (2.4, 0.0), (3.39, 2.88, 3.55), "Fig. 10", "Fig. 11")
TAGS = (ROBOT, PERSON)


def distances(position_m: Float, stations_m: Float) -> Float:
    """(N, A) true distances of tags at (N, 2), z = 0, from stations (A, 3)."""
    offset_m = np.column_stack([position_m, np.zeros(len(position_m))])[:, None, :] - stations_m
    distance_m: Float = np.linalg.norm(offset_m, axis=2)
    return distance_m


def cramer_rao(position_m: Float, stations_m: Float) -> Float:
    """(N, 2, 2) the smallest covariance that any unbiased fix at (N, 2) can have: (sum u u^T / std^2)^-1.

    For tags level with the stations [Following, right form].
    """
    offset_m = position_m[:, None, :] - stations_m[None, :, :2]
    u = offset_m / np.linalg.norm(offset_m, axis=2, keepdims=True)
    bound: Float = RANGE_STD_M**2 * np.linalg.inv(u.swapaxes(1, 2) @ u)
    return bound


def draw_ranges(position_m: Float, stations_m: Float, rng: np.random.Generator) -> Float:
    """(N, A) ranges in line of sight, with normal errors of RANGE_STD_M."""
    true_m = distances(position_m, stations_m)
    return true_m + RANGE_STD_M * rng.standard_normal(true_m.shape)
