"""A recording opened as a configuration wants it, and what its tf says about the robot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quadlog.config import Config
from quadlog.messages import Float, ImuSeries, PointCloud
from quadlog.recordings.clock import Stamp
from quadlog.recordings.recording import Recording, open_recording

if TYPE_CHECKING:
    from quadlog.recordings.tf_tree import TransformTree


def open_configured(path: Path, config: Config, msg_path: Sequence[Path] = (), stamp: Stamp = "header") -> Recording:
    """The recording with the topics' ends and anchors that the configuration knows. Raises as open_recording does."""
    return open_recording(
        path,
        stamp=stamp,
        msg_path=msg_path,
        range_topics={each.topic: (each.tag, each.anchor) for each in config.uwb.range_topics},
        anchor_ids=[anchor.id for anchor in config.uwb.anchors],
    )


def lidar_in_base(recording: Recording, topic: str | None, tree: TransformTree, base_frame: str = "") -> Float | None:
    """(4, 4) transform_lidar_to_base through static tf, None where the frames do not connect."""
    base = tree.base_frame(base_frame)
    if topic is None or base is None:
        return None
    clouds = [each for each in recording.sample(topic, 1) if isinstance(each, PointCloud)]
    return tree.static_transform(clouds[0].frame_id, base) if clouds else None


def imu_mount(frame_id: str, tree: TransformTree, base_frame: str = "") -> Float | None:
    """(3, 3) rotation from an IMU's frame to base through static tf; None where it is not told, or is no rotation."""
    base = tree.base_frame(base_frame)
    mount = None if base is None else tree.static_transform(frame_id, base)
    return None if mount is None or np.array_equal(mount[:3, :3], np.eye(3)) else mount[:3, :3]


def imu_in_base(imu: ImuSeries, tree: TransformTree, base_frame: str = "") -> ImuSeries:
    """The same turned into base's axes, where static tf tells how the IMU is mounted; else as it came."""
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
