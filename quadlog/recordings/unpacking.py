"""Recordings and messages that rosbag2 compressed with zstd (compression modes FILE and MESSAGE)."""

from __future__ import annotations

import io
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from types import TracebackType

import zstandard

from quadlog.errors import CannotWrite, NotARecording, TooLarge
from quadlog.recordings.compression import Incomplete, inflate_zstd, largest_size, zstd_blocks
from quadlog.recordings.container import Budget, Channel, Container, LogTimes, Loss, RawMessage
from quadlog.recordings.words import several

_MAX_UNPACKED_BYTES = 1 << 37
_ELSEWHERE = "TMPDIR names another folder"


def unpack(path: Path) -> tuple[tempfile.TemporaryDirectory[str], list[str]]:
    """A temporary folder with the decompressed file, and a warning where the compressed data is damaged or cut off.

    What lies before the damage is there: readers recover recordings without their end, and report it as a loss.
    Raises NotARecording when there is nothing, TooLarge, or CannotWrite on a full disk.
    """
    folder = tempfile.TemporaryDirectory(prefix="quadlog-")
    warnings = []
    written = 0
    try:
        # Half of what is free: the rest of the machine lives there too.
        room = min(_MAX_UNPACKED_BYTES, shutil.disk_usage(folder.name).free // 2)
        with path.open("rb") as packed, (Path(folder.name) / unpacked_name(path)).open("wb", buffering=0) as target:
            for block in zstd_blocks(packed):
                written += len(block)
                if written > room:
                    limit = f"at most half of what is free there; {_ELSEWHERE}"
                    raise TooLarge(f"{path}: bytes decompressed to {tempfile.gettempdir()} ({limit})", written, room)
                _write(target, block, path)
    except (zstandard.ZstdError, Incomplete) as error:
        if written == 0:
            folder.cleanup()
            raise NotARecording(path, f"it cannot be decompressed ({error})") from None
        warnings = [f"its compressed data is damaged ({error}); the {several(written, 'byte')} before that were read"]
    except BaseException:
        folder.cleanup()
        raise
    return folder, warnings


def _write(target: io.FileIO, block: bytes, packed: Path) -> None:
    """All of a block. Raises CannotWrite: the system's own error names no file."""
    rest = memoryview(block)
    try:
        while rest:
            rest = rest[target.write(rest) :]
    except OSError as error:
        where = f"decompressing it to {tempfile.gettempdir()}: {error.strerror or error} ({_ELSEWHERE})"
        raise CannotWrite(packed, where) from error


def unpacked_name(path: Path) -> str:
    """The name without `.zstd` or `.zst`."""
    return path.stem if path.suffix.lower() in (".zstd", ".zst") else path.name


class UnpackedFile:
    """A container in a temporary folder, known by the path of the file it was copied or decompressed from."""

    def __init__(
        self, path: Path, inner: Container, folder: tempfile.TemporaryDirectory[str], warnings: Sequence[str] = ()
    ) -> None:
        self.path, self._inner, self._folder = path, inner, folder
        inner.path = path
        # The same list: it grows while the inner container is read.
        self.losses = inner.losses
        self._warnings = list(warnings)
        self.messages = inner.messages

    @property
    def warnings(self) -> list[str]:
        return [*self._warnings, *self._inner.warnings]

    @property
    def channels(self) -> tuple[Channel, ...]:
        return self._inner.channels

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return self._inner.span_ns

    def log_times(self) -> Iterator[LogTimes]:
        return self._inner.log_times()

    def excerpt(self, budget: Budget) -> Container | None:
        return self._inner.excerpt(budget)

    def release(self) -> None:
        self._inner.release()

    def close(self) -> None:
        self._inner.close()
        self._folder.cleanup()

    def __enter__(self) -> UnpackedFile:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def unpack_messages(messages: Iterable[RawMessage], losses: list[Loss]) -> Iterator[RawMessage]:
    """Messages whose payload is zstd data, decompressed; one that is not is counted as a loss."""
    unreadable: Counter[str] = Counter()
    for message in messages:
        try:
            payload = memoryview(inflate_zstd(message.payload, largest_size(len(message.payload))))
        except (zstandard.ZstdError, Incomplete, ValueError):
            unreadable[message.channel.topic] += 1
            continue
        yield RawMessage(message.channel, message.log_time_ns, payload)
    for topic, count in sorted(unreadable.items()):
        loss = Loss("compression", f"{several(count, 'message')} cannot be decompressed", topic, count)
        if loss not in losses:
            losses.append(loss)
