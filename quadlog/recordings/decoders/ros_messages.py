"""Which definition a message has, and messages as objects, for plug-ins.

Order: the definition embedded in the recording; then folders given with
``--msg-path``; then the standard messages; then quadlog's bundled ones.
Where a recording embeds none and several versions of a message exist, the
first that fits a payload to its last byte is the one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache, lru_cache, partial
from pathlib import Path
from types import SimpleNamespace

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from quadlog.errors import DecodeError
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.fields import Walk
from quadlog.recordings.decoders.payload import Payload
from quadlog.recordings.decoders.type_definitions import BadDefinition, Types, needed_types, parse_definition

MOST_VALUES = 1 << 20  # of a message for a plug-in, each an object in memory
BUNDLED = Path(__file__).parent / "definitions"
PORTS = {"unitree_legged_msgs": "ros2_unitree_legged_msgs"}
"""Packages whose messages have the layout of another one's."""
HEADER_FIELD = "std_msgs/Header header\n"


class Definitions:
    """Where definitions are looked up. msg_path: folders of .msg files."""

    def __init__(self, msg_path: Sequence[Path | str] = ()) -> None:
        self.folders = [Path(folder) for folder in msg_path]

    def deserialiser(self, channel: Channel) -> Callable[[Payload], SimpleNamespace]:
        """A function from payload to an object with the fields of its message, by the first definition that fits.

        Arrays of numbers are numpy's. Raises DecodeError, here or per payload, with the reason.
        """
        try:
            tables = list(self.candidates(channel))
        except BadDefinition as error:
            raise DecodeError(channel.topic, f"{channel.type_name}: {error}") from error

        def deserialise(payload: Payload) -> SimpleNamespace:
            why = ""
            for types in tables:
                try:
                    walk = Walk(payload, channel, left=MOST_VALUES)
                    message = walk.message(types, channel.type_name)
                    walk.end()
                except DecodeError as error:
                    why = why or error.reason
                else:
                    return message
            raise DecodeError(channel.topic, f"not a {channel.type_name}: {why}")

        return deserialise

    def candidates(self, channel: Channel) -> Iterator[Types]:
        """The checked table of every definition the type may have. Raises BadDefinition."""
        name, standard = channel.type_name, partial(standard_types, channel.message_encoding)
        if channel.schema.strip(b"\0 \n"):
            yield embedded_types(*channel.identity[1:])
            return
        found = [(_read_msg(path, name), folder) for folder in self.folders if (path := _msg_file(folder, name))]
        versions = _standard_versions(channel.message_encoding, name)
        others = [(types, None) for types in versions] or _bundled(name, channel.message_encoding)
        if not found and not others:
            raise BadDefinition("the recording embeds no definition; give its .msg with --msg-path")
        for types, folder in [*found, *others]:
            yield needed_types(types, name, partial(_from_folder, folder, standard))


def embedded_types(type_name: str, message_encoding: str, schema_encoding: str, schema: bytes) -> Types:
    """The checked types of a definition that a recording embeds. Raises BadDefinition."""
    types = parse_definition(schema, type_name, schema_encoding or "ros2msg")
    return needed_types(types, type_name, partial(standard_types, message_encoding))


def _bundled(name: str, encoding: str) -> list[tuple[Types, Path | None]]:
    """Tables of a bundled message and the folder of its parts; ROS 2 ports put a header before those without."""
    path = _bundled_file(name)
    if path is None:
        return []
    text = path.read_text(encoding="utf-8")
    texts = [text] if "Header header" in text else [HEADER_FIELD + text, text]
    ordered = reversed(texts) if encoding == "ros1" else texts
    return [(parse_definition(each, name, "ros2msg"), path.parent) for each in ordered]


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
    package, last = name.partition("/")[0], name.rpartition("/")[2]
    original = "nlink_parser" if last.startswith("Linktrack") else PORTS.get(package, package)
    return _msg_file(BUNDLED, name) or _msg_file(BUNDLED, f"{original}/{last}")


def _msg_file(folder: Path, name: str) -> Path | None:
    """PACKAGE/msg/NAME.msg, PACKAGE/NAME.msg or NAME.msg under a folder."""
    package, last = name.partition("/")[0], name.rpartition("/")[2]
    choices = (folder / package / "msg" / f"{last}.msg", folder / package / f"{last}.msg", folder / f"{last}.msg")
    return next((path for path in choices if path.is_file()), None)


def _from_folder(folder: Path | None, standard: Callable[[str], Types], name: str) -> Types:
    path = folder and _msg_file(folder, name)
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
