"""A recording opened as a configuration wants it, and what its tf says about the robot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from quadlog.config import Config
from quadlog.messages import Float, PointCloud
from quadlog.recordings.clock import Stamp
from quadlog.recordings.recording import Recording, open_recording
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
