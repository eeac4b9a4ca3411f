"""TF messages of ROS 1 (tf/tfMessage, tf2_msgs/TFMessage) and ROS 2."""

from __future__ import annotations

from typing import Any

from quadlog.messages import Pose, Transforms
from quadlog.recordings.decoders.pose import TRANSFORM_STAMPED, decode_transform, pose_of_values
from quadlog.recordings.plain_messages import Values

TF = {f"transforms.{path}": count for path, count in TRANSFORM_STAMPED.items()}
_NUMBERS = 9


def decode_tf(message: Any, topic: str) -> Transforms:
    """All transforms of a message; static by the topic's name, as tf2 has it.

    Every transform carries its own stamp; the message's is that of the first, None where it is empty.
    """
    return _transforms(tuple(decode_transform(each, topic) for each in message.transforms), topic)


def tf_of_values(values: Values, topic: str) -> Transforms:
    """The values of TF: two names and nine numbers for each transform."""
    texts, numbers = values
    return _transforms(
        tuple(
            pose_of_values((texts[2 * i : 2 * i + 2], numbers[_NUMBERS * i : _NUMBERS * (i + 1)]), topic)
            for i in range(len(texts) // 2)
        ),
        topic,
    )


def _transforms(transforms: tuple[Pose, ...], topic: str) -> Transforms:
    stamp_ns = transforms[0].stamp_ns if transforms else None
    return Transforms(stamp_ns, transforms, topic.rsplit("/", 1)[-1] == "tf_static")
