"""Which points of a classified scan block the robot."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ObstacleSettings:
    """What counts as an obstacle.

    min_height_m, max_height_m: above the ground; lower and higher points do not block.
    body_length_m, body_width_m, body_margin_m: points in this box about base's origin are the robot.
    """

    min_height_m: float = 0.05
    max_height_m: float = 1.5
    body_length_m: float = 0.62
    body_width_m: float = 0.26
    body_margin_m: float = 0.1
