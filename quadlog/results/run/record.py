"""`run.json`: how a run was made, from what input, and what was lost."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from threading import Thread
from typing import Any, cast
from uuid import uuid4

from quadlog.config.version import describe_host, package_versions
from quadlog.errors import RecordingNotFound
from quadlog.recordings.file_names import recording_files
from quadlog.storage.remote_object import ObjectInfo
from quadlog.storage.remote_path import RemotePath
from quadlog.storage.urls import redacted_text

RUN_FORMAT = 1
"""Increased when scripts that read run folders have to change, for a file, column or unit."""


@dataclass(frozen=True, slots=True)
class InputRecord:
    """The recording: path as given, size, and a fingerprint (see `describe_input`).

    The fingerprint is the SHA-256 of the content; of a URL the server's ETag, or else its Last-Modified.
    """

    path: str
    size_bytes: int
    sha256: str | None = None
    etag: str | None = None
    last_modified: str | None = None

    @property
    def fingerprint(self) -> tuple[str, str] | None:
        """Kind and value of the fingerprint; None if a server gives none."""
        known = {"SHA-256": self.sha256, "ETag": self.etag, "Last-Modified": self.last_modified}
        return next(((name, value) for name, value in known.items() if value is not None), None)

    @property
    def identity(self) -> str:
        """Equal for equal inputs; unique on each call without a fingerprint, so that such an input is never equal."""
        if self.fingerprint is None:
            return f"unknown {uuid4().hex}"
        name, value = self.fingerprint
        return value if name == "SHA-256" else f"{self.size_bytes} bytes, {name} {value}"

    @classmethod
    def identity_in(cls, saved: Any) -> str | None:
        """The identity of `input` in a run.json; None if it is invalid."""
        names = [each.name for each in fields(cls)]
        try:
            return cls(**{name: saved[name] for name in names if name in saved}).identity
        except TypeError:
            return None


@dataclass(frozen=True, slots=True)
class TopicRecord:
    """A topic that was used: the role it played, its type, its messages, and why it was chosen."""

    role: str
    topic: str
    type: str
    messages: int
    why: str


@dataclass(frozen=True, slots=True)
class LossRecord:
    """Something lost from the recording: a stable cause, and a line of text."""

    cause: str
    detail: str
    topic: str | None = None
    count: int | None = None


@dataclass(frozen=True, slots=True)
class StageRecord:
    """A stage that ran: wall seconds, and the process's peak memory when it ended."""

    name: str
    seconds: float
    peak_memory_mb: float


@dataclass(frozen=True, slots=True)
class PluginRecord:
    """A planner or decoder of another distribution that was used: its entry point and distribution."""

    group: str
    name: str
    distribution: str
    version: str


@dataclass(frozen=True, slots=True)
class RunRecord:
    """The content of `run.json`.

    command: the arguments, the program first; config: the effective config; options: what else the result depends on
    (seed, stamp, start_s, duration_s, until, preset), compared by `--resume`; recorded_s: length of what was replayed;
    counts: name: number; notes: choices that affected the result; startup_s: imports and compilation, not part of the
    stages; realtime_factor: recorded_s / seconds in the stages, None without either; reused: stages whose results were
    kept from an earlier replay; plugins: those used; anchors_from_messages: whether the config's anchors are those that
    the messages contain; run_format: see `run_folder.read_run_json`.
    """

    quadlog_version: str
    command: Sequence[str]
    config: Mapping[str, Any]
    options: Mapping[str, Any]
    input: InputRecord
    seed: int
    recorded_s: float
    topics: Sequence[TopicRecord] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    losses: Sequence[LossRecord] = ()
    warnings: Sequence[str] = ()
    notes: Sequence[str] = ()
    stages: Sequence[StageRecord] = ()
    startup_s: float = 0.0
    realtime_factor: float | None = None
    reused: Sequence[str] = ()
    plugins: Sequence[PluginRecord] = ()
    anchors_from_messages: bool = False
    host: Mapping[str, Any] = field(default_factory=describe_host)
    packages: Mapping[str, str] = field(default_factory=package_versions)
    run_format: int = RUN_FORMAT

    def __post_init__(self) -> None:
        # URLs may contain passwords or signatures.
        object.__setattr__(self, "command", [redacted_text(each) for each in self.command])

    def to_dict(self) -> dict[str, Any]:
        """The JSON object by names of fields, without those that are None."""
        told = {name: value for name, value in asdict(self).items() if value is not None}
        return told | {"input": {name: value for name, value in told["input"].items() if value is not None}}


def own_files(path: Path) -> list[Path]:
    """The files of a recording: itself, or the files of a bag folder with its metadata."""
    if not path.is_dir():
        return [path]
    metadata = path / "metadata.yaml"
    return sorted([*recording_files(path), *([metadata] if metadata.is_file() else [])])


def input_bytes(files: Iterable[Path]) -> int:
    """Size of a recording's files; files of unknown size count as 0 bytes."""
    told = [each.look().told if isinstance(each, RemotePath) else each.stat() for each in files]
    return sum(
        (each.size_bytes or 0) if isinstance(each, ObjectInfo) else each.st_size for each in told if each is not None
    )


def describe_input(path: Path) -> InputRecord:
    """Size and SHA-256 of a recording; of a bag folder, the hash over its files' names, sizes and contents in order.

    Behind a URL size and ETag, as they are now; of a folder a hash over its files' names, sizes and ETags.

    Raises RecordingNotFound when it is not there, cannot be read, or is a device that never ends; StorageFailed.
    """
    files = own_files(path)
    if isinstance(path, RemotePath):
        return _describe_remote(path, [cast(RemotePath, each) for each in files])
    if any(not each.is_file() for each in files):
        raise RecordingNotFound(path, "no regular file or folder" if path.exists() else "no such file or folder")
    digest, size = hashlib.sha256(), 0
    try:
        for each in files:
            length = each.stat().st_size
            if path.is_dir():
                digest.update(f"{each.relative_to(path).as_posix()}\0{length}\0".encode("utf-8", "surrogateescape"))
            with each.open("rb") as file:
                while chunk := file.read(1 << 20):
                    digest.update(chunk)
            size += length
    except OSError as error:
        raise RecordingNotFound(path, error.strerror or str(error)) from error
    return InputRecord(str(path), size, digest.hexdigest())


def _describe_remote(path: RemotePath, files: list[RemotePath]) -> InputRecord:
    try:
        told = [each.open_object().told for each in files]
    except FileNotFoundError:
        raise RecordingNotFound(str(path), "no such file on the server") from None
    size = sum(each.size_bytes or 0 for each in told)
    if len(told) == 1 and not path.is_dir():
        only = told[0]
        # Without a size two files of the same date cannot be distinguished.
        known = only.size_bytes is not None
        return InputRecord(str(path), size, None, only.etag if known else None, only.last_modified if known else None)
    versions = [each.etag or each.last_modified for each in told]
    if None in versions or any(each.size_bytes is None for each in told):
        return InputRecord(str(path), size)
    lines = (
        f"{file.name}\0{each.size_bytes}\0{version}\0"
        for file, each, version in zip(files, told, versions, strict=True)
    )
    return InputRecord(
        str(path), size, etag=f"of-{len(files)}-files-{hashlib.sha256(''.join(lines).encode()).hexdigest()}"
    )


def describe_file(path: Path, sha256: str) -> InputRecord:
    """A recording that is one file of this machine, whose hash is known."""
    return InputRecord(str(path), path.stat().st_size, sha256)


def describe_input_aside(path: Path) -> Future[InputRecord]:
    """`describe_input` in a thread: hashing releases the GIL."""
    described: Future[InputRecord] = Future()

    def describe() -> None:
        try:
            described.set_result(describe_input(path))
        except BaseException as error:  # raised by result()
            described.set_exception(error)

    Thread(target=describe, name="quadlog-hash", daemon=True).start()
    return described
