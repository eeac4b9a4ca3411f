"""The body's tilt from the messages read so far, for levelling scans while the recording is read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from quadlog.config.schema import Config
from quadlog.geometry import rotation_from_quat
from quadlog.lidar.levelling import NotLevelled, UpSeries, level_rotations, up_in_base
from quadlog.messages import Float, Imu, Int, Odometry, Pose
from quadlog.pipelines.stages.mount import RECENT, imu_mount
from quadlog.recordings.clock import kept_rows
from quadlog.recordings.gathering import Gathered, One
from quadlog.recordings.recording import Recording
from quadlog.recordings.tf_tree import TransformTree

WEIGHED, WEIGHT_MPS2, MOST_APART_RAD = 200, (7.0, 13.0), np.radians(30.0)
"""Number of first messages that show gravity, what may be measured of it, and how far it may be off the vertical."""


def contradicts_gravity(recording: Recording, imu: str) -> str | None:
    """A warning where an IMU's orientation turns the gravity that it measures off the vertical; None elsewhere."""
    messages = [each for each in recording.sample(imu, WEIGHED) if isinstance(each, Imu)]
    oriented = [(each.quat_xyzw, each.linear_mps2) for each in messages if each.quat_xyzw is not None]
    if not oriented:
        return None
    quat_xyzw, measured_mps2 = (np.array(each) for each in zip(*oriented, strict=True))
    up_mps2 = (rotation_from_quat(quat_xyzw) @ measured_mps2[..., None]).mean(axis=0)[:, 0]
    weight_mps2 = float(np.linalg.norm(up_mps2))
    # Without gravity, as from drivers that subtract it, nothing can be said.
    if not WEIGHT_MPS2[0] < weight_mps2 < WEIGHT_MPS2[1]:
        return None
    apart_rad = float(np.arccos(np.clip(up_mps2[2] / weight_mps2, -1.0, 1.0)))
    if apart_rad < MOST_APART_RAD:
        return None
    return (
        f"{imu}: its orientation contradicts the gravity that it measures by {np.degrees(apart_rad):.0f} degrees; "
        "it is not used"
    )


LOOKED_AT = 50
"""Number of first messages that show whether an IMU gives an orientation that changes."""


class Tilt:
    """The orientation of base from the first available of IMU, odometry and moving tf.

    topics: those whose messages must be taken before clouds logged after them. An IMU is ignored while its orientation
    has never changed. tree: filled by whoever reads transforms; frames: what a look at them shows before.
    """

    def __init__(
        self,
        recording: Recording,
        tree: TransformTree,
        frames: TransformTree,
        config: Config,
        imu: str | None,
        odometry: str | None,
    ) -> None:
        self._tree, self._base, self._wanted = tree, frames.base_frame(config.topics.base_frame), config.lidar.level
        self._map_frame = None if self._base is None else frames.fixed_frame(self._base, config.topics.map_frame)
        self._imu = self._odometry = None
        looked_at = [each for each in recording.sample(imu, LOOKED_AT) if isinstance(each, Imu)] if imu else []
        oriented = [each.quat_xyzw for each in looked_at if each.quat_xyzw is not None]
        self._frozen = len(oriented) > 1 and not np.ptp(oriented, axis=0).any()
        if oriented:
            self._imu = _Recent(imu_mount(looked_at[0].frame_id, frames, config.topics.base_frame))
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
        if source is not None or not self._wanted or self._base is None or self._map_frame is None:
            return source is None or source.latest_ns >= t_ns
        span_ns = self._tree.recent(RECENT).span_between_ns(self._base, self._map_frame)
        return span_ns is not None and span_ns[1] >= t_ns

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
        if self._base is None or self._map_frame is None:
            return None
        poses = self._tree.recent(RECENT).pose_series(self._base, self._map_frame)
        planar = poses is None or not poses.quat_xyzw[:, :2].any()
        return None if poses is None or planar else up_in_base(poses.t_ns, poses.quat_xyzw)


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
    # A message of a robot's state gives columns of its joints, too.
    if gathered.columns.kind not in (Imu, Odometry, Pose):
        return np.empty(0, np.int64), np.empty((0, 4))
    t_ns, quat_xyzw = gathered.t_ns, gathered.columns.values[:, 3:7]
    known = np.isfinite(quat_xyzw[:, 0])
    return (t_ns, quat_xyzw) if known.all() else (t_ns[known], quat_xyzw[known])
