"""The metadata.yaml of a ROS 2 bag folder: a help where it is there, never a condition."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

METADATA_NAME = "metadata.yaml"
_MAX_BYTES = 1 << 20
_MAX_BRACKETS, _MAX_COMMAS = 1000, 20_000
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
            raise ValueError(f"larger than {_MAX_BYTES} bytes")
        text = path.read_text("utf-8")
        # Recorders write blocks; brackets without end are what keeps a YAML parser busy for minutes.
        if text.count("[") + text.count("{") > _MAX_BRACKETS or text.count(",") > _MAX_COMMAS:
            raise ValueError("more brackets or commas than a recorder writes")
        document = YAML(typ="safe", pure=True).load(text)
        return _parse(document[_ROOT]), []
    except (YAMLError, ValueError, KeyError, TypeError, AttributeError, RecursionError, OSError) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        return None, [f"{METADATA_NAME} is broken ({reason}); the files beside it were read without it"]


def _parse(told: Mapping[str, Any]) -> BagMetadata:
    files = [PurePosixPath(str(name)).name for name in told.get("relative_file_paths") or []]
    topic_counts: dict[str, int] = {}
    encodings: dict[str, str] = {}
    for entry in told.get("topics_with_message_count") or []:
        topic = entry["topic_metadata"]
        name = str(topic["name"])
        encodings[name] = str(topic.get("serialization_format") or "")
        topic_counts[name] = topic_counts.get(name, 0) + int(entry["message_count"])
    messages = told.get("message_count")
    mode, scheme = str(told.get("compression_mode") or ""), str(told.get("compression_format") or "")
    if scheme not in ("", "zstd"):
        raise ValueError(f"compression_format {scheme!r} is unknown")
    return BagMetadata(
        files=[name for name in files if name not in ("", "..")],
        messages=None if messages is None else int(messages),
        topic_counts=topic_counts,
        encodings=encodings,
        compressed_messages=mode.upper() == "MESSAGE" and scheme == "zstd",
    )
