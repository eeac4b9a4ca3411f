"""Where the lidar and the IMU sit in base, and clouds whose frame moves in base."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from quadlog.config.schema import Config, Mount
from quadlog.geometry import transform_from_quat, transform_from_rpy
from quadlog.messages import Float, Imu, ImuSeries, Odometry, PointCloud, Pose
from quadlog.recordings.gathering import Gathered, Many
from quadlog.recordings.recording import Recording
from quadlog.recordings.roles import Roles
from quadlog.recordings.tf_tree import BASE_FRAMES, TransformTree, is_named

TakeCloud = Callable[[int, PointCloud], None]
RECENT = 1024
"""Poses of each transform that are kept in view: a second at 1 kHz."""


def lidar_in_base(recording: Recording, topic: str | None, tree: TransformTree, base_frame: str = "") -> Float | None:
    """(4, 4) transform_lidar_to_base through transforms that never change, None where these do not connect."""
    base = tree.base_frame(base_frame)
    frame = None if topic is None else frame_of(recording, topic)
    return None if base is None or frame is None else tree.static_transform(frame, base)


def frame_of(recording: Recording, topic: str) -> str | None:
    """The frame that the first message of a topic names; None where it cannot be decoded or has none."""
    first = next(iter(recording.sample(topic, 1)), None)
    return first.frame_id if isinstance(first, (PointCloud, Imu, Odometry, Pose)) else None


def imu_mount(frame_id: str, tree: TransformTree, base_frame: str = "") -> Float | None:
    """(3, 3) rotation from an IMU's frame to base by transforms that never change; None if unknown or the identity."""
    base = tree.base_frame(base_frame)
    mount = None if base is None else tree.static_transform(frame_id, base)
    return None if mount is None or np.array_equal(mount[:3, :3], np.eye(3)) else mount[:3, :3]


def imu_in_base(imu: ImuSeries, tree: TransformTree, base_frame: str = "") -> ImuSeries:
    """The series in base's axes, where tf gives the IMU's mount; else unchanged."""
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


class CloudMover:
    """Moves clouds of a frame that moves in base into base, at their stamp, by what was read until then.

    tree: filled by whoever reads transforms. odometry: the topic that places base in the clouds' frame instead. Clouds
    farther than gap_ns from all poses lose their points.
    """

    def __init__(self, tree: TransformTree, frame: str, base: str, odometry: str | None, gap_ns: int) -> None:
        self._tree = tree if odometry is None else TransformTree()
        self._frame, self._base, self._odometry, self._gap_ns = frame, base, odometry, gap_ns
        self._unplaced: set[int] = set()

    def topics(self, tf: Sequence[str]) -> list[str]:
        """Those whose messages must be taken before clouds logged after them; tf: those of moving transforms."""
        return list(tf) if self._odometry is None else [self._odometry]

    def take(self, gathered: Gathered) -> None:
        """Store odometry; transforms are in the tree already."""
        if gathered.topic != self._odometry:
            return
        frames = gathered.topic, self._frame, self._base
        if isinstance(gathered, Many):
            self._tree.add_moving(*frames, gathered.order, gathered.t_ns, gathered.columns.values[:, :7])
        elif isinstance(gathered.message, (Odometry, Pose)):
            pose = np.concatenate([gathered.message.position_m, gathered.message.quat_xyzw])
            self._tree.add_moving(*frames, np.array([gathered.order]), np.array([gathered.t_ns]), pose[None])

    def reaches(self, t_ns: int) -> bool:
        """Whether poses are known up to an instant."""
        span = self._tree.recent(RECENT).span_between_ns(self._frame, self._base)
        return span is not None and span[1] >= t_ns

    def moved(self, t_ns: int, cloud: PointCloud) -> PointCloud:
        """The cloud in base, without beams and times: they are not those of a sensor that sits there."""
        xyz_m = np.empty((0, 3), np.float32)
        tree = self._tree.recent(RECENT)
        span = tree.span_between_ns(self._frame, self._base)
        at_ns = t_ns if span is None else min(max(t_ns, span[0]), span[1])
        poses = None if span is None else tree.pose_series(self._frame, self._base, np.array([at_ns], np.int64))
        if poses is None or abs(at_ns - t_ns) > self._gap_ns:
            self._unplaced.add(t_ns)
        else:
            transform = transform_from_quat(poses.position_m[0], poses.quat_xyzw[0])
            xyz_m = (cloud.xyz_m @ transform[:3, :3].T + transform[:3, 3]).astype(np.float32)
        return PointCloud(cloud.stamp_ns, self._base, xyz_m)

    def warnings(self) -> list[str]:
        """How many clouds lost their points."""
        count, where = len(self._unplaced), f"{self._base} in {self._frame}, the frame that the clouds are in"
        return [f"{count} clouds are taken as empty: no pose near them places {where}"] if count else []


class LidarMount(NamedTuple):
    """How clouds come into base: by a fixed transform_lidar_to_base (4, 4), after the mover where their frame moves.

    known: whether configuration or recording tells. from_tf: the lidar's frame and base, if tf gives the transform.
    """

    transform_lidar_to_base: Float
    known: bool = True
    mover: CloudMover | None = None
    from_tf: tuple[str, str] | None = None

    def behind(self, take: TakeCloud) -> TakeCloud:
        """What takes clouds as they come, for one that takes those the mover has moved."""
        mover = self.mover
        return take if mover is None else lambda t_ns, cloud: take(t_ns, mover.moved(t_ns, cloud))


def find_mount(
    recording: Recording, roles: Roles, config: Config, lidar: str | None, tree: TransformTree, odometry: str | None
) -> LidarMount:
    """From the configuration, or from what tf or odometry shows where it has none; tree: of the transforms to come."""
    place = config.lidar.mount
    if place != Mount():
        angles_rad = np.radians([place.roll_deg, place.pitch_deg, place.yaw_deg]).tolist()
        return LidarMount(transform_from_rpy(np.array([place.x_m, place.y_m, place.z_m]), *angles_rad))
    frame = None if lidar is None else frame_of(recording, lidar)
    if frame is None:
        return LidarMount(np.eye(4), known=False)
    frames, gap_ns = roles.frames, round(config.lidar.pose_gap_s * 1e9)
    base = frames.base_frame(config.topics.base_frame)
    if base is not None:
        fixed, moves = frames.static_transform(frame, base), bool(frames.moving(frame, base))
        if fixed is not None and not (moves and frames.is_world(frame, base)):
            return LidarMount(fixed, from_tf=(frame, base))
        if moves:
            return LidarMount(np.eye(4), mover=CloudMover(tree, frame, base, None, gap_ns))
    if odometry is not None and frame_of(recording, odometry) == frame and frames.is_world(frame, base):
        return LidarMount(np.eye(4), mover=CloudMover(tree, frame, base or "base", odometry, gap_ns))
    return LidarMount(np.eye(4), known=is_named(frame, BASE_FRAMES))


def moved_mounts(mounts: Sequence[tuple[str, str]], tree: TransformTree) -> list[str]:
    """A warning for each transform between a sensor's frame and base that was taken as fixed and has changed."""
    changed = [edge for mount in mounts for edge in tree.moving(*mount) if not edge.is_still]
    return [
        f"the transform from {edge.parent} to {edge.child} changes, but was taken as a fixed mount: at first it did not"
        for edge in dict.fromkeys(changed)
    ]
