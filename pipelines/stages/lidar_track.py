"""The robot's track from the lidar alone, made while the recording is read."""

from __future__ import annotations

import numpy as np

from quadlog.config.schema import Config
from quadlog.lidar.deskew import Skewed, sweep_span
from quadlog.messages import Float, PointCloud
from quadlog.pipelines.stages.tilt import Tilt
from quadlog.positioning.lidar_odometry import LidarOdometry, LidarOdometrySettings, LidarTrack, ScanMatch
from quadlog.recordings.roles import Roles


def wants_lidar_track(config: Config, roles: Roles, by_uwb: bool) -> bool:
    """Whether positions come from the lidar: as configured, or under auto where nothing else can tell them.

    by_uwb: whether there are ranges and anchors.
    """
    position = config.topics.position
    if "lidar" not in roles.found or position not in ("auto", "lidar"):
        return False
    if position == "lidar":
        return True
    moving_tf = [topic for topic in roles.topics("tf") if topic.rsplit("/", 1)[-1] != "tf_static"]
    return not (by_uwb or moving_tf or roles.topic("odometry"))


class LidarTracker:
    """Takes clouds one by one, levelled by the tilt known then."""

    def __init__(self, config: Config, transform_lidar_to_base: Float, tilt: Tilt) -> None:
        lidar = config.lidar
        # Points too far for the map still tell where the robot is.
        settings = LidarOdometrySettings(min_range_m=lidar.min_range_m)
        self._odometry, self._deskew = LidarOdometry(settings), lidar.deskew
        self._mount, self._tilt = transform_lidar_to_base, tilt

    def take(self, t_ns: int, cloud: PointCloud) -> None:
        """The next cloud."""
        span = sweep_span(cloud.times, len(cloud.xyz_m)) if self._deskew else Skewed.NO_TIMES
        offset_ns, middle_ns = None, t_ns
        if not isinstance(span, Skewed):
            offset_ns, middle_ns = cloud.offset_ns, t_ns + sum(span) // 2
        rotations, _ = self._tilt.rotations(np.array([middle_ns], dtype=np.int64))
        rotation = (rotations[0] @ self._mount[:3, :3]).astype(np.float32)
        shift_m = (rotations[0] @ self._mount[:3, 3]).astype(np.float32)
        self._odometry.take(t_ns, cloud.xyz_m @ rotation.T + shift_m, offset_ns)

    def track(self) -> LidarTrack:
        """Poses of base amid each scan, in upright base where the first scan was taken."""
        return self._odometry.track()

    def warnings(self) -> list[str]:
        """How many scans do not tell the whole pose, and why."""
        match = self._odometry.track().match
        lost, sliding = (match == ScanMatch.LOST).sum(), (match == ScanMatch.DEGENERATE).sum()
        lines = []
        if lost:
            lines.append(
                f"{lost} of {len(match)} scans match nothing seen before: their poses are those of constant speed"
            )
        if sliding:
            lines.append(
                f"{sliding} of {len(match)} scans show surfaces that face one way, as a corridor does: along them "
                "positions may slide"
            )
        return lines
