"""Writes a synthesized recording: CDR payloads in zstd chunks of an MCAP, definitions as ros2msg."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from mcap.writer import CompressionType, Writer

from quadlog.simulation.synthetic.recording import TF_STATIC_TOPIC, SynthesizedMessage
from quadlog.simulation.synthetic.ros_encoding import ENCODED, RosEncoder

# rosbag2's own words for: keep the last one, reliable, and for those who come later too.
LATCHED_QOS = (
    "[{history: 1, depth: 1, reliability: 1, durability: 1, deadline: {sec: 9223372036, nsec: 854775807}, "
    "lifespan: {sec: 9223372036, nsec: 854775807}, liveliness: 1, "
    "liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}, avoid_ros_namespace_conventions: false}]"
)


def write_recording(path: Path, messages: Iterable[SynthesizedMessage]) -> dict[str, int]:
    """Write every message to a new .mcap, and say how many each topic has."""
    encoder, counts = RosEncoder(), Counter[str]()
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        # A fixed name: the library's own carries its version, and with it the bytes would change.
        writer.start(profile="ros2", library="quadlog")
        for topic, log_time_ns, message in messages:
            if topic not in channels:
                name = ENCODED[type(message)][0]
                if name not in schemas:
                    schemas[name] = writer.register_schema(name, "ros2msg", encoder.definition(name).encode())
                qos = {"offered_qos_profiles": LATCHED_QOS} if topic == TF_STATIC_TOPIC else {}
                channels[topic] = writer.register_channel(topic, "cdr", schemas[name], qos)
            payload = encoder.encode(message)
            writer.add_message(channels[topic], log_time_ns, payload, log_time_ns, counts[topic])
            counts[topic] += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return dict(counts)
