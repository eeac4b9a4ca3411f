"""Where the robot was while its scans were measured, looked up for many scans at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from quadlog.lidar.deskew import Skewed, slot_poses
from quadlog.messages import Float, Int
from quadlog.pipelines.stages.scans import ScanRow
from quadlog.pipelines.stages.walk import Walk


class ScanPoses:
    """Poses at stamps and time slots; skewed counts the scans that keep the robot's motion, and why."""

    def __init__(self, walk: Walk) -> None:
        self.skewed: Counter[Skewed] = Counter()
        self._robot, self._gap_s = walk.robot, walk.config.lidar.pose_gap_s
        self._moves = walk.robot is not None and walk.robot.source != "fixed"

    def of(self, rows: Sequence[ScanRow]) -> list[tuple[Float, Float]]:
        """For each scan the pose (3,) x, y, yaw at its stamp, and those (K, 3) at its slots; NaN where none is near."""
        bounds = np.cumsum([0, *(1 + len(row.slot_ns) for row in rows)]).tolist()
        found = self._poses(np.concatenate([part for row in rows for part in ([row.t_ns], row.slot_ns)]))
        poses = []
        for row, begin, end in zip(rows, bounds[:-1], bounds[1:], strict=True):
            at_slots, skewed = slot_poses(row.t_ns, row.slot_ns, found[begin:end])
            reason = row.skewed or (skewed if self._moves else Skewed.NO_TIMES)
            if reason is not None and not row.shows_nothing:
                self.skewed[reason] += 1
            poses.append((found[begin], at_slots))
        return poses

    def at(self, t_ns: int, slot_ns: Int) -> tuple[Float, Float]:
        """The same of one scan, which is not counted."""
        found = self._poses(np.concatenate([[t_ns], slot_ns]))
        return found[0], slot_poses(t_ns, slot_ns, found)[0]

    def _poses(self, t_ns: Int) -> Float:
        if self._robot is None:
            return np.full((len(t_ns), 3), np.nan)
        return self._robot.poses_at(np.asarray(t_ns, dtype=np.int64), self._gap_s)


def deskewed(xyz_m: Float, slot: NDArray[np.uint8], pose: Float, slot_pose: Float) -> NDArray[np.float32]:
    """Points (N, 3) of base, each by the pose of its time slot (N,) of slot_pose (K, 3), in base at a pose (3,)."""
    cos, sin = np.cos(slot_pose[:, 2])[slot], np.sin(slot_pose[:, 2])[slot]
    x_m, y_m = slot_pose[slot, :2].T - pose[:2, None]
    x_m, y_m = x_m + cos * xyz_m[:, 0] - sin * xyz_m[:, 1], y_m + sin * xyz_m[:, 0] + cos * xyz_m[:, 1]
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.column_stack([cos * x_m + sin * y_m, cos * y_m - sin * x_m, xyz_m[:, 2]]).astype(np.float32)
