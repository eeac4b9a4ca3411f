"""Poses at the instants of another sensor."""

from __future__ import annotations

import numpy as np

from quadlog.geometry import interpolate_angle, seconds_since
from quadlog.messages import Float, Int


def interpolate_poses(
    t_ns_wanted: Int, t_ns: Int, xy_m: Float, yaw_rad: Float, max_gap_s: float
) -> tuple[Float, Float, np.ndarray]:
    """Position (W, 2), yaw (W,) and validity (W,) bool at t_ns_wanted (W,), from poses at t_ns (N,) increasing.

    Linear between the two neighbours, yaw along the shorter way round. Valid
    where both lie within max_gap_s; before the first and after the last pose
    that pose is held for max_gap_s. What is not valid is NaN.
    """
    xy, yaw = np.full((len(t_ns_wanted), 2), np.nan), np.full(len(t_ns_wanted), np.nan)
    if len(t_ns) == 0:
        return xy, yaw, np.zeros(len(t_ns_wanted), dtype=np.bool_)
    before = (np.searchsorted(t_ns, t_ns_wanted, side="right") - 1).clip(0)
    after = np.searchsorted(t_ns, t_ns_wanted, side="left").clip(max=len(t_ns) - 1)
    gap_ns = np.maximum(np.abs(t_ns_wanted - t_ns[before]), np.abs(t_ns[after] - t_ns_wanted))
    valid = gap_ns <= max_gap_s * 1e9

    # Only the poses about the instants asked for: a call per scan must not cost the length of the log.
    nearby = slice(int(before.min(initial=len(t_ns))), int(after.max(initial=0)) + 1)
    t_ns, xy_m, yaw_rad = t_ns[nearby], xy_m[nearby], yaw_rad[nearby]
    if len(t_ns) == 0:
        return xy, yaw, valid
    start_ns = int(t_ns[0])
    wanted_s, known_s = seconds_since(t_ns_wanted[valid], start_ns), seconds_since(t_ns, start_ns)
    for axis in range(2):
        xy[valid, axis] = np.interp(wanted_s, known_s, xy_m[:, axis])
    yaw[valid] = interpolate_angle(t_ns_wanted[valid], t_ns, yaw_rad)
    return xy, yaw, valid
