"""The end of an MCAP file: its footer, and the summary that makes it searchable."""

from __future__ import annotations

from dataclasses import dataclass, field

from isal.isal_zlib import crc32

from quadlog.recordings import mcap_records as mcap
from quadlog.recordings.bounded import MAX_INDEX_BYTES, Cursor, Damaged, read_at
from quadlog.recordings.container import Loss
from quadlog.recordings.mcap_records import ChunkIndex, McapChannel, Schema, Statistics
from quadlog.storage.byte_source import ByteSource

_FOOTER_BYTES = mcap.FRAME.size + 20


@dataclass
class Summary:
    """What the summary section says. Whatever a writer left out is empty."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, McapChannel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    statistics: Statistics | None = None

    def is_complete(self) -> bool:
        """Whether every message can be found through it: all counts agree with the statistics."""
        told = self.statistics
        return (
            told is not None
            and (told.schemas, told.channels, told.chunks) == (len(self.schemas), len(self.channels), len(self.chunks))
            and told.messages == sum(told.channel_counts.values())
            and self.channels.keys() >= told.channel_counts.keys()
            and len({chunk.offset for chunk in self.chunks}) == len(self.chunks)
        )


def read_summary(file: ByteSource, size: int) -> tuple[Summary | None, list[Loss]]:
    """The summary, or None and the loss that says why it is not there."""
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
            raise Damaged("the file was written without a summary", "summary")
        if start > footer_offset:
            raise Damaged("the footer points beyond the file", "summary")
        section = read_at(file, start, footer_offset - start, MAX_INDEX_BYTES)
        if crc and crc32(footer[: mcap.FRAME.size + 16], crc32(section)) != crc:
            raise Damaged("the summary's checksum (CRC) does not match", "summary")
        return _parse(section), []
    except Damaged as damage:
        cause = damage.cause if damage.cause in ("truncated", "summary") else "summary"
        return None, [Loss(cause, f"{damage.reason}; everything was read from the first byte on instead")]


def _parse(section: bytes) -> Summary:
    summary = Summary()
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
