"""From where the tag is to where the robot is, and back: one tag sits beside the middle of its carrier."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float


def tag_to_base(tag_m: Float, yaw_rad: Float, x_m: float, y_m: float) -> Float:
    """Positions (N, 2) of base in map, from those of a tag that sits at (x_m, y_m) in base, and yaw (N,)."""
    return tag_m - _turned(yaw_rad, x_m, y_m)


def base_to_tag(base_m: Float, yaw_rad: Float, x_m: float, y_m: float) -> Float:
    """Positions (N, 2) of the tag in map, from those of base: the reverse of tag_to_base."""
    return base_m + _turned(yaw_rad, x_m, y_m)


def base_covariance(tag_covariance_m2: Float, yaw_rad: Float, yaw_std_rad: Float, x_m: float, y_m: float) -> Float:
    """Covariance (N, 2, 2) of tag_to_base's positions, from that of the tag's (N, 2, 2) and the std (N,) of yaw.

    To first order, with J = -dR/dyaw (x_m, y_m): the errors of tag and yaw are taken to be independent.
    """
    along_m = _turned(yaw_rad, y_m, -x_m) * yaw_std_rad[:, None]
    covariance: Float = tag_covariance_m2 + along_m[:, :, None] * along_m[:, None, :]
    return covariance


def _turned(yaw_rad: Float, x_m: float, y_m: float) -> Float:
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack([cos * x_m - sin * y_m, sin * x_m + cos * y_m], axis=-1)
