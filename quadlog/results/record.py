"""`run.json` and `metrics.json`: how a run was made, from what input, what was lost, and what came out."""

from __future__ import annotations

import hashlib
import json
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread
from typing import Any, Self, cast
from uuid import uuid4

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, StrictFloat, StrictInt, TypeAdapter, ValidationError, field_validator
from pydantic.dataclasses import dataclass

from quadlog.config.file import without_retired
from quadlog.config.schema import Config
from quadlog.config.version import describe_host, package_versions
from quadlog.errors import NotARun, QuadlogError, RecordingNotFound, UnknownRunFormat, clipped, printable
from quadlog.plugins import SAVED, Plugin
from quadlog.recordings.containers.container import Loss
from quadlog.recordings.file_names import recording_files
from quadlog.storage.atomic_write import write_whole
from quadlog.storage.remote_path import RemotePath
from quadlog.storage.urls import redacted_text
from quadlog.version import __version__

RUN_FORMAT = 1
"""Increased when scripts that read run folders have to change, for a file, column or unit."""
_MAX_BYTES = 64 << 20
_DAMAGE = (ValueError, OSError, LookupError, EOFError, RuntimeError, OverflowError, zipfile.BadZipFile, zlib.error)


class Record(BaseModel):
    """A part of run.json, in which fields that a later version added are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class InputRecord(Record):
    """The recording: location_of it, size, and the SHA-256 of its content; of a URL the ETag, or else Last-Modified."""

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
        """Equal for equal inputs; an input without a fingerprint is never equal."""
        if self.fingerprint is None:
            return f"unknown {uuid4().hex}"
        name, value = self.fingerprint
        return value if name == "SHA-256" else f"{self.size_bytes} bytes, {name} {value}"


class TopicRecord(Record):
    """A topic that was used: its role, type, number of messages, and why it was chosen."""

    role: str
    topic: str
    type: str
    messages: int
    why: str


class StageRecord(Record):
    """A stage that ran: wall seconds, and the process's peak memory when it ended."""

    name: str
    seconds: float
    peak_memory_mb: float


class PluginRecord(Record):
    """A planner, decoder or controller of another distribution that was used."""

    group: str
    name: str
    distribution: str
    version: str

    @classmethod
    def of(cls, plugins: Iterable[Plugin | None]) -> list[Self]:
        """Those that there are."""
        return [cls(**{name: getattr(each, name) for name in cls.model_fields}) for each in plugins if each is not None]


class RunRecord(Record):
    """The content of run.json.

    options: what else the result depends on (stamp, start_s, until, …). recorded_s: length of what was replayed.
    notes: choices that affected the result. startup_s: imports and compilation, not part of the stages. reused: stages
    taken from earlier replays. anchors_from_messages: whether the anchors in config are those that the messages carry.
    results: keys in `.stages` of the stages' results and of the run. finished: False until this is the last file.
    """

    quadlog_version: str
    command: Sequence[str]
    config: Config
    options: Mapping[str, Any]
    input: InputRecord
    seed: int
    recorded_s: float
    topics: Sequence[TopicRecord] = ()
    counts: Mapping[str, int] = {}
    losses: Sequence[Loss] = ()
    warnings: Sequence[str] = ()
    notes: Sequence[str] = ()
    stages: Sequence[StageRecord] = ()
    startup_s: float = 0.0
    realtime_factor: float | None = None
    reused: Sequence[str] = ()
    plugins: Sequence[PluginRecord] = ()
    anchors_from_messages: bool = False
    results: Mapping[str, str] = {}
    finished: bool = True
    host: Mapping[str, Any] = Field(default_factory=describe_host)
    packages: Mapping[str, str] = Field(default_factory=package_versions)
    run_format: int = RUN_FORMAT

    @field_validator("config", mode="before")
    @classmethod
    def _without_retired_keys(cls, config: Any) -> Any:
        """Runs of the version before are read."""
        return without_retired(config)[0] if isinstance(config, Mapping) else config

    @field_validator("command")
    @classmethod
    def _without_secrets(cls, command: Sequence[str]) -> list[str]:
        """URLs may contain passwords or signatures."""
        return [redacted_text(word) for word in command]


_Number = StrictInt | StrictFloat


@dataclass(frozen=True, slots=True, config=ConfigDict(allow_inf_nan=False))
class SavedMetric:
    """A metric of metrics.json: value, samples, unit, 95 % interval, worst sample and instant, independent errors."""

    value: _Number
    n: StrictInt = Field(0, ge=0)
    unit: str = ""
    low: _Number | None = None
    high: _Number | None = None
    worst: _Number | None = None
    worst_t_ns: StrictInt | None = None
    independent: _Number | None = None

    @property
    def interval(self) -> tuple[float, float] | None:
        """The ends, if both are known."""
        return None if self.low is None or self.high is None else (self.low, self.high)


_METRICS = TypeAdapter(dict[str, SavedMetric])


def read_metrics(run: Path) -> dict[str, dict[str, Any]]:
    """`metrics.json` of a run: name: {value, n, unit, ...}. Raises NotARun where it is missing or damaged."""
    metrics = read_object(run, "metrics.json", "has no metrics.json")
    with reading(run / "metrics.json"):
        _METRICS.validate_python(metrics)
    return metrics


def read_record(run: Path, *, unfinished: bool = False) -> RunRecord:
    """The record of a finished run; with `unfinished` also that of one that was begun.

    Raises NotARun if run.json is missing or damaged, UnknownRunFormat if its format is not RUN_FORMAT.
    """
    content = read_object(run, "run.json", "is no finished run: it has no run.json")
    found, version = content.get("run_format", RUN_FORMAT), content.get("quadlog_version")
    if type(found) is not int or found != RUN_FORMAT:  # before its other fields, which may differ
        raise UnknownRunFormat(
            run,
            f"{printable(found)[:40]}, written by quadlog {printable(version)[:40]}; this quadlog, "
            f"{__version__}, reads format {RUN_FORMAT}: use that version, or replay the recording again",
        )
    with reading(run / "run.json"):
        record = RunRecord.model_validate(content, context=SAVED)
    if not (record.finished or unfinished):
        raise NotARun(run, "is an unfinished run (finished: false in run.json)")
    return record


def is_finished(run: Path) -> bool:
    """Whether the run in a folder is complete and can be read."""
    with suppress(NotARun, UnknownRunFormat):
        return bool(read_record(run))
    return False


def write_record(run: Path, record: RunRecord, *, finished: bool) -> None:
    """`run.json`. Raises CannotWrite."""
    content = record.model_dump(mode="json", exclude_none=True) | {"finished": finished}
    write_whole(run / "run.json", to_json(content))


def to_json(content: Any) -> bytes:
    """Indented JSON with sorted keys, without NaN, with a trailing newline; numpy's numbers as Python's."""
    return (json.dumps(content, indent=2, sort_keys=True, allow_nan=False, default=lambda x: x.item()) + "\n").encode()


@contextmanager
def reading(path: Path, *also: type[Exception]) -> Iterator[None]:
    """Make whatever is wrong with the content of a run's file a NotARun that names it. also: what a library raises."""
    try:
        yield
    except QuadlogError:
        raise
    except _DAMAGE + also as error:
        text = str(error)
        if isinstance(error, ValidationError):
            first = error.errors(include_url=False)[0]
            text = f"{clipped(printable('.'.join(map(str, first['loc']))), 60)}: {first['msg']}"
        text = next(iter(text.splitlines()), "") or type(error).__name__
        raise NotARun(path, f"is damaged: {clipped(printable(text))}") from error


def read_object(run: Path, name: str, missing: str) -> dict[str, Any]:
    """The object in a JSON file of a run; its numbers are finite, its integers fit in 64 bits. Raises NotARun."""
    path = run / name
    if not path.is_file():
        raise NotARun(run, missing if run.is_dir() else "is no folder" if run.exists() else "no such folder")
    with reading(path):
        if path.stat().st_size > _MAX_BYTES:
            raise ValueError(f"larger than {_MAX_BYTES} bytes")
        # Not pydantic's JSON: names of files may contain lone surrogates.
        content = json.loads(path.read_bytes(), parse_int=lambda digits: int(np.int64(int(digits))))
        if not isinstance(content, dict):
            raise ValueError("no JSON object")
        json.dumps(content, allow_nan=False)
    return content


def location_of(recording: Path | RemotePath) -> str:
    """The absolute path of a recording, or its URL."""
    return str(recording if isinstance(recording, RemotePath) else recording.absolute())


def own_files(path: Path) -> list[Path]:
    """The files of a recording: itself, or the files of a bag folder with its metadata."""
    if not path.is_dir():
        return [path]
    metadata = path / "metadata.yaml"
    return sorted([*recording_files(path), *([metadata] if metadata.is_file() else [])])


def input_bytes(files: Iterable[Path]) -> int:
    """Size of a recording's files; files of unknown size count as 0 bytes."""
    found = [each.look() if isinstance(each, RemotePath) else each.stat() for each in files]
    return sum(each.st_size for each in found if each is not None)


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
    return InputRecord(path=location_of(path), size_bytes=size, sha256=digest.hexdigest())


def _describe_remote(path: RemotePath, files: list[RemotePath]) -> InputRecord:
    try:
        found = [each.info() for each in files]
    except FileNotFoundError:
        raise RecordingNotFound(str(path), "no such file on the server") from None
    size, marks = sum(each.st_size for each in found), [each.etag or each.last_modified for each in found]
    if None in marks or any(each.size_bytes is None for each in found):  # files of one date may differ in size
        return InputRecord(path=str(path), size_bytes=size)
    if len(found) == 1 and not path.is_dir():
        return InputRecord(path=str(path), size_bytes=size, etag=found[0].etag, last_modified=found[0].last_modified)
    lines = [f"{file.name}\0{each.size_bytes}\0{mark}\0" for file, each, mark in zip(files, found, marks, strict=True)]
    digest = hashlib.sha256("".join(lines).encode()).hexdigest()
    return InputRecord(path=str(path), size_bytes=size, etag=f"of-{len(files)}-files-{digest}")


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
