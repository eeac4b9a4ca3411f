"""The body's tilt from the messages read so far, for levelling scans while the recording is read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from quadlog.config.schema import Config
from quadlog.lidar.levelling import NotLevelled, UpSeries, level_rotations, up_in_base
from quadlog.messages import Float, Imu, ImuSeries, Int, Odometry, Pose
from quadlog.recordings.clock import kept_rows
from quadlog.recordings.gathering import Gathered, One
from quadlog.recordings.recording import Recording
from quadlog.recordings.tf_tree import TransformTree


def imu_mount(frame_id: str, tree: TransformTree, base_frame: str = "") -> Float | None:
    """(3, 3) rotation from an IMU's frame to base through static tf; None if unknown or the identity."""
    base = tree.base_frame(base_frame)
    mount = None if base is None else tree.static_transform(frame_id, base)
    return None if mount is None or np.array_equal(mount[:3, :3], np.eye(3)) else mount[:3, :3]


def imu_in_base(imu: ImuSeries, tree: TransformTree, base_frame: str = "") -> ImuSeries:
    """The series in base's axes, where static tf gives the IMU's mount; else unchanged."""
    mount, base = imu_mount(imu.frame_id, tree, base_frame), tree.base_frame(base_frame)
    if mount is None or base is None:
        return imu
    from scipy.spatial.transform import Rotation  # slow to import, and few recordings need it

    imu_to_base = Rotation.from_matrix(mount)
    quat_xyzw = imu.quat_xyzw
    if quat_xyzw is not None:
        real = np.abs(quat_xyzw).max(axis=1) > 0
        turned = Rotation.from_quat(quat_xyzw[real]) * imu_to_base.inv()
        quat_xyzw = np.zeros_like(quat_xyzw)
        quat_xyzw[real] = turned.as_quat()
    return ImuSeries(imu.t_ns, imu_to_base.apply(imu.angular_radps), quat_xyzw, base)


LOOKED_AT = 50
"""Number of first messages that show whether an IMU gives an orientation that changes."""
RECENT = 1024
"""Orientations that are kept: a second at 1 kHz."""


class Tilt:
    """The orientation of base from the first available of IMU, odometry and moving tf.

    topics: those whose messages must be taken before clouds logged after them. An IMU is ignored while its orientation
    has never changed.
    """

    def __init__(
        self, recording: Recording, tree: TransformTree, config: Config, imu: str | None, odometry: str | None
    ) -> None:
        self._tree, self._base = tree, tree.base_frame(config.topics.base_frame)
        self._map_frame, self._wanted = config.topics.map_frame, config.lidar.level
        self._imu = self._odometry = None
        looked_at = [each for each in recording.sample(imu, LOOKED_AT) if isinstance(each, Imu)] if imu else []
        oriented = [each.quat_xyzw for each in looked_at if each.quat_xyzw is not None]
        self._frozen = len(oriented) > 1 and not np.ptp(oriented, axis=0).any()
        if oriented:
            self._imu = _Recent(imu_mount(looked_at[0].frame_id, tree, config.topics.base_frame))
        if odometry and (self._imu is None or self._frozen):
            self._odometry = _Recent(None)
        self._imu_topic, self._odometry_topic = imu, odometry

    def topics(self, tf: Sequence[str]) -> list[str]:
        """See the class; tf: the topics of moving transforms."""
        if not self._wanted:
            return []
        named = [self._imu_topic] if self._imu_topic and self._imu is not None else []
        if self._odometry is not None and self._odometry_topic:
            return [*named, self._odometry_topic]
        return [*named, *tf] if self._imu is None or self._frozen else named

    def take(self, gathered: Gathered) -> None:
        """Store orientations; moving transforms are in the tree already."""
        if gathered.topic == self._imu_topic and self._imu is not None:
            self._frozen &= not self._imu.take(gathered)
        elif gathered.topic == self._odometry_topic and self._odometry is not None:
            self._odometry.take(gathered)

    def reaches(self, t_ns: int) -> bool:
        """Whether orientations are known up to an instant, or there is no source of them."""
        source = self._source() if self._wanted else None
        return source is None or source.latest_ns >= t_ns

    def rotations(self, t_ns: Int) -> tuple[Float, NotLevelled | None]:
        """(W, 3, 3) rotations that turn base upright at the instants (W,) of a scan, and why they do not, or None."""
        series = self._series() if self._wanted else None
        if series is None:
            return np.tile(np.eye(3), (len(t_ns), 1, 1)), None
        return level_rotations(t_ns, series)

    def _source(self) -> _Recent | None:
        return self._imu if self._imu is not None and not self._frozen else self._odometry

    def _series(self) -> UpSeries | None:
        if (source := self._source()) is not None:
            return source.series()
        poses = None if self._base is None else self._tree.recent(RECENT).pose_series(self._base, self._map_frame)
        return None if poses is None else up_in_base(poses.t_ns, poses.quat_xyzw)


class _Recent:
    """The last orientations of a sensor mounted with rotation_sensor_to_base (3, 3)."""

    def __init__(self, rotation_sensor_to_base: Float | None) -> None:
        self._rotation = rotation_sensor_to_base
        self._t_ns, self._up = np.empty(0, np.int64), np.empty((0, 3))
        self._in_order = True
        self._first: Float | None = None
        self.latest_ns = 0

    def take(self, gathered: Gathered) -> bool:
        """Append what was read; whether any orientation differs from the first one."""
        t_ns, quat_xyzw = _orientations(gathered)
        if len(t_ns) == 0:
            return False
        if self._first is None:
            self._first = quat_xyzw[0]
        new = up_in_base(t_ns, quat_xyzw, self._rotation)
        self._t_ns = np.concatenate([self._t_ns[-RECENT:], new.t_ns])
        self._up = np.concatenate([self._up[-RECENT:], new.up])
        self.latest_ns = max(self.latest_ns, int(new.t_ns[-1]) if len(new) else 0)
        self._in_order = bool((self._t_ns[1:] > self._t_ns[:-1]).all())
        return bool((quat_xyzw != self._first).any())

    def series(self) -> UpSeries:
        """What is known now."""
        if self._in_order:
            return UpSeries(self._t_ns, self._up)
        rows = kept_rows(self._t_ns)
        return UpSeries(self._t_ns[rows], self._up[rows])


def _orientations(gathered: Gathered) -> tuple[Int, Float]:
    """Times (N,) and quaternions (N, 4), without those that have none."""
    if isinstance(gathered, One):
        message = gathered.message
        if not isinstance(message, (Imu, Odometry, Pose)) or message.quat_xyzw is None:
            return np.empty(0, np.int64), np.empty((0, 4))
        return np.array([gathered.t_ns], np.int64), message.quat_xyzw[None]
    t_ns, quat_xyzw = gathered.t_ns, gathered.columns.values[:, 3:7]
    known = np.isfinite(quat_xyzw[:, 0])
    return (t_ns, quat_xyzw) if known.all() else (t_ns[known], quat_xyzw[known])
