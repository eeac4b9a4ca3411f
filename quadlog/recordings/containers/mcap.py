"""An MCAP file: its footer and summary, which make it searchable, and the reader on top of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from isal.isal_zlib import crc32

from quadlog.errors import NothingReadable
from quadlog.recordings.containers import mcap_records as mcap
from quadlog.recordings.containers.bounded_reader import (
    MAX_INDEX_BYTES,
    MAX_TIME_NS,
    Cursor,
    Damaged,
    read_at,
    read_each_at,
)
from quadlog.recordings.containers.chunked_reader import ChunkedReader
from quadlog.recordings.containers.chunks import Body, Contents, Entries, Listed, Piece, PieceFormat, losses_of, span_of
from quadlog.recordings.containers.compression import SUPPORTED
from quadlog.recordings.containers.container import Channel, Identity, Loss, shared_channels
from quadlog.recordings.containers.mcap_records import ChunkIndex, McapChannel, Schema, Statistics
from quadlog.recordings.containers.mcap_recovery import McapScan, message_index_counts
from quadlog.recordings.formatting import ros2_type_name, several
from quadlog.storage.byte_ranges import ByteSource

_FOOTER_BYTES = mcap.FRAME.size + 20


@dataclass
class McapSummary:
    """What the summary section says. Whatever a writer left out is empty."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, McapChannel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    statistics: Statistics | None = None

    def is_complete(self) -> bool:
        """Whether every message can be found through it: all counts agree with the statistics."""
        own = self.statistics
        return (
            own is not None
            and (own.schemas, own.channels, own.chunks) == (len(self.schemas), len(self.channels), len(self.chunks))
            and own.messages == sum(own.channel_counts.values())
            and self.channels.keys() >= own.channel_counts.keys()
            and len({chunk.offset for chunk in self.chunks}) == len(self.chunks)
        )


def read_summary(file: ByteSource, size: int) -> tuple[McapSummary | None, list[Loss]]:
    """The summary, None where none was written, or an empty one and the loss that says why it cannot be read."""
    try:
        footer_offset = size - len(mcap.MAGIC) - _FOOTER_BYTES
        footer = read_at(file, footer_offset, _FOOTER_BYTES + len(mcap.MAGIC))
        if not footer.endswith(mcap.MAGIC):
            raise Damaged("the file does not end with MCAP's closing mark", "truncated")
        opcode, length = mcap.FRAME.unpack_from(footer)
        if (opcode, length) != (mcap.FOOTER, 20):
            raise Damaged("the footer is damaged", "summary")
        cursor = Cursor(footer[mcap.FRAME.size :])
        start, _, crc = cursor.u64(), cursor.u64(), cursor.u32()
        if start == 0:
            return None, []
        if start > footer_offset:
            raise Damaged("the footer points beyond the file", "summary")
        section = read_at(file, start, footer_offset - start, MAX_INDEX_BYTES)
        if crc and crc32(footer[: mcap.FRAME.size + 16], crc32(section)) != crc:
            raise Damaged("the summary's checksum (CRC) does not match", "summary")
        return _parse(section), []
    except Damaged as damage:
        cause = damage.cause if damage.cause in ("truncated", "summary") else "summary"
        return McapSummary(), [Loss(cause, f"{damage.reason}; everything was read from the first byte on instead")]


def _parse(section: bytes) -> McapSummary:
    summary = McapSummary()
    for opcode, content in mcap.records(section):
        if opcode == mcap.SCHEMA:
            schema = mcap.read_schema(content)
            summary.schemas[schema.number] = schema
        elif opcode == mcap.CHANNEL:
            channel = mcap.read_channel(content)
            summary.channels[channel.number] = channel
        elif opcode == mcap.CHUNK_INDEX:
            summary.chunks.append(mcap.read_chunk_index(content))
        elif opcode == mcap.STATISTICS:
            summary.statistics = mcap.read_statistics(content)
    return summary


_ROS_SCHEMAS = ("ros1msg", "ros2msg", "ros2idl")


def read_mcap(path: Path, file: ByteSource) -> ChunkedReader:
    """The MCAP file in these bytes, which are the reader's from here on; path is its name.

    Raises NothingReadable when it is damaged and has no readable message.
    """
    contents = _contents(file, file.size)
    _refuse_if_nothing_is_left(path, contents)
    return ChunkedReader(path, contents, McapFormat(file), file)


class McapFormat(PieceFormat):
    """How a piece of an MCAP file is read."""

    def load_chunk(self, piece: Piece, at_most: int | None) -> Body | None:
        record = memoryview(read_at(self.file, piece.offset, piece.length))
        if len(record) < mcap.FRAME.size:
            raise Damaged("the index gives it no room")
        opcode, length = mcap.FRAME.unpack_from(record)
        # Without an index the walk has found where it ends, whatever the record says.
        if opcode != mcap.CHUNK or (piece.index_end and length != len(record) - mcap.FRAME.size):
            raise Damaged("the index names a chunk where there is no chunk")
        content = record[mcap.FRAME.size :]
        if at_most is not None and mcap.chunk_size(content) > at_most:
            return None
        return mcap.read_chunk(content, self.file, piece.offset)

    def entries(self, body: Body) -> Entries:
        return mcap.message_entries(body)

    def listed(self, pieces: Sequence[Piece]) -> list[Listed]:
        ends = [piece.offset + piece.length for piece in pieces]
        spans = [(end, max(piece.index_end - end, 0)) for piece, end in zip(pieces, ends, strict=True)]
        indexes = read_each_at(self.file, spans)
        return [
            self.entries(self.load_loose(piece)).listed() if piece.loose else mcap.list_messages(memoryview(index))
            for piece, index in zip(pieces, indexes, strict=True)
        ]

    def counts(self, piece: Piece) -> Mapping[int, int] | None:
        if piece.counts is not None:
            return piece.counts
        return message_index_counts(self.file, piece.offset + piece.length, self.file.size)


def _contents(file: ByteSource, size: int) -> Contents:
    written, losses = read_summary(file, size)
    summary = written or McapSummary()
    indexed, statistics = summary.is_complete(), summary.statistics
    why = "the file was written without a summary" if written is None else "the summary is not complete"
    warnings = [] if indexed or losses else [f"{why}; the whole file was read to open it"]
    scan = McapScan(file, size, summary.chunks if indexed else [])
    losses += losses_of(scan.lost) + scan.losses
    if read_at(file, 0, len(mcap.MAGIC)) != mcap.MAGIC:
        losses.append(Loss("damaged", "the file's first 8 bytes are not MCAP's magic, the last 8 are"))
    losses += _check_loose_messages(file, scan)
    declared: Mapping[int, int] = scan.counts
    span_ns = span_of(scan.pieces)
    if statistics is not None and (indexed or statistics.channel_counts):
        declared = statistics.channel_counts
    if statistics is not None and indexed and statistics.messages:
        span_ns = min(statistics.start_ns, MAX_TIME_NS), min(statistics.end_ns, MAX_TIME_NS)
    channel_of = _channels(summary, scan, declared, warnings)
    return Contents(scan.pieces, channel_of, declared, span_ns, losses, warnings)


def _channels(
    summary: McapSummary, scan: McapScan, declared: Mapping[int, int], warnings: list[str]
) -> dict[int, Channel]:
    """Channel ids of the file to Channels; ids that differ in nothing share one."""
    schemas = {**summary.schemas, **scan.schemas}
    identities = []
    for number, channel in sorted({**summary.channels, **scan.channels}.items()):
        schema = schemas.get(channel.schema)
        if schema is None and channel.schema:
            warnings.append(f"{channel.topic}: its message definition (schema {channel.schema}) is not in the file")
        identities.append((number, _identity(channel, schema)))
    return shared_channels(identities, lambda number: declared.get(number, 0))


def _identity(channel: McapChannel, schema: Schema | None) -> Identity:
    if schema is None:
        return channel.topic, "", channel.message_encoding, "", b""
    type_name = ros2_type_name(schema.name) if schema.encoding in _ROS_SCHEMAS else schema.name
    return channel.topic, type_name, channel.message_encoding, schema.encoding, schema.data


def _check_loose_messages(file: ByteSource, scan: McapScan) -> list[Loss]:
    """Messages outside chunks have no checksum but the data section's, so that one is computed for them."""
    loose = [piece for piece in scan.pieces if piece.loose]
    if not loose or scan.ended_at is None or not scan.data_crc:
        return []
    crc, position = 0, 0
    while position < scan.ended_at:
        block = read_at(file, position, min(1 << 20, scan.ended_at - position))
        crc = crc32(block, crc)
        position += len(block)
    if crc == scan.data_crc:
        return []
    at_risk = sum(sum((piece.counts or {}).values()) for piece in loose)
    detail = f"the data section's checksum (CRC) does not match; any of {several(at_risk, 'message')} outside chunks"
    return [Loss("crc", f"{detail} may be wrong; which ones is unknown")]


def _refuse_if_nothing_is_left(path: Path, contents: Contents) -> None:
    held = [piece for piece in contents.pieces if not piece.is_empty]
    unknown = sorted({piece.compression for piece in held} - set(SUPPORTED))
    if held and unknown and all(piece.compression in unknown for piece in held):
        names = ", ".join(map(repr, unknown))
        raise NothingReadable(path, f"compressed with {names}, which quadlog does not read (zstd, lz4 or none)")
    serious = [loss for loss in contents.losses if loss.cause != "summary"]
    if not held and serious:
        raise NothingReadable(path, serious[-1].detail)
