"""TF messages of ROS 1 (tf/tfMessage, tf2_msgs/TFMessage) and ROS 2."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.messages import Float, Transforms
from quadlog.recordings.columns import Columns
from quadlog.recordings.decoders.pose import TRANSFORM_STAMPED, decode_transform, pose_in_columns

TF = {f"transforms.{path}": count for path, count in TRANSFORM_STAMPED.items()}
_NUMBERS = 9


def decode_tf(message: Any, topic: str) -> Transforms:
    """All transforms of a message; static by the topic's name, as tf2 has it.

    Every transform carries its own stamp; the message's is that of the first, None where it is empty.
    """
    transforms = tuple(decode_transform(each, topic) for each in message.transforms)
    stamp_ns = transforms[0].stamp_ns if transforms else None
    return Transforms(stamp_ns, transforms, is_static(topic))


def is_static(topic: str) -> bool:
    """Whether a topic of transforms carries static ones."""
    return topic.rsplit("/", 1)[-1] == "tf_static"


def tf_in_columns(texts: tuple[str, ...], numbers: Float) -> tuple[list[Columns], np.ndarray]:
    """The same of the numbers of TF: two names and nine numbers for each transform, which has columns of its own."""
    found: list[Columns] = []
    sound = np.ones(len(numbers), dtype=bool)
    for i in range(len(texts) // 2):
        columns, own = pose_in_columns(texts[2 * i : 2 * i + 2], numbers[:, _NUMBERS * i : _NUMBERS * (i + 1)])
        found += columns
        sound &= own
    return found, sound
