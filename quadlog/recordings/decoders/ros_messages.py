"""From ROS payloads to quadlog's messages, by whatever definition there is.

Order: the definition embedded in the recording; then folders given with
``--msg-path``; then the standard messages; then quadlog's bundled ones.
Where a recording embeds none and several versions of a message exist, the
first that fits a payload to its last byte is the one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from quadlog.errors import DecodeError
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.columns import ColumnDecoder, Misfit, Ways, flat_fields
from quadlog.recordings.decoders.payload import Payload
from quadlog.recordings.decoders.type_definitions import (
    MOST_VALUES,
    BadDefinition,
    Types,
    largest_payload_bytes,
    needed_types,
    parse_definition,
)

BUNDLED = Path(__file__).parent / "definitions"
PORTS = {"unitree_legged_msgs": "ros2_unitree_legged_msgs"}
"""Packages whose messages have the layout of another one's."""
HEADER_FIELD = "std_msgs/Header header\n"

Deserialise = Callable[[Payload], Any]
Interpret = Callable[[Any, str], Any]
# How to read payloads, and the size beyond which they are refused.
Way = tuple[Deserialise, float]


class Definitions:
    """Where definitions are looked up. msg_path: folders of .msg files."""

    def __init__(self, msg_path: Sequence[Path] = ()) -> None:
        self.folders = [Path(folder) for folder in msg_path]
        self._ways: dict[tuple[Any, ...], list[Way]] = {}
        self._stores: list[Typestore] = []

    def decoder(self, channel: Channel, interpret: Interpret) -> Callable[[Payload], Any]:
        """A function from payload to what interpret makes of (message object, topic).

        Raises DecodeError, here or per payload, with the reason.
        """
        if channel.message_encoding not in ("ros1", "cdr"):
            raise DecodeError(channel.topic, f"its message encoding {channel.message_encoding!r} is not known")
        # Topics often share a definition, and to compile one takes 10 ms.
        alike = (channel.type_name, channel.message_encoding, channel.schema_encoding, channel.schema, interpret)
        try:
            found = self._ways.get(alike) or [self._way(types, channel) for types in self.candidates(channel)]
        except BadDefinition as error:
            raise DecodeError(channel.topic, f"{channel.type_name}: {error}") from error
        if not found:
            raise DecodeError(
                channel.topic, f"{channel.type_name}: the recording embeds no definition; give its .msg with --msg-path"
            )
        self._ways[alike] = found
        return _FirstFitting(channel, found, interpret)

    def column_decoder(self, channel: Channel, payload: bytes, ways: Ways) -> ColumnDecoder | None:
        """What decodes the channel's messages many at a time, by the first definition that fits a payload.

        ways: what may be wanted of it. None where that definition has none of it, or none fits.
        """
        try:
            for types in self.candidates(channel):
                flat = ((flat_fields(types, channel.type_name, wanted), in_columns) for wanted, in_columns in ways)
                fields, in_columns = next((each for each in flat if each[0] is not None), (None, None))
                if fields is None or in_columns is None:
                    return None
                decoder = ColumnDecoder(fields, channel.message_encoding, in_columns)
                with suppress(Misfit):
                    decoder.learn(payload)
                    return decoder
        except BadDefinition:
            pass
        return None

    def _way(self, types: Types, channel: Channel) -> Way:
        """How rosbags reads payloads of a definition. Raises BadDefinition."""
        store = self._typestore(types)
        try:
            store.get_msgdef(channel.type_name)
        except Exception as error:  # rosbags compiles the definition; what it cannot is refused
            raise _not_compiled(error) from error
        deserialise = store.deserialize_ros1 if channel.message_encoding == "ros1" else store.deserialize_cdr
        return partial(deserialise, typename=channel.type_name), largest_payload_bytes(types)

    def _typestore(self, types: Types) -> Typestore:
        """One that knows the types, shared where those of the same name are the same: each is compiled once."""
        for store in self._stores:
            known = {name: fields for name, (_, fields) in store.fielddefs.items()}
            if all(known.get(name, fields) == fields for name, (_, fields) in types.items()):
                break
        else:
            store = get_typestore(Stores.EMPTY)
        try:
            store.register({name: each for name, each in types.items() if name not in store.fielddefs})
        except Exception as error:
            raise _not_compiled(error) from error
        if store not in self._stores:
            self._stores.append(store)
        return store

    def candidates(self, channel: Channel) -> Iterator[Types]:
        """The checked table of every definition the type may have. Raises BadDefinition."""
        if channel.schema.strip(b"\0 \n"):
            types = parse_definition(channel.schema, channel.type_name, channel.schema_encoding or "ros2msg")
            yield needed_types(types, channel.type_name, self._standard(channel))
            return
        for types, lookup in self._unembedded(channel):
            yield needed_types(types, channel.type_name, lookup)

    def _unembedded(self, channel: Channel) -> Iterator[tuple[Types, Callable[[str], Types]]]:
        name, standard = channel.type_name, self._standard(channel)
        for folder in self.folders:
            path = _msg_file(folder, name)
            if path is not None:
                yield _read_msg(path, name), partial(_from_folder, folder, standard)
        versions = _standard_versions(channel.message_encoding, name)
        for types in versions:
            yield types, standard
        if not versions:
            yield from self._bundled(name, channel.message_encoding)

    def _bundled(self, name: str, encoding: str) -> Iterator[tuple[Types, Callable[[str], Types]]]:
        path = _bundled_file(name)
        if path is None:
            return
        package = name.rpartition("/")[0]
        text = path.read_text(encoding="utf-8")
        # ROS 2 ports of header-less messages put a header before them.
        texts = [text] if "Header header" in text else [HEADER_FIELD + text, text]

        def lookup(other: str) -> Types:
            beside = path.parent / f"{other.rpartition('/')[2]}.msg"
            if other.rpartition("/")[0] == package and beside.is_file():
                return _read_msg(beside, other)
            return standard_types(encoding, other)

        for each in reversed(texts) if encoding == "ros1" else texts:
            yield parse_definition(each, name, "ros2msg"), lookup

    def _standard(self, channel: Channel) -> Callable[[str], Types]:
        return lambda name: standard_types(channel.message_encoding, name)


def _not_compiled(error: Exception) -> BadDefinition:
    return BadDefinition(f"its definition cannot be compiled ({error})")


class _FirstFitting:
    """Tries each way to read on the first payload and keeps the one that fits it exactly."""

    def __init__(self, channel: Channel, ways: list[Way], interpret: Interpret) -> None:
        self.channel, self.ways, self.interpret = channel, ways, interpret

    def __call__(self, payload: Payload) -> Any:
        reason: Exception | None = None
        for way in self.ways:
            deserialise, most_bytes = way
            try:
                if len(payload) > most_bytes:
                    raise ValueError(f"its payload of {len(payload)} bytes may hold more than {MOST_VALUES} values")
                message = deserialise(payload)
            except Exception as error:  # generated code on untrusted bytes: any failure is this message's
                reason = reason or error
                continue
            if len(self.ways) > 1:
                self.ways = [way]
            return self._interpreted(message)
        raise DecodeError(self.channel.topic, f"not a {self.channel.type_name}: {reason}") from reason

    def _interpreted(self, message: Any) -> Any:
        try:
            return self.interpret(message, self.channel.topic)
        except (AttributeError, TypeError, ValueError, OverflowError) as error:  # a definition of another shape
            reason = f"not the usual {self.channel.type_name}: {error}"
            raise DecodeError(self.channel.topic, reason) from error


@cache
def _standard_stores(encoding: str) -> tuple[Typestore, ...]:
    names = [Stores.ROS1_NOETIC] if encoding == "ros1" else [Stores.ROS2_HUMBLE, Stores.LATEST]
    return tuple(get_typestore(name) for name in names)


def _standard_versions(encoding: str, name: str) -> list[Types]:
    """Tables of each distinct version of a standard message."""
    versions: list[Types] = []
    for store in _standard_stores(encoding):
        if name in store.fielddefs and all(each[name][1] != store.fielddefs[name][1] for each in versions):
            versions.append(dict(store.fielddefs))  # type: ignore[arg-type]
    return versions


def standard_types(encoding: str, name: str) -> Types:
    """The table that holds a standard ROS type (in its older version, where there are two), or an empty one."""
    return next(iter(_standard_versions(encoding, name)), {})


def _bundled_file(name: str) -> Path | None:
    """The bundled definition of the same package, or else of the one that it is a port of (LinkTrack by any name)."""
    package, _, last = name.partition("/")[0], "", name.rpartition("/")[2]
    exact = BUNDLED / package / "msg" / f"{last}.msg"
    if exact.is_file():
        return exact
    original = "nlink_parser" if last.startswith("Linktrack") else PORTS.get(package, "")
    port = BUNDLED / original / "msg" / f"{last}.msg"
    return port if original and port.is_file() else None


def _msg_file(folder: Path, name: str) -> Path | None:
    """PACKAGE/msg/NAME.msg, PACKAGE/NAME.msg or NAME.msg under a folder."""
    package, last = name.partition("/")[0], name.rpartition("/")[2]
    choices = (folder / package / "msg" / f"{last}.msg", folder / package / f"{last}.msg", folder / f"{last}.msg")
    return next((path for path in choices if path.is_file()), None)


def _from_folder(folder: Path, standard: Callable[[str], Types], name: str) -> Types:
    path = _msg_file(folder, name)
    return standard(name) if path is None else _read_msg(path, name)


def _read_msg(path: Path, name: str) -> Types:
    return parse_definition(path.read_text(encoding="utf-8", errors="replace"), name, "ros2msg")


@lru_cache(maxsize=64)
def is_defined_as(bundled: str, type_name: str, schema_encoding: str, schema: bytes) -> bool:
    """Whether a definition is one of those of a bundled package, whatever it calls its own."""
    package, own = BUNDLED / bundled / "msg", type_name.rpartition("/")[0]
    known = [_read_msg(path, f"{own}/{path.stem}") for path in package.glob("*.msg")]
    try:
        types = parse_definition(schema, type_name, schema_encoding or "ros2msg")
    except BadDefinition:
        return False
    return all(types.get(name, ([],))[1:] == fields[1:] for each in known for name, fields in each.items())
