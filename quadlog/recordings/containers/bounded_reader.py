"""Reads untrusted bytes: every length is checked before it is used."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from quadlog.storage.byte_ranges import ByteSource, Span

# Far above what recorders write (chunks of 1 to 16 MB), far below the memory of any machine.
MAX_CHUNK_BYTES = 1 << 29
MAX_INDEX_BYTES = 1 << 28
MAX_DEFINITION_BYTES = 1 << 26
MAX_NAME_BYTES = 1 << 12
MAX_TIME_NS = 2**63 - 1

_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")


class Damaged(Exception):
    """Bytes that do not mean what their format says. Readers turn it into a Loss; it never leaves this package.

    cause is the Loss's stable word, reason one phrase for people.
    """

    def __init__(self, reason: str, cause: str = "damaged") -> None:
        self.reason, self.cause = reason, cause
        super().__init__(reason)


def read_at(file: ByteSource, offset: int, length: int, limit: int = MAX_CHUNK_BYTES) -> bytes:
    """Exactly length bytes from offset on, or Damaged; nothing is allocated above the limit.

    Raises StorageFailed and StorageChanged where a server fails, which is no damage of the file.
    """
    if length > limit:
        raise Damaged(f"{length} bytes at offset {offset} exceed the limit of {limit}", "too-large")
    if offset < 0 or length < 0 or offset > MAX_TIME_NS:
        raise Damaged(f"an offset of {offset} and a length of {length} point nowhere")
    try:
        data = file.read(offset, length)
    except OSError as error:
        raise Damaged(f"the disk does not give what lies at offset {offset} ({error.strerror})") from None
    if len(data) != length:
        raise Damaged(f"the file ends {length - len(data)} bytes too early for what starts at offset {offset}")
    return data


def read_each_at(file: ByteSource, spans: Sequence[Span]) -> list[bytes]:
    """The same of small stretches that lie far apart, MAX_INDEX_BYTES together."""
    wanted = sum(length for _, length in spans)
    if any(offset < 0 or length < 0 for offset, length in spans) or wanted > MAX_INDEX_BYTES:
        raise Damaged(f"message indexes of {wanted} bytes are no message indexes")
    try:
        data = file.read_each(spans)
    except OSError as error:
        raise Damaged(f"the disk does not give a message index ({error.strerror})") from None
    if any(len(each) != length for each, (_, length) in zip(data, spans, strict=True)):
        raise Damaged("the file ends within a message index")
    return data


class Cursor:
    """Little-endian fields, one after the other, out of one buffer; raises Damaged where the buffer ends."""

    def __init__(self, data: bytes | memoryview) -> None:
        self.data = memoryview(data)
        self.position = 0

    def __bool__(self) -> bool:
        return self.position < len(self.data)

    def take(self, length: int) -> memoryview:
        end = self.position + length
        if end > len(self.data):
            raise Damaged(f"a field of {length} bytes does not fit into the {len(self.data)} bytes of its record")
        taken = self.data[self.position : end]
        self.position = end
        return taken

    def u16(self) -> int:
        return _U16.unpack(self.take(2))[0]

    def u32(self) -> int:
        return _U32.unpack(self.take(4))[0]

    def u64(self) -> int:
        return _U64.unpack(self.take(8))[0]

    def text(self) -> str:
        """A name with a 32-bit length before it."""
        return name_of(self.take(self.u32()))


def name_of(raw: bytes | memoryview) -> str:
    """A topic's, a type's or an encoding's name. Raises Damaged."""
    if len(raw) > MAX_NAME_BYTES:
        raise Damaged(f"a name of {len(raw)} bytes exceeds the limit of {MAX_NAME_BYTES}", "too-large")
    try:
        return bytes(raw).decode()
    except UnicodeDecodeError:
        raise Damaged("a name is not UTF-8") from None


class KeptDefinitions:
    """How many bytes the message definitions of a file take together; one that replaces another gives its room back."""

    def __init__(self) -> None:
        self._bytes_of: dict[object, int] = {}
        self._total = 0

    def keep(self, key: object, size: int) -> None:
        """Account for a definition under its id. Raises Damaged where there is no room for it."""
        total = self._total + size - self._bytes_of.get(key, 0)
        if total > MAX_DEFINITION_BYTES:
            raise Damaged(f"message definitions of more than {MAX_DEFINITION_BYTES} bytes", "too-large")
        self._total, self._bytes_of[key] = total, size
