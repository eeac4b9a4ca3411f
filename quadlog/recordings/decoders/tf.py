"""TF messages of ROS 1 (tf/tfMessage, tf2_msgs/TFMessage) and ROS 2."""

from __future__ import annotations

from typing import Any

from quadlog.messages import Transforms
from quadlog.recordings.decoders.pose import decode_transform


def decode_tf(message: Any, topic: str) -> Transforms:
    """All transforms of a message; static by the topic's name, as tf2 has it.

    Every transform carries its own stamp; the message's is that of the first, None where it is empty.
    """
    transforms = tuple(decode_transform(each, topic) for each in message.transforms)
    stamp_ns = transforms[0].stamp_ns if transforms else None
    return Transforms(stamp_ns, transforms, topic.rsplit("/", 1)[-1] == "tf_static")
