"""A recording in several files: a ROS 2 bag folder, with or without metadata.yaml."""

from __future__ import annotations

import resource
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from copy import copy
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Annotated

from pydantic import AliasPath, BaseModel, Field

from quadlog.errors import NothingReadable, QuadlogError, RecordingNotFound, TooLarge, some_of
from quadlog.recordings.containers.compression import unpack_messages, unpacked_name
from quadlog.recordings.containers.container import (
    MAX_NAME_BYTES,
    NOTHING,
    Budget,
    Container,
    LogTimes,
    Loss,
    RawMessage,
    merge_by_time,
    shared_channels,
    spread,
    starts_back_ns,
)
from quadlog.recordings.file_names import part_number, recording_files, split_sequence, stem
from quadlog.recordings.formatting import several
from quadlog.storage.plain_yaml import NotPlainYaml, read_model

METADATA_NAME = "metadata.yaml"
_MAX_BYTES = 1 << 20
_ROOT = "rosbag2_bagfile_information"
# Files that the rest of the program has open.
_SPARE_FILES = 64

_Name = Annotated[str, Field(max_length=MAX_NAME_BYTES)]
_Count = Annotated[int, Field(ge=0, le=1 << 53)]


class _Topic(BaseModel):
    """A topic and how many messages of it there are."""

    name: _Name = Field(validation_alias=AliasPath("topic_metadata", "name"))
    encoding: _Name | None = Field(None, validation_alias=AliasPath("topic_metadata", "serialization_format"))
    messages: _Count = Field(validation_alias="message_count")


class BagMetadata(BaseModel):
    """What a recorder wrote about its bag."""

    paths: list[_Name] | None = Field(None, validation_alias="relative_file_paths")
    messages: _Count | None = Field(None, validation_alias="message_count")
    topics: list[_Topic] | None = Field(None, validation_alias="topics_with_message_count")
    compression_mode: _Name | None = None
    compression_format: Annotated[str, Field(pattern="^(zstd)?$")] | None = None

    @property
    def files(self) -> list[str]:
        """Bare names: whatever path stood before them is not followed."""
        names = [PurePosixPath(each).name for each in self.paths or ()]
        return [name for name in dict.fromkeys(names) if name not in ("", "..")]

    @property
    def compressed_messages(self) -> bool:
        return (self.compression_mode or "").upper() == "MESSAGE" and self.compression_format == "zstd"


def read_metadata(folder: Path) -> tuple[BagMetadata | None, list[str]]:
    """The folder's metadata, or None and a warning when it is there and broken."""
    path = folder / METADATA_NAME
    if not path.is_file():
        return None, []
    try:
        return read_model(path, BagMetadata, _MAX_BYTES, _ROOT), []
    except (NotPlainYaml, OSError) as error:
        return None, [f"{METADATA_NAME} is broken ({error}); the files beside it were read without it"]


def is_split(folder: Path) -> bool:
    """Whether a folder is one recording: its files are one `NAME_<n>` sequence, or its metadata names them."""
    return bool(_files_of(folder)[0])


def _files_of(folder: Path) -> tuple[list[Path], BagMetadata | None, list[str]]:
    """The files of a folder that is one recording, none of another; its metadata, and what is wrong with that."""
    files = recording_files(folder)
    metadata, warnings = read_metadata(folder) if files else (None, [])
    named = metadata is not None and not _by_name(files).keys().isdisjoint(metadata.files)
    return files if named or split_sequence(files) else [], metadata, warnings


def _by_name(files: list[Path]) -> dict[str, Path]:
    """Files by their name and, where compressed, also by the name without `.zstd`: recorders write either."""
    return {unpacked_name(path): path for path in files} | {path.name: path for path in files}


def open_split(folder: Path, open_file: Callable[[Path], Container]) -> SplitReader:
    """Opens a ROS 2 bag folder. Raises RecordingNotFound for any other, or the first file's error when none opens."""
    present, metadata, warnings = _files_of(folder)
    if not present:
        raise RecordingNotFound(folder, "the folder is not one recording (a ROS 2 bag); name the files in it")
    files, losses = _choose_files(present, metadata, warnings)
    _allow_open_files(folder, len(files))
    parts: list[Container] = []
    errors: list[QuadlogError] = []
    for path in files:
        try:
            parts.append(open_file(path))
        except QuadlogError as error:
            errors.append(error)
            losses.append(Loss("missing-split", str(error)))
    if not parts:
        raise errors[0]
    return SplitReader(folder, parts, metadata, losses, warnings)


def _allow_open_files(folder: Path, count: int) -> None:
    """All files of a recording stay open: raise the soft limit as far as needed. Raises TooLarge."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = count + _SPARE_FILES
    if resource.RLIM_INFINITY not in (soft, hard) and needed > hard:
        raise TooLarge(f"{folder}: open files", needed, hard)
    if soft != resource.RLIM_INFINITY and needed > soft:
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))


def _choose_files(
    present: list[Path], metadata: BagMetadata | None, warnings: list[str]
) -> tuple[list[Path], list[Loss]]:
    """The files of the recording in order, and the losses of those that are not there."""
    sequence = split_sequence(present) or present
    if metadata is None:
        return sequence, _missing(_gaps(sequence), "the numbers of the files have a gap")
    by_name = _by_name(present)
    named = [by_name[name] for name in metadata.files if name in by_name]
    missing = [name for name in metadata.files if name not in by_name]
    unnamed = [path for path in present if path not in named]
    shown = some_of([path.name for path in unnamed])
    if unnamed and split_sequence([*named, *unnamed]):
        warnings.append(f"{METADATA_NAME} does not name {shown}, read all the same")
        named = split_sequence([*named, *unnamed])
    elif unnamed:
        warnings.append(f"{shown} not read: {METADATA_NAME} does not name it as part of the recording")
    return named, _missing(missing, f"{METADATA_NAME} names it")


def _gaps(sequence: list[Path]) -> list[str]:
    """`NAME_<n>` for each number below the highest that no file has."""
    if not split_sequence(sequence):
        return []
    known = {part_number(path) for path in sequence}
    name = stem(sequence[0]).rpartition("_")[0]
    return [f"{name}_{number}" for number in range(part_number(sequence[-1]) or 0) if number not in known]


def _missing(names: list[str], reason: str) -> list[Loss]:
    if not names:
        return []
    detail = f"{several(len(names), 'file')} of the recording missing: {some_of(names)} ({reason})"
    return [Loss("missing-split", detail)]


class SplitReader(Container):
    """Files of one recording, merged in order of log time; a file is read when its time comes."""

    def __init__(
        self,
        folder: Path,
        parts: list[Container],
        metadata: BagMetadata | None,
        losses: list[Loss],
        warnings: list[str],
    ) -> None:
        super().__init__(folder)
        for part in parts:
            self.resources.push(part)
        self._parts = parts
        self._empty_parts: list[NothingReadable] = []
        self._metadata = metadata
        self._losses, self._warnings = losses, warnings
        # Each part's channels to the recording's.
        self._merged = shared_channels((each, each.identity, each.count) for part in parts for each in part.channels)
        self.channels = tuple(dict.fromkeys(self._merged.values()))
        self._compare_with_metadata()
        spans = {part.path.name: part.span_ns for part in parts if part.span_ns is not None}
        if spans:
            self.span_ns = min(start for start, _ in spans.values()), max(end for _, end in spans.values())
        for name, back_ns in zip(spans, starts_back_ns([*spans.values()]), strict=True):
            if back_ns:
                warnings.append(
                    f"{name} starts {back_ns / 1e9:.3f} s before the files ahead of it end; "
                    "messages come in order of log time"
                )

    @property
    def losses(self) -> list[Loss]:
        """Own and parts' losses."""
        parts = ((part.path.name, loss) for part in self._parts for loss in part.losses)
        theirs = [replace(loss, detail=f"{name}: {loss.detail}") for name, loss in parts]
        return [*super().losses, *theirs]

    @property
    def warnings(self) -> list[str]:
        """Own and parts' warnings."""
        return [*super().warnings, *(f"{part.path.name}: {each}" for part in self._parts for each in part.warnings)]

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Of all parts, by log time. Raises NothingReadable where no part has any."""
        self._empty_parts.clear()
        yield from merge_by_time(
            (part.span_ns[0] if part.span_ns else 0, self._read_part(part, topics, start_ns, end_ns))
            for part in self._parts
        )
        if len(self._empty_parts) == len(self._parts):
            raise self._empty_parts[0]

    def log_times(self) -> Iterator[LogTimes]:
        for part in self._parts:
            for channel, t_ns in part.log_times():
                yield LogTimes(self._merged[channel], t_ns)

    def excerpt(self, budget: Budget) -> SplitReader | None:
        """Excerpts of parts that are spread over the recording, and share the budget."""
        count = min(budget.places, len(self._parts))
        chosen = set(spread(len(self._parts), count))
        shared = budget.shared(max(count, 1))
        views = [part.excerpt(shared if i in chosen else NOTHING) for i, part in enumerate(self._parts)]
        if all(view is None for view in views):
            return None
        excerpt = copy(self)
        excerpt._parts = [part if view is None else view for part, view in zip(self._parts, views, strict=True)]
        return excerpt

    def _read_part(
        self, part: Container, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[RawMessage]:
        try:
            messages = part.messages(topics, start_ns, end_ns)
            if self._metadata is not None and self._metadata.compressed_messages:
                messages = unpack_messages(messages, self._losses)
            for message in messages:
                yield RawMessage(self._merged[message.channel], message.log_time_ns, message.payload)
        except NothingReadable as error:
            self._empty_parts.append(error)
            # One part with nothing left in it must not cost the others.
            self._losses.append(Loss("missing-split", str(error)))

    def _compare_with_metadata(self) -> None:
        if self._metadata is None:
            return
        topics = self._metadata.topics or []
        encodings = {topic.name: topic.encoding for topic in topics}
        for channel in self.channels:
            said_encoding = encodings.get(channel.topic) or channel.message_encoding
            if said_encoding != channel.message_encoding:
                self._warnings.append(
                    f"{channel.topic}: {METADATA_NAME} says {said_encoding!r}, the file itself says "
                    f"{channel.message_encoding!r}, which is taken"
                )
        said, had = Counter[str](), Counter[str]()  # by topic, or of all without one
        for channel in self.channels if topics or self._metadata.messages is not None else ():
            had[channel.topic if topics else ""] += channel.count
        for topic in topics:
            said[topic.name] += topic.messages
        if not topics and self._metadata.messages is not None:
            said[""] = self._metadata.messages
        for name in sorted(said.keys() | had.keys()):
            note = f"{METADATA_NAME} says {several(said[name], 'message')}, the files have {had[name]}"
            if had[name] < said[name]:
                self._losses.append(Loss("count", note, name or None, said[name] - had[name]))
            elif had[name] > said[name]:
                self._warnings.append(f"{name}: {note}" if name else note)
