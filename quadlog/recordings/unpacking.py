"""Recordings and messages that rosbag2 compressed with zstd (compression modes FILE and MESSAGE)."""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from types import TracebackType

import zstandard

from quadlog.errors import NotARecording, TooLarge
from quadlog.recordings.bounded import MAX_CHUNK_BYTES
from quadlog.recordings.container import Budget, Channel, Container, LogTimes, Loss, RawMessage
from quadlog.recordings.words import several

MAGIC = b"\x28\xb5\x2f\xfd"
_BLOCK_BYTES = 1 << 20
_MAX_UNPACKED_BYTES = 1 << 37
# Allocated for a message that does not say its own size, which rosbag2's always do.
_UNDECLARED_BYTES = 1 << 26


def unpack(path: Path) -> tempfile.TemporaryDirectory:
    """A temporary folder with the decompressed file. Raises NotARecording, or TooLarge when the disk has no room."""
    folder = tempfile.TemporaryDirectory(prefix="quadlog-")
    try:
        # Half of what is free: the rest of the machine lives there too.
        room = min(_MAX_UNPACKED_BYTES, shutil.disk_usage(folder.name).free // 2)
        with path.open("rb") as packed, (Path(folder.name) / unpacked_name(path)).open("wb") as target:
            written = 0
            for block in zstandard.ZstdDecompressor().read_to_iter(packed, write_size=_BLOCK_BYTES):
                written += len(block)
                if written > room:
                    raise TooLarge(f"{path}: decompressing it to {tempfile.gettempdir()}", written, room)
                target.write(block)
    except zstandard.ZstdError as error:
        folder.cleanup()
        raise NotARecording(path, f"it cannot be decompressed ({error})") from None
    except BaseException:
        folder.cleanup()
        raise
    return folder


def unpacked_name(path: Path) -> str:
    """The name without `.zstd` or `.zst`."""
    return path.stem if path.suffix.lower() in (".zstd", ".zst") else path.name


class UnpackedFile:
    """A container in a temporary folder, known by the path of the file it was copied or decompressed from."""

    def __init__(
        self, path: Path, inner: Container, folder: tempfile.TemporaryDirectory, warnings: Sequence[str] = ()
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

    def is_divisible(self) -> bool:
        return False

    def close(self) -> None:
        self._inner.close()
        self._folder.cleanup()

    def __enter__(self) -> UnpackedFile:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def unpack_messages(messages: Iterable[RawMessage], losses: list[Loss]) -> Iterator[RawMessage]:
    """Messages whose payload is a zstd frame, decompressed; one that is not is counted as a loss."""
    unreadable: Counter[str] = Counter()
    for message in messages:
        try:
            declared = zstandard.get_frame_parameters(message.payload).content_size
            if declared != zstandard.CONTENTSIZE_UNKNOWN and declared > MAX_CHUNK_BYTES:
                raise zstandard.ZstdError(f"{declared} bytes are too many")
            payload = zstandard.ZstdDecompressor().decompress(message.payload, max_output_size=_UNDECLARED_BYTES)
        except zstandard.ZstdError:
            unreadable[message.channel.topic] += 1
            continue
        yield RawMessage(message.channel, message.log_time_ns, payload)
    for topic, count in sorted(unreadable.items()):
        loss = Loss("compression", f"{several(count, 'message')} cannot be decompressed", topic, count)
        if loss not in losses:
            losses.append(loss)
