"""An MCAP file (mcap.dev/spec): its summary, its chunks, and a walk over what the summary does not describe."""

from __future__ import annotations

import re
import struct
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from isal.isal_zlib import crc32

from quadlog.recordings.containers.chunk_file import ROW, Chunk, Rows, listed_rows, name_of, read_at, read_each_at
from quadlog.recordings.containers.chunked import ChunkedReader
from quadlog.recordings.containers.compression import decompress
from quadlog.recordings.containers.container import MAX_INDEX_BYTES, MAX_TIME_NS, Damaged, Identity, Loss
from quadlog.recordings.formatting import ros2_type_name, several

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT, STATISTICS, METADATA, DATA_END = 0x07, 0x08, 0x09, 0x0B, 0x0C, 0x0F
FRAME = struct.Struct("<BQ")
# Frame, channel, sequence, log time (signed: what does not fit into 63 bits is negative) and publish time.
_MESSAGE_HEAD = struct.Struct("<BQHIqQ")
_INDEX_ENTRY = np.dtype([("t_ns", "<i8"), ("offset", "<i8")])
_HEAD_BYTES = 128
_BEHIND_CHUNKS = (CHUNK, MESSAGE_INDEX, ATTACHMENT, METADATA, DATA_END)
_FOOTER_BYTES = FRAME.size + 20
_DATA_END_BYTES = 4
_ROS_SCHEMAS = ("ros1msg", "ros2msg", "ros2idl")
_CUT_OFF = "the file is cut off here, or holds no records from here on"


class _Fields:
    """Little-endian fields, one after the other, out of one record; raises Damaged where the record ends."""

    def __init__(self, data: bytes | memoryview) -> None:
        self.data = memoryview(data)
        self.position = 0

    def take(self, length: int) -> memoryview:
        begin, self.position = self.position, self.position + length
        if self.position > len(self.data):
            raise Damaged(f"a field of {length} bytes does not fit into the {len(self.data)} bytes of its record")
        return self.data[begin : self.position]

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def numbers(self, layout: str) -> Sequence[int]:
        return struct.unpack(layout, self.take(struct.calcsize(layout)))

    def time_ns(self) -> int:
        return min(self.number(8), MAX_TIME_NS)

    def text(self) -> str:
        return name_of(self.take(self.number(4)))

    def counts(self) -> Counter[int]:
        """A map from channel ids."""
        pairs = self.take(self.number(4))
        if len(pairs) % 10:
            raise Damaged("a map is cut short")
        return Counter(dict(struct.iter_unpack("<HQ", pairs)))


def _records(data: bytes) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of each record in a buffer of whole records. Raises Damaged."""
    fields = _Fields(data)
    while fields.position < len(data):
        opcode, length = FRAME.unpack(fields.take(FRAME.size))
        yield opcode, fields.take(length)


class McapReader(ChunkedReader):
    """Raises NothingReadable when the file is damaged and has no readable message."""

    _mark = re.compile(rb"\x06(?=.{7}\0.{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd))", re.DOTALL)

    def _open(self) -> None:
        # Name, encoding and definition.
        self._schemas: dict[int, tuple[str, str, bytes]] = {}
        # Schema, topic and message encoding.
        self._ids: dict[int, tuple[int, str, str]] = {}
        self._walked: Chunk | None = None
        self._data_end: tuple[int, int] | None = None
        self._lost_records: dict[tuple[str, str], tuple[int, str]] = {}
        position = len(MAGIC)
        for chunk in self._read_summary():
            self._walk(position, chunk.offset)
            self._chunks.append(chunk)
            position = chunk.index_end
        self._walk(position)
        self._report_lost_records()
        if read_at(self._file, 0, len(MAGIC)) != MAGIC:
            detail = "the file's first 8 bytes are not MCAP's magic, the last 8 are"
            self._walk_losses.append(Loss("damaged", detail))
        self._check_loose_messages()

    def _read_summary(self) -> Sequence[Chunk]:
        """Take in what the writer counted. Chunks in order, none where not every message can be found through them."""
        indexed: list[Chunk] = []
        counted: Sequence[int] = [0] * 8
        why = "the summary is not complete"
        try:
            section = self._summary_section()
            why = why if section else "the file was written without a summary"
            for opcode, content in _records(section):
                if opcode in (SCHEMA, CHANNEL):
                    self._define(opcode, content)
                elif opcode == CHUNK_INDEX:
                    indexed.append(_indexed_chunk(content))
                elif opcode == STATISTICS:
                    fields = _Fields(content)
                    counted, self._declared = fields.numbers("<QHIIIIQQ"), fields.counts()
        except Damaged as damage:
            self._schemas, self._ids, self._declared = {}, {}, None
            detail = f"{damage.reason}; everything was read from the first byte on instead"
            truncated = damage.cause == "truncated"
            self._losses.append(Loss("truncated", detail) if truncated else Loss("summary", detail))
            return ()
        indexed.sort(key=lambda chunk: chunk.offset)
        ends = [len(MAGIC), *(chunk.index_end for chunk in indexed)]
        begins = [*(chunk.offset for chunk in indexed), self._file.size]
        messages, schemas, channels, _, _, chunks, *span_ns = counted
        declared = Counter(self._declared or {})
        if (
            self._declared is None
            or (schemas, channels, chunks) != (len(self._schemas), len(self._ids), len(indexed))
            or messages != declared.total()
            or not self._ids.keys() >= declared.keys()
            or any(end > begin for end, begin in zip(ends, begins, strict=True))
        ):
            self._warnings.append(f"{why}; the whole file was read to open it")
            self._declared = self._declared or None
            return ()
        if messages:
            self.span_ns = min(span_ns[0], MAX_TIME_NS), min(span_ns[1], MAX_TIME_NS)
        return indexed

    def _summary_section(self) -> bytes:
        """Empty where none was written. Raises Damaged."""
        footer_at = self._file.size - len(MAGIC) - _FOOTER_BYTES
        footer = read_at(self._file, footer_at, _FOOTER_BYTES + len(MAGIC))
        if not footer.endswith(MAGIC):
            raise Damaged("the file does not end with MCAP's closing mark", "truncated")
        opcode, length, start, _, crc = struct.unpack_from("<BQQQI", footer)
        if (opcode, length) != (FOOTER, 20):
            raise Damaged("the footer is damaged")
        if start == 0:
            return b""
        if start > footer_at:
            raise Damaged("the footer points beyond the file")
        section = read_at(self._file, start, footer_at - start, MAX_INDEX_BYTES)
        if crc and crc32(footer[: FRAME.size + 16], crc32(section)) != crc:
            raise Damaged("the summary's checksum (CRC) does not match")
        return section

    def _identities(self) -> Iterable[tuple[int, Identity]]:
        for number, (schema_id, topic, encoding) in sorted(self._ids.items()):
            schema = self._schemas.get(schema_id)
            if schema is None and schema_id:
                self._warnings.append(f"{topic}: its message definition (schema {schema_id}) is not in the file")
            name, schema_encoding, definition = schema or ("", "", b"")
            name = ros2_type_name(name) if schema_encoding in _ROS_SCHEMAS else name
            yield number, (topic, name, encoding, schema_encoding, definition)

    def _step(self, position: int) -> int | None:
        opcode, length = FRAME.unpack(read_at(self._file, position, FRAME.size))
        begin = position + FRAME.size
        end = begin + length
        if opcode == CHUNK:
            end = self._trusted = self._chunk_end(position, begin, end)
            fields = _Fields(self._head(begin))
            # Before the body is tried: a loss says from when to when.
            self._walked = Chunk(position, end - position, fields.time_ns(), fields.time_ns(), index_end=end)
            self._take_walked(self._walked)
        elif opcode == 0 or end > self._file.size:
            raise Damaged(_CUT_OFF)
        elif opcode == MESSAGE:
            self._take_message(position, end)
        elif opcode in (SCHEMA, CHANNEL):
            try:
                self._define(opcode, memoryview(read_at(self._file, begin, length)))
            except Damaged as damage:
                self._lose_record(damage.cause, "message definition", damage.reason, position)
        elif opcode == MESSAGE_INDEX and self._walked is not None and self._walked.index_end == position:
            self._walked.index_end = end
        elif opcode == DATA_END and length == _DATA_END_BYTES:
            self._data_end = position, _Fields(read_at(self._file, begin, length)).number(4)
            return None
        elif opcode == FOOTER:
            raise Damaged("the data section has no end mark")
        elif opcode == DATA_END or self._begin_of(position) is not None:
            raise Damaged("the kind of a record is damaged")
        return end

    def _chunk_end(self, position: int, begin: int, end: int) -> int:
        """Where a chunk's record ends: by its length, or where its data's length disagrees, by that which leads to the
        next record. Raises Damaged.
        """
        try:
            by_data = begin + _chunk_length(self._head(begin))
        except Damaged:
            by_data = end
        found = [each for each in dict.fromkeys((end, by_data)) if end == by_data or self._leads_on(each)]
        if not found or found[0] > self._file.size:
            raise Damaged(_CUT_OFF if end == by_data else "a chunk's length is damaged")
        if found[0] != end:
            self._lose_record("damaged", "length of a chunk", "its end follows from its data", position)
        return found[0]

    def _head(self, begin: int) -> bytes:
        return read_at(self._file, begin, min(_HEAD_BYTES, max(self._file.size - begin, 0)))

    def _leads_on(self, end: int) -> bool:
        """Whether what may follow a chunk begins there."""
        if end + FRAME.size > self._file.size:
            return end == self._file.size
        opcode, length = FRAME.unpack_from(self._head(end))
        return opcode in _BEHIND_CHUNKS and end + FRAME.size + length <= self._file.size

    def _begin_of(self, mark: int) -> int | None:
        head = self._head(mark)
        if len(head) < FRAME.size:
            return None
        _, length = FRAME.unpack_from(head)
        try:
            whole = length == _chunk_length(head[FRAME.size :])
        except Damaged:
            return None
        return mark if whole and mark + FRAME.size + length <= self._file.size else None

    def _take_message(self, position: int, end: int) -> None:
        _, _, number, _, t_ns, _ = _MESSAGE_HEAD.unpack(read_at(self._file, position, _MESSAGE_HEAD.size))
        if t_ns < 0:
            self._lose_record("damaged", "message", "its log time is beyond 63 bits", position)
        else:
            self._take_loose(position, end, t_ns, number)

    def _define(self, kind: int, content: memoryview) -> None:
        fields = _Fields(content)
        number = fields.number(2)
        if kind == SCHEMA:
            schema = fields.text(), fields.text(), bytes(fields.take(fields.number(4)))
            self._account(number, len(content))
            self._schemas[number] = schema
        else:
            self._ids[number] = fields.number(2), fields.text(), fields.text()

    def _lose_record(self, cause: str, kind: str, why: str, position: int) -> None:
        count, first = self._lost_records.get((cause, kind), (0, f"at offset {position}: {why}"))
        self._lost_records[cause, kind] = count + 1, first

    def _report_lost_records(self) -> None:
        for (cause, kind), (count, first) in self._lost_records.items():
            detail = f"{several(count, kind)} lost; {'first' if count > 1 else 'it lies'} {first}"
            self._walk_losses.append(Loss(cause, detail, count=count if kind == "message" else None))

    def _check_loose_messages(self) -> None:
        """Messages outside chunks have no checksum but the data section's, so that one is computed for them."""
        at_risk = sum(chunk.counts.total() for chunk in self._chunks if chunk.loose and chunk.counts)
        end, expected = self._data_end or (0, 0)
        if not at_risk or not expected:
            return
        crc = 0
        for at in range(0, end, 1 << 20):
            crc = crc32(read_at(self._file, at, min(1 << 20, end - at)), crc)
        if crc != expected:
            any_of = f"any of {several(at_risk, 'message')} outside chunks may be wrong; which ones is unknown"
            detail = f"the data section's checksum (CRC) does not match; {any_of}"
            self._walk_losses.append(Loss("crc", detail))

    def _load(self, chunk: Chunk, at_most: int | None) -> tuple[memoryview, int] | None:
        record = memoryview(read_at(self._file, chunk.offset, chunk.length))
        if len(record) < FRAME.size or record[0] != CHUNK:
            raise Damaged("the index names a chunk where there is no chunk")
        fields = _Fields(record[FRAME.size :])
        fields.take(16)  # start and end
        size, crc, scheme = fields.number(8), fields.number(4), fields.text()
        if at_most is not None and size > at_most:
            return None
        length = fields.number(8)
        stored = fields.data[fields.position :]
        try:
            data = self._checked(scheme, stored[:length], size, crc, chunk)
        except Damaged:
            if length == len(stored):
                raise
            # Of the two lengths one is damaged.
            data = self._checked(scheme, stored, size, crc, chunk)
        return data, len(fields.data)

    def _checked(self, scheme: str, stored: memoryview, size: int, crc: int, chunk: Chunk) -> memoryview:
        data = decompress(scheme, stored, size, self._spare_bytes, chunk.offset)
        if crc and crc32(data) != crc:
            raise Damaged("its checksum (CRC) does not match", "crc")
        return data

    def _parse(self, data: memoryview, most: int) -> tuple[Rows, int, Sequence[tuple[int, memoryview]]]:
        values, definitions, position, size = array("q"), list[tuple[int, memoryview]](), 0, len(data)
        unpack, extend, records = _MESSAGE_HEAD.unpack_from, values.extend, 0
        while position < size and records <= most:
            records += 1
            begin = position + FRAME.size
            try:
                opcode, length, number, _, t_ns, _ = unpack(data, position)
            except struct.error:  # too near the end for a message
                if begin > size:
                    raise Damaged("a record is cut short") from None
                opcode, length = FRAME.unpack_from(data, position)
                t_ns = 0
            payload, position = position + _MESSAGE_HEAD.size, begin + length
            if position > size:
                raise Damaged("a record reaches beyond its chunk")
            if opcode == MESSAGE:
                if payload > position:
                    raise Damaged("a message is cut short")
                if t_ns < 0:
                    raise Damaged(f"a log time of {t_ns % 2**64} ns does not fit into 63 bits")
                extend((t_ns, number, payload, position))
            elif opcode in (SCHEMA, CHANNEL):
                definitions.append((opcode, data[begin:position]))
            elif opcode <= DATA_END:
                raise Damaged(f"it holds a record of kind {opcode}, which may have been a message")
        return np.frombuffer(values, ROW), records, definitions

    def _listed(self, chunks: Sequence[Chunk]) -> list[Rows]:
        spans = [(chunk.end, max(chunk.index_end - chunk.end, 0)) for chunk in chunks]
        indexes = read_each_at(self._file, spans)
        loose = ((chunk.loose and self._body(chunk)) or None for chunk in chunks)
        return [body.rows if body else _indexed_rows(index) for body, index in zip(loose, indexes, strict=True)]


def _indexed_chunk(content: memoryview) -> Chunk:
    fields = _Fields(content)
    start_ns, end_ns, offset, length = fields.time_ns(), fields.time_ns(), fields.number(8), fields.number(8)
    channels, index_bytes, compression = frozenset(fields.counts()), fields.number(8), fields.text()
    end = offset + max(length, 1) + index_bytes
    return Chunk(offset, length, start_ns, end_ns, channels or None, None, compression, end)


def _chunk_length(head: bytes) -> int:
    """How long the content of a chunk is by the length of its data; head: its first bytes. Raises Damaged."""
    fields = _Fields(head)
    fields.take(28)  # start, end, size and checksum
    fields.text()
    length = fields.number(8)
    return fields.position + length


def _indexed_rows(index: bytes) -> Rows:
    """The messages of a chunk by the message index records behind it. Raises Damaged."""
    runs = list[tuple[int, memoryview]]()
    for opcode, content in _records(index):
        fields = _Fields(content)
        number, size = fields.number(2), fields.number(4)
        if opcode != MESSAGE_INDEX or size % 16:
            raise Damaged("the index names a message index where there is none")
        runs.append((number, fields.take(size)))
    rows, entries = listed_rows(runs, _INDEX_ENTRY)
    rows["t_ns"], rows["begin"] = entries["t_ns"], entries["offset"]
    if min(rows["t_ns"].min(initial=0), rows["begin"].min(initial=0)) < 0:
        raise Damaged("a log time or an offset in a message index does not fit into 63 bits")
    return rows
