"""Poses at the instants of another sensor."""

from __future__ import annotations

import numpy as np

from quadlog.geometry import wrap_angle
from quadlog.messages import Float, Int


def interpolate_poses(
    t_ns_wanted: Int, t_ns: Int, xy_m: Float, yaw_rad: Float, max_gap_s: float
) -> tuple[Float, Float, np.ndarray]:
    """Position (W, 2), yaw (W,) and validity (W,) bool at t_ns_wanted (W,), from poses at t_ns (N,) increasing.

    Linear between the two neighbours, yaw along the shorter way round. Valid
    where both lie within max_gap_s; before the first and after the last pose
    that pose is held for max_gap_s. What is not valid is NaN.
    """
    if len(t_ns) == 0:
        nowhere = np.full((len(t_ns_wanted), 3), np.nan)
        return nowhere[:, :2], nowhere[:, 2], np.zeros(len(t_ns_wanted), dtype=np.bool_)
    before = np.maximum(np.searchsorted(t_ns, t_ns_wanted, side="right") - 1, 0)
    after = np.minimum(np.searchsorted(t_ns, t_ns_wanted, side="left"), len(t_ns) - 1)
    since_ns, until_ns = t_ns_wanted - t_ns[before], t_ns[after] - t_ns_wanted
    valid = np.maximum(np.abs(since_ns), np.abs(until_ns)) <= max_gap_s * 1e9
    between_ns = t_ns[after] - t_ns[before]
    # Where both neighbours are one pose, it is held.
    share = np.where(between_ns > 0, since_ns, 0) / np.maximum(between_ns, 1)
    xy = xy_m[before] + share[:, None] * (xy_m[after] - xy_m[before])
    yaw = wrap_angle(yaw_rad[before] + share * wrap_angle(yaw_rad[after] - yaw_rad[before]))
    xy[~valid], yaw[~valid] = np.nan, np.nan
    return xy, yaw, valid
