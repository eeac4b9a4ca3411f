"""From protobuf payloads to objects, by the file descriptors embedded in the recording."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from quadlog.errors import DecodeError
from quadlog.recordings.container import Channel
from quadlog.recordings.payload_reader import Payload
from quadlog.recordings.type_definitions import LARGEST_DEFINITION_BYTES


def protobuf_deserialiser(channel: Channel) -> Callable[[Payload], Any]:
    """A function from payload to protobuf message; raises DecodeError, here or per payload."""
    # A tenth of a second of imports, for recordings that need them.
    from google.protobuf.message import DecodeError as ProtobufError
    from mcap.records import Schema
    from mcap_protobuf.decoder import DecoderFactory

    if len(channel.schema) > LARGEST_DEFINITION_BYTES:
        raise DecodeError(channel.topic, f"its definition is larger than {LARGEST_DEFINITION_BYTES} bytes")
    schema = Schema(id=1, name=channel.type_name, encoding="protobuf", data=channel.schema)
    try:
        decode = DecoderFactory().decoder_for("protobuf", schema)
    except Exception as error:  # descriptors from strangers fail in many ways
        reason = f"{channel.type_name}: its descriptors cannot be used ({type(error).__name__})"
        raise DecodeError(channel.topic, reason) from error
    assert decode is not None  # only for other encodings

    def deserialise(payload: Payload) -> Any:
        try:
            return decode(bytes(payload))
        except ProtobufError as error:
            raise DecodeError(channel.topic, f"not a {channel.type_name}: {error}") from error

    return deserialise
