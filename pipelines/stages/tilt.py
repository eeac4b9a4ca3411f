"""The body's tilt, for levelling scans: from which source, and whether an IMU's orientation can be one."""

from __future__ import annotations

import numpy as np

from quadlog.config.schema import Topics
from quadlog.geometry import rotation_from_quat
from quadlog.lidar.levelling import UpSeries, up_in_base
from quadlog.messages import Imu, ImuSeries
from quadlog.pipelines.stages.mount import imu_mount
from quadlog.recordings.recording import Recording
from quadlog.recordings.streams import Streams
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


def frozen(imu: ImuSeries) -> bool:
    """Whether all orientations are alike: drivers without one may send the same all the time."""
    return imu.quat_xyzw is not None and len(imu) > 1 and not np.ptp(imu.quat_xyzw, axis=0).any()


def up_of_base(streams: Streams, frames: TransformTree, topics: Topics, imu: ImuSeries | None) -> UpSeries | None:
    """Which way is up in base, by the first available of IMU, odometry and moving tf; None where it is unknown.

    imu: as it is mounted. frames: what a look at the transforms showed.
    """
    if imu is not None and imu.quat_xyzw is not None and not frozen(imu):
        return up_in_base(imu.t_ns, imu.quat_xyzw, imu_mount(imu.frame_id, frames, topics.base_frame))
    if streams.odometry is not None:
        return up_in_base(streams.odometry.t_ns, streams.odometry.quat_xyzw)
    base = frames.base_frame(topics.base_frame)
    fixed = None if base is None else frames.fixed_frame(base, topics.map_frame)
    poses = None if base is None or fixed is None else streams.tf.pose_series(base, fixed)
    if poses is None or not poses.quat_xyzw[:, :2].any():  # planar
        return None
    return up_in_base(poses.t_ns, poses.quat_xyzw)
