"""Where the robot was while its scans were measured, looked up for many scans at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

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
