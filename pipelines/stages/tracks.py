"""Where the robot and the target were, at any instant a later stage asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int
from quadlog.positioning.interpolation import interpolate_poses

TARGET_GAP_S = 1.0
"""A target seen this recently is still there; longer gaps are not bridged."""


@dataclass(frozen=True, slots=True)
class RobotTrack:
    """Poses of base in map: t_ns (N,), xy_m (N, 2), yaw_rad (N,), where they come from, and what that calls map.

    covariance_m2 (N, 2, 2) of the positions and yaw_std_rad (N,), where they are known.
    """

    t_ns: Int
    xy_m: Float
    yaw_rad: Float
    source: str
    frame_id: str = ""
    covariance_m2: Float | None = None
    yaw_std_rad: Float | None = None

    def poses_at(self, t_ns: Int, max_gap_s: float) -> Float:
        """(M, 3) x_m, y_m, yaw_rad at instants (M,), NaN where no pose is near enough."""
        if self.source == "fixed":
            return np.tile([*self.xy_m[0], self.yaw_rad[0]], (len(t_ns), 1))
        xy_m, yaw_rad, _ = interpolate_poses(t_ns, self.t_ns, self.xy_m, self.yaw_rad, max_gap_s)
        return np.column_stack([xy_m, yaw_rad])

    def pose_at(self, t_ns: int, max_gap_s: float) -> Float | None:
        """(3,) at one instant, or None."""
        pose: Float = self.poses_at(np.array([t_ns]), max_gap_s)[0]
        return pose if np.isfinite(pose).all() else None


@dataclass(frozen=True, slots=True)
class TargetTrack:
    """Positions of what is followed in map: t_ns (N,), xy_m (N, 2).

    has_body: whether it stands in the world and returns the lidar's rays; a
    point ahead of the robot does not.
    """

    t_ns: Int
    xy_m: Float
    source: str

    @property
    def has_body(self) -> bool:
        """Whether returns near it are its own."""
        return self.source not in ("ahead", "fixed")

    def at(self, t_ns: Int) -> Float:
        """(M, 2) at instants (M,), NaN where it was not seen."""
        if self.source == "fixed":
            return np.tile(self.xy_m[0], (len(t_ns), 1))
        still = np.zeros(len(self.t_ns))
        xy_m, _, _ = interpolate_poses(t_ns, self.t_ns, self.xy_m, still, TARGET_GAP_S)
        return xy_m
