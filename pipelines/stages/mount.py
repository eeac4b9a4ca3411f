"""Where the lidar and the IMU sit in base, clouds whose frame moves in base, and which way is up."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from quadlog.config.schema import Config, Mount, Topics
from quadlog.errors import set_flag
from quadlog.geometry import (
    apply_transform,
    invert_transform,
    rotation_from_quat,
    transform_from_quat,
    transform_from_rpy,
)
from quadlog.lidar.levelling import UpSeries, level_rotations, tilt_of, up_by_floor, up_in_base
from quadlog.messages import Float, Imu, ImuSeries, Odometry, PointCloud, Pose, PoseSeries
from quadlog.recordings.recording import Recording
from quadlog.recordings.streams import Streams
from quadlog.recordings.tf_tree import BASE_FRAMES, TransformTree, is_named
from quadlog.recordings.topics.look import Roles


def frame_of(recording: Recording, topic: str) -> str | None:
    """The frame that the first message of a topic names; None where it cannot be decoded or has none."""
    kinds: tuple[type[PointCloud | Pose | Odometry | Imu], ...] = (PointCloud, Pose, Odometry, Imu)
    first = [each for kind in kinds for each in recording.sample(topic, 1, kind)]
    return first[0].frame_id if first else None


def imu_mount(frame_id: str, tree: TransformTree) -> Float | None:
    """(3, 3) rotation from an IMU's frame to base by transforms that never change; None if unknown or the identity."""
    mount = None if tree.base is None else tree.static_transform(frame_id, tree.base)
    return None if mount is None or np.array_equal(mount[:3, :3], np.eye(3)) else mount[:3, :3]


def imu_in_base(imu: ImuSeries, tree: TransformTree) -> ImuSeries:
    """The series in base's axes, where tf gives the IMU's mount; else unchanged."""
    mount = imu_mount(imu.frame_id, tree)
    if mount is None:
        return imu
    from scipy.spatial.transform import Rotation  # slow to import, and few recordings need it

    imu_to_base = Rotation.from_matrix(mount)
    quat_xyzw = imu.quat_xyzw
    if quat_xyzw is not None:
        quat_xyzw = (Rotation.from_quat(quat_xyzw) * imu_to_base.inv()).as_quat()
    return ImuSeries(imu.t_ns, imu_to_base.apply(imu.angular_radps), quat_xyzw, tree.base or "")


class LidarMount(NamedTuple):
    """How clouds come into base: by a fixed transform_lidar_to_base (4, 4), or, where their frame moves, by a mover.

    known: whether configuration or recording has it. from_tf: the lidar's frame and base, if tf gives the transform.
    frame: of a lidar that is fixed. moving: frame of the clouds and base, if that moves in it; by_odometry: whether
    odometry gives it, not tf.
    tilt_deg: roll and pitch by which the floor that the lidar sees is not level; they are part of an unknown transform.
    """

    transform_lidar_to_base: Float
    known: bool = True
    from_tf: tuple[str, str] | None = None
    moving: tuple[str, str] | None = None
    by_odometry: bool = False
    tilt_deg: tuple[float, float] | None = None
    frame: str | None = None

    def warning(self) -> str | None:
        """What is assumed where nothing says how the lidar sits, or what contradicts what says it."""
        tilt = "" if self.tilt_deg is None else "roll {:.0f}, pitch {:.0f} degrees".format(*self.tilt_deg)
        if not self.known:
            taken = "lidar.mount is neither configured nor in tf: the lidar is taken to sit in base, looking forward"
            return f"{taken}, and turned so that the floor it sees is level ({tilt})" if tilt else taken
        where = "lidar.mount" if self.from_tf is None else "the transform from {} to {}".format(*self.from_tf)
        return f"the floor that the lidar sees is tilted ({tilt}): check {where}" if tilt else None


class CloudMover:
    """Moves clouds of a frame that moves in base into base, at their stamp.

    Clouds farther than gap_ns from all poses lose their points.
    """

    def __init__(self, mount: LidarMount, streams: Streams, gap_ns: int) -> None:
        assert mount.moving is not None
        self._frame, self._base = mount.moving
        tree, odometry = streams.tf, streams.odometry
        if mount.by_odometry:
            tree = TransformTree()
            if odometry is not None:
                poses = np.column_stack([odometry.position_m, odometry.quat_xyzw])
                tree.add("", *mount.moving, odometry.t_ns, poses)
        self._t_ns = np.unique(streams.clouds_ns)
        span_ns = tree.span_between_ns(*mount.moving)
        at_ns = self._t_ns if span_ns is None else np.clip(self._t_ns, *span_ns)
        self._poses = None if span_ns is None else tree.pose_series(*mount.moving, at_ns)
        self._near = np.abs(at_ns - self._t_ns) <= (-1 if self._poses is None else gap_ns)

    def moved(self, t_ns: int, cloud: PointCloud) -> PointCloud:
        """The cloud in base, without beams and times: they are not those of a sensor that sits there."""
        xyz_m = np.empty((0, 3), np.float32)
        row = int(np.searchsorted(self._t_ns, t_ns))
        if self._poses is not None and self._near[row]:
            transform = transform_from_quat(self._poses.position_m[row], self._poses.quat_xyzw[row])
            xyz_m = apply_transform(transform, cloud.xyz_m).astype(np.float32)
        return PointCloud(cloud.stamp_ns, self._base, xyz_m)

    def warnings(self) -> list[str]:
        """How many clouds lose their points."""
        count, where = int((~self._near).sum()), f"{self._base} in {self._frame}, the frame that the clouds are in"
        return [f"{count} clouds are taken as empty: no pose near them places {where}"] if count else []


def find_mount(
    recording: Recording, roles: Roles, config: Config, lidar: str | None, odometry: str | None
) -> LidarMount:
    """From the configuration, or from what tf or odometry shows where it has none."""
    place, frame = config.lidar.mount, None if lidar is None else frame_of(recording, lidar)
    if place != Mount():
        angles_rad = np.radians([place.roll_deg, place.pitch_deg, place.yaw_deg]).tolist()
        return LidarMount(transform_from_rpy(np.array([place.x_m, place.y_m, place.z_m]), *angles_rad), frame=frame)
    if frame is None:
        return LidarMount(np.eye(4), known=False)
    frames, base = roles.frames, roles.frames.base
    if base is not None:
        fixed, moves = frames.static_transform(frame, base), bool(frames.moving(frame, base))
        if fixed is not None and not (moves and frames.is_world(frame, base)):
            return LidarMount(fixed, from_tf=(frame, base), frame=frame)
        if moves:
            return LidarMount(np.eye(4), moving=(frame, base))
    if odometry is not None and frame_of(recording, odometry) == frame and frames.is_world(frame, base):
        return LidarMount(np.eye(4), moving=(frame, base or "base"), by_odometry=True)
    return LidarMount(np.eye(4), known=is_named(frame, BASE_FRAMES), frame=frame)


def poses_in_base(streams: Streams, base: str, mount: LidarMount, topics: Mapping[str, Any]) -> Streams:
    """The streams with poses and twists of base where messages name another frame that is fixed to it, or to the lidar.

    Others are taken as base, with a warning; a target's are of another body. topics: by role. base: "" if unknown.
    """
    tree, linear_mps, angular_radps = streams.tf, streams.odometry_linear_mps, streams.odometry_angular_radps
    series = {topics.get(role): getattr(streams, role) for role in POSED} | dict(streams.estimates)
    for topic, poses in series.items():
        child = "" if poses is None else poses.child_frame_id
        if child in ("", base):
            continue
        placed = tree.static_transform(base, child)
        usual = is_named(child, BASE_FRAMES)
        by_lidar = None if mount.frame is None or usual else tree.static_transform(mount.frame, child)
        if by_lidar is not None and (placed is None or child == mount.frame):
            placed = by_lidar @ invert_transform(mount.transform_lidar_to_base)
        if placed is None:
            if topic != topics.get("target") and (not usual or child in tree.other_robots(base)):
                where = base or "base"
                why = "moves in" if tree.connects(child, base) else "no transform connects with"
                flag = set_flag("topics.base_frame", [child])
                streams.warnings.append(
                    f"{topic}: its poses are of {child}, which {why} {where}: they are taken as those of {where}; "
                    f"record the static transform, or, if that is the robot's frame:  {flag}"
                )
        elif not np.array_equal(placed, np.eye(4)):
            series[topic] = _carried(poses, placed, base)
            if topic == topics.get("odometry") and linear_mps is not None and angular_radps is not None:
                # Drivers that measure no velocity write zeros.
                lever_mps = np.cross(angular_radps, placed[:3, 3]) if linear_mps.any() else 0.0
                linear_mps, angular_radps = (linear_mps + lever_mps) @ placed[:3, :3], angular_radps @ placed[:3, :3]
    turned: dict[str, Any] = {role: series[topics.get(role)] for role in POSED}
    turned |= {"odometry_linear_mps": linear_mps, "odometry_angular_radps": angular_radps}
    return replace(streams, **turned, estimates={topic: series[topic] for topic in streams.estimates})


POSED = ("odometry", "reference", "target")
"""Roles with one topic of poses."""


def _carried(poses: PoseSeries, placed: Float, frame: str) -> PoseSeries:
    """Poses of a frame that sits at a (4, 4) transform `placed` in the one that the poses are of."""
    from scipy.spatial.transform import Rotation  # slow to import, and few recordings need it

    position_m = poses.position_m + rotation_from_quat(poses.quat_xyzw) @ placed[:3, 3]
    turned = Rotation.from_quat(poses.quat_xyzw) * Rotation.from_matrix(placed[:3, :3])
    return replace(poses, position_m=position_m, quat_xyzw=turned.as_quat(), child_frame_id=frame)


LOOKED_AT, MOST_APART_DEG, LEAST_TILT_DEG = 5, 3.0, 10.0
"""Scans in which the floor is looked for, how far it may turn between them, and the least tilt that is the mount's."""


def with_tilt(mount: LidarMount, clouds: Iterable[tuple[int, PointCloud]], up: UpSeries | None) -> LidarMount:
    """The mount with the tilt of the floor that the first clouds show; unchanged where it is level or they disagree."""
    seen = []
    for t_ns, cloud in clouds:
        turned = np.eye(3) if up is None else level_rotations(np.array([t_ns]), up)[0][0]
        turned = turned @ mount.transform_lidar_to_base[:3, :3]
        if (found := up_by_floor(cloud.xyz_m, turned)) is not None:
            seen.append(found)
    if len(seen) < 3:
        return mount
    middle = np.median(seen, axis=0)
    middle /= np.linalg.norm(middle)
    apart_deg, tilt_deg = np.degrees(np.arccos(np.clip([np.min(seen @ middle), middle[2]], -1, 1)))
    if apart_deg > MOST_APART_DEG or tilt_deg < LEAST_TILT_DEG:
        return mount
    roll_rad, pitch_rad = tilt_of(middle[None])[0].tolist()
    transform = mount.transform_lidar_to_base
    if not mount.known:
        transform = transform_from_rpy(np.zeros(3), roll_rad, pitch_rad, 0.0) @ transform
    roll_deg, pitch_deg = np.degrees([roll_rad, pitch_rad]).round() + 0.0
    # Upside down is half a turn either way.
    return mount._replace(
        transform_lidar_to_base=transform, tilt_deg=(180.0 if roll_deg == -180 else roll_deg, pitch_deg)
    )


def moved_mounts(mounts: Sequence[tuple[str, str]], tree: TransformTree) -> list[str]:
    """A warning for each transform between a sensor's frame and base that was taken as fixed and has changed."""
    changed = [edge for mount in mounts for edge in tree.moving(*mount) if not edge.is_still]
    return [
        f"the transform from {edge.parent} to {edge.child} changes, but was taken as a fixed mount: at first it did not"
        for edge in dict.fromkeys(changed)
    ]


WEIGHED, WEIGHT_MPS2, MOST_APART_RAD = 200, (7.0, 13.0), np.radians(30.0)
"""Number of first messages that show gravity, what may be measured of it, and how far it may be off the vertical."""


def contradicts_gravity(recording: Recording, imu: str) -> str | None:
    """A warning where an IMU's orientation turns the gravity that it measures off the vertical; None elsewhere."""
    messages = recording.sample(imu, WEIGHED, Imu)
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


def frozen(imu: ImuSeries) -> bool:
    """Whether all orientations are alike: drivers without one may send the same all the time."""
    return imu.quat_xyzw is not None and len(imu) > 1 and not np.ptp(imu.quat_xyzw, axis=0).any()


def up_of_base(streams: Streams, frames: TransformTree, topics: Topics, imu: ImuSeries | None) -> UpSeries | None:
    """Which way is up in base, by the first available of IMU, odometry and moving tf; None where it is unknown.

    imu: as it is mounted. frames: what a look at the transforms showed.
    """
    if imu is not None and imu.quat_xyzw is not None and not frozen(imu):
        return up_in_base(imu.t_ns, imu.quat_xyzw, imu_mount(imu.frame_id, frames))
    poses = streams.odometry
    if poses is None:
        fixed = None if frames.base is None else frames.fixed_frame(frames.base, topics.map_frame)
        poses = None if frames.base is None or fixed is None else streams.tf.pose_series(frames.base, fixed)
    if poses is None or not poses.quat_xyzw[:, :2].any():  # planar
        return None
    return up_in_base(poses.t_ns, poses.quat_xyzw)
