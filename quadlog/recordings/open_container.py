"""From a path to the reader of what it holds, told by its first bytes and not by its name."""

from __future__ import annotations

from pathlib import Path

from quadlog.errors import NotARecording, NothingReadable, RecordingNotFound
from quadlog.recordings import bag_records, mcap_records, sqlite_open, unpacking
from quadlog.recordings.bag_reader import open_bag
from quadlog.recordings.container import Container
from quadlog.recordings.mcap_reader import open_mcap
from quadlog.recordings.split import is_split, open_split
from quadlog.recordings.sqlite_reader import open_sqlite

# What else people hand over, and what they should do with it.
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
    one message left), or TooLarge (no room for a needed copy).
    """
    if path.is_dir():
        if not is_split(path):
            raise RecordingNotFound(path, "the folder is not one recording (a ROS 2 bag); name the files in it")
        return open_split(path, open_file)
    return open_file(path)


def open_file(path: Path) -> Container:
    """Opens one file; a zstd-compressed one (`.mcap.zstd`, `.db3.zstd`) through a temporary copy. Raises as above."""
    if not path.exists():
        raise RecordingNotFound(path)
    if not path.is_file():
        raise NotARecording(path, "not a regular file")
    head, tail = _ends(path)
    if not head.startswith(unpacking.MAGIC):
        return _open_unpacked(path, head, tail)
    folder = unpacking.unpack(path)
    inner_path = Path(folder.name) / unpacking.unpacked_name(path)
    try:
        inner = _open_unpacked(path, *_ends(inner_path), location=inner_path)
    except (NotARecording, NothingReadable) as error:
        folder.cleanup()
        raise type(error)(path, error.reason) from None
    except BaseException:
        folder.cleanup()
        raise
    return unpacking.UnpackedFile(path, inner, folder)


def _open_unpacked(path: Path, head: bytes, tail: bytes, location: Path | None = None) -> Container:
    source = location or path
    # One of the two marks is enough: the other one may be what was damaged.
    if head.startswith(mcap_records.MAGIC) or tail == mcap_records.MAGIC:
        return open_mcap(source)
    if head.startswith(bag_records.MAGIC):
        return open_bag(source)
    if head.startswith(sqlite_open.MAGIC):
        return open_sqlite(source)
    if not head:
        raise NotARecording(path, "the file is empty (0 bytes)")
    hint = next((words for magic, words in _HINTS if head.startswith(magic)), "its first bytes are none of a recording")
    raise NotARecording(path, hint)


def _ends(path: Path) -> tuple[bytes, bytes]:
    try:
        with path.open("rb") as file:
            head = file.read(32)
            file.seek(-min(8, path.stat().st_size), 2)
            return head, file.read(8)
    except PermissionError:
        raise NotARecording(path, "you are not allowed to read it") from None
