"""Opens a recording with the reader of its format, which its first bytes determine, not its name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

from quadlog.errors import NotARecording, RecordingNotFound, TooLarge
from quadlog.recordings.containers import bag, compression, db3, mcap
from quadlog.recordings.containers.container import Container
from quadlog.recordings.containers.split import open_split
from quadlog.recordings.file_names import recording_suffix
from quadlog.storage.byte_source import ByteSource, LocalBytes
from quadlog.storage.remote_object import RemoteBytes
from quadlog.storage.remote_path import RemotePath, copy_object

_HEAD_BYTES = 32
MOST_CHANNELS = 4096  # a topic each, or nearly; each costs a row, a look for its role and perhaps a loss

# Other formats, and what to do with them.
_HINTS = (
    (b"\x1f\x8b", "a gzip file; decompress it first  (gunzip)"),
    (b"BZh", "a bzip2 file; decompress it first  (bunzip2)"),
    (b"\xfd7zXZ\0", "an xz file; decompress it first  (unxz)"),
    (b"\x04\x22\x4d\x18", "an lz4 file; decompress it first  (unlz4)"),
    (b"PK\x03\x04", "a zip archive; unpack it first  (unzip)"),
    (b"7z\xbc\xaf", "a 7z archive; unpack it first  (7z x)"),
    (b"version https://git-lfs", "a Git LFS pointer; fetch the file itself  (git lfs pull)"),
    (b"#ROSBAG V1", "a bag of format 1; convert it first  (rosbag fix)"),
    (b"\x89MCAP", "an MCAP file of a version other than 0"),
)


def open_container(path: Path) -> Container:
    """Opens one recording: a file, or a ROS 2 bag folder. The container is a context manager too.

    Causes of loss that readers report: `truncated`, `crc`, `damaged`,
    `compression`, `too-large`, `summary`, `index`, `count`, `serialization`,
    `missing-split`.

    Raises RecordingNotFound, NotARecording, NothingReadable (damaged, without
    one message left), or TooLarge (more than MOST_CHANNELS, or no room for a needed copy).
    """
    container = open_split(path, open_file) if path.is_dir() else open_file(path)
    if (channels := len(container.channels)) > MOST_CHANNELS:
        container.close()
        raise TooLarge(f"{path}: topics", channels, MOST_CHANNELS)
    return container


def open_file(path: Path) -> Container:
    """Opens one file; a zstd-compressed one (`.mcap.zstd`, `.db3.zstd`) through a temporary copy. Raises as above."""
    if isinstance(path, RemotePath):
        return _open_remote(path)
    if not path.is_file():
        raise NotARecording(path, "not a regular file") if path.exists() else RecordingNotFound(path)
    return _open_local(path, path)


def is_recording(path: Path, but_ours: bool = False) -> bool:
    """Whether a file is one by its name or first bytes, without opening it; but_ours: unless quadlog wrote it."""
    with path.open("rb") as file:
        head = file.read(2 * _HEAD_BYTES)  # of an MCAP file of quadlog's with its name
    known = compression.is_zstd(head) or head.startswith((mcap.MAGIC, bag.MAGIC, db3.MAGIC))
    return bool(head and (known or recording_suffix(path))) and not (but_ours and b"quadlog" in head)


def _open_local(path: Path, place: Path, warnings: Sequence[str] = ()) -> Container:
    """The file at this place; path is what it is known by."""
    try:
        file = LocalBytes(place)
    except PermissionError:
        raise NotARecording(path, "you are not allowed to read it") from None
    with ExitStack() as on_error:
        on_error.callback(file.close)
        head = file.read(0, _HEAD_BYTES)
        if compression.is_zstd(head):
            return _open_copy(path, compression.unpacked_name(place), partial(compression.unpack, place))
        if head.startswith(db3.MAGIC):
            return db3.SqliteReader(path, place, warnings)
        container = _open_chunked(path, file, head, warnings)
        on_error.pop_all()
        return container


def _open_remote(remote_path: RemotePath) -> Container:
    """What lies behind a URL: by range where server and format allow it, else copied first."""
    path = cast(Path, remote_path)
    # Of a name from elsewhere only the suffix is taken, and only one that recordings have.
    name, copy = f"copy{recording_suffix(path)}", partial(copy_object, remote_path)
    try:
        info = remote_path.info()
    except FileNotFoundError:
        raise RecordingNotFound(path, "no such file on the server") from None
    if info.size_bytes is None or not info.ranges:
        what = "does not report the file's size" if info.ranges else "does not serve byte ranges"
        warning = f"the server {what}; the whole file was copied before it was read"
        return _open_copy(path, name, copy, warning)
    with ExitStack() as on_error:
        file = RemoteBytes(remote_path.url, info)
        on_error.callback(file.close)
        head = file.read(0, _HEAD_BYTES)
        if compression.is_zstd(head) or head.startswith(db3.MAGIC):
            return _open_copy(path, name, copy)
        container = _open_chunked(path, file, head)
        on_error.pop_all()
        return container


def _open_copy(path: Path, name: str, copy: Callable[[Path], list[str] | None], *warnings: str) -> Container:
    """What `copy` writes into a file of this name, which goes with it; path is what it is known by."""
    with ExitStack() as resources:
        place = Path(resources.enter_context(TemporaryDirectory(prefix="quadlog-"))) / name
        container = _open_local(path, place, [*warnings, *(copy(place) or ())])
        resources.push(container.resources)
        container.resources = resources.pop_all()
        return container


def _open_chunked(path: Path, file: ByteSource, head: bytes, warnings: Sequence[str] = ()) -> Container:
    # One of the two marks is enough: the other one may be what was damaged.
    if head.startswith(mcap.MAGIC) or file.read(max(file.size - 8, 0), 8) == mcap.MAGIC:
        return mcap.McapReader(path, file, warnings)
    if head.startswith(bag.MAGIC):
        return bag.BagReader(path, file, warnings)
    if not head:
        raise NotARecording(path, "the file is empty (0 bytes)")
    hint = next((words for magic, words in _HINTS if head.startswith(magic)), "not a recording: unknown file format")
    raise NotARecording(path, hint)
