"""The metadata.yaml of a ROS 2 bag folder: a help where it is there, never a condition."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from quadlog.plain_yaml import NotPlainYaml, Plain, list_of, mapping_of, number_of, parse_yaml, text_of
from quadlog.recordings.bounded import MAX_NAME_BYTES
from quadlog.text import clipped

METADATA_NAME = "metadata.yaml"
_MAX_BYTES = 1 << 20
_MAX_COUNT = 1 << 53
_ROOT = "rosbag2_bagfile_information"


@dataclass
class BagMetadata:
    """What a recorder wrote about its bag. files are bare names: whatever path stood before them is not followed."""

    files: list[str] = field(default_factory=list)
    messages: int | None = None
    topic_counts: dict[str, int] = field(default_factory=dict)
    encodings: dict[str, str] = field(default_factory=dict)
    compressed_messages: bool = False


def read_metadata(folder: Path) -> tuple[BagMetadata | None, list[str]]:
    """The folder's metadata, or None and a warning when it is there and broken."""
    path = folder / METADATA_NAME
    if not path.is_file():
        return None, []
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise NotPlainYaml(f"is larger than {_MAX_BYTES} bytes")
        document = mapping_of(parse_yaml(path.read_bytes()), "the document")
        return _parse(mapping_of(document.get(_ROOT), _ROOT)), []
    except (NotPlainYaml, OSError) as error:
        return None, [f"{METADATA_NAME} is broken ({error}); the files beside it were read without it"]


def _parse(said: dict[str, Plain]) -> BagMetadata:
    files = [PurePosixPath(_name(each, "a file's name")).name for each in _entries(said, "relative_file_paths")]
    topic_counts: dict[str, int] = {}
    encodings: dict[str, str] = {}
    for each in _entries(said, "topics_with_message_count"):
        entry = mapping_of(each, "a topic")
        topic = mapping_of(entry.get("topic_metadata"), "topic_metadata")
        name = _name(topic.get("name"), "a topic's name")
        encodings[name] = _name(topic.get("serialization_format"), "serialization_format", "")
        topic_counts[name] = topic_counts.get(name, 0) + _count(entry)
    mode, scheme = (_name(said.get(f"compression_{word}"), f"compression_{word}", "") for word in ("mode", "format"))
    if scheme not in ("", "zstd"):
        raise NotPlainYaml(f"compression_format {clipped(scheme, 50)!r} is unknown")
    return BagMetadata(
        files=[name for name in files if name not in ("", "..")],
        messages=None if said.get("message_count") is None else _count(said),
        topic_counts=topic_counts,
        encodings=encodings,
        compressed_messages=mode.upper() == "MESSAGE" and scheme == "zstd",
    )


def _entries(said: dict[str, Plain], key: str) -> list[Plain]:
    return list_of(said.get(key), key)


def _name(value: Plain, what: str, default: str | None = None) -> str:
    name = text_of(value, what, default)
    if len(name) > MAX_NAME_BYTES:
        raise NotPlainYaml(f"{what} has {len(name)} characters")
    return name


def _count(said: dict[str, Plain]) -> int:
    count = number_of(said.get("message_count"), "message_count")
    if not (0 <= count <= _MAX_COUNT and count.is_integer()):
        raise NotPlainYaml(f"message_count is {count:g}")
    return int(count)
