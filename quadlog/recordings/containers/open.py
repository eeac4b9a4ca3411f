"""Opens a recording with the reader of its format, which its first bytes determine, not its name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, cast

from quadlog.errors import NotARecording, NothingReadable, RecordingNotFound, TooLarge
from quadlog.recordings.containers import bag as bag_records
from quadlog.recordings.containers import compression as unpacking
from quadlog.recordings.containers import db3 as sqlite_open
from quadlog.recordings.containers import mcap_records
from quadlog.recordings.containers.bag import read_bag
from quadlog.recordings.containers.compression import is_zstd
from quadlog.recordings.containers.container import Container
from quadlog.recordings.containers.db3 import open_sqlite
from quadlog.recordings.containers.mcap import read_mcap
from quadlog.recordings.containers.split import open_split
from quadlog.recordings.file_names import recording_suffix
from quadlog.storage.byte_ranges import ByteSource, LocalBytes
from quadlog.storage.remote_path import RemotePath

if TYPE_CHECKING:
    from quadlog.storage.remote_object import RemoteObject

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
    try:
        file = LocalBytes(path)
    except PermissionError:
        raise NotARecording(path, "you are not allowed to read it") from None
    with _closed_on_error(file):
        head = file.read(0, _HEAD_BYTES)
        if is_zstd(head):
            file.close()
            folder, warnings = unpacking.unpack(path)
            return _open_within(path, folder, unpacking.unpacked_name(path), warnings)
        if head.startswith(sqlite_open.MAGIC):
            file.close()
            return open_sqlite(path)
        return _open_chunked(path, file, head)


def is_recording(path: Path, but_ours: bool = False) -> bool:
    """Whether a file is one by its name or first bytes, without opening it; but_ours: unless quadlog wrote it."""
    with path.open("rb") as file:
        head = file.read(2 * _HEAD_BYTES)  # of an MCAP file of quadlog's with its name
    known = is_zstd(head) or head.startswith((mcap_records.MAGIC, bag_records.MAGIC, sqlite_open.MAGIC))
    return bool(head and (known or recording_suffix(path))) and not (but_ours and b"quadlog" in head)


def _open_remote(remote_path: RemotePath) -> Container:
    """What lies behind a URL: by range where server and format allow it, else copied first."""
    from quadlog.storage.byte_ranges import RemoteBytes

    path = cast(Path, remote_path)
    try:
        remote = remote_path.open_object()
    except FileNotFoundError:
        raise RecordingNotFound(path, "no such file on the server") from None
    if remote.info.size_bytes is None or not remote.info.ranges:
        what = "does not report the file's size" if remote.info.ranges else "does not serve byte ranges"
        return _open_copy(path, remote, [f"the server {what}; the whole file was copied before it was read"])
    file = RemoteBytes(remote, remote.info.size_bytes)
    with _closed_on_error(file):
        head = file.read(0, _HEAD_BYTES)
        if is_zstd(head) or head.startswith(sqlite_open.MAGIC):
            file.close()
            return _open_copy(path, remote)
        return _open_chunked(path, file, head)


def _open_copy(path: Path, remote: RemoteObject, warnings: Sequence[str] = ()) -> Container:
    from quadlog.storage.remote_path import copied

    # Of a name from elsewhere only the suffix is taken, and only one that recordings have.
    name = f"copy{recording_suffix(path)}"
    return _open_within(path, copied(remote, name), name, warnings)


def _open_within(path: Path, folder: TemporaryDirectory[str], name: str, warnings: Sequence[str] = ()) -> Container:
    """The file of this name in a temporary folder, which is given back with it; path is what it is known by."""
    try:
        return unpacking.UnpackedFile(path, open_file(Path(folder.name) / name), folder, warnings)
    except (NotARecording, NothingReadable) as error:
        folder.cleanup()
        raise type(error)(path, error.reason) from None
    except BaseException:
        folder.cleanup()
        raise


def _open_chunked(path: Path, file: ByteSource, head: bytes) -> Container:
    # One of the two marks is enough: the other one may be what was damaged.
    if head.startswith(mcap_records.MAGIC) or file.read(max(file.size - 8, 0), 8) == mcap_records.MAGIC:
        return read_mcap(path, file)
    if head.startswith(bag_records.MAGIC):
        return read_bag(path, file)
    if not head:
        raise NotARecording(path, "the file is empty (0 bytes)")
    hint = next((words for magic, words in _HINTS if head.startswith(magic)), "not a recording: unknown file format")
    raise NotARecording(path, hint)


@contextmanager
def _closed_on_error(file: ByteSource) -> Iterator[None]:
    try:
        yield
    except BaseException:
        file.close()
        raise
