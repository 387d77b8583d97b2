"""MCAP's records, appended to a file that is readable up to about a second ago whenever the program dies.

The layout is that of https://mcap.dev/spec: schemas, channels and messages in compressed chunks, each followed by its
message indexes; at the end a summary. Messages are packed here, all else by mcap's own records: mcap.writer.Writer
takes several times as long for a message, and its flush() would let the clock decide where chunks end.
"""

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import IO, Final

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

_MAGIC = b"\x89MCAP0\r\n"
_CHUNK_BYTES = 256 * 1024  # so much is lost at most of the unfinished file of a killed program
_KEEP_S = 1.0  # and not more than what came in this time
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<BQQQQII4sQ")
_INDEX = struct.Struct("<BQHI")
_FOOTER = struct.Struct("<BQQQ")
_MESSAGE_OPCODE: Final = int(Opcode.MESSAGE)
_BODY = _MESSAGE.size - 9  # of a message's record before its data


@dataclass(slots=True)
class _Open:
    """The chunk that is being filled. times: by channel, log times and offsets in turn."""

    parts: list[bytes] = field(default_factory=list)
    size: int = 0
    times: dict[int, list[int]] = field(default_factory=dict)


class McapStream:
    """Writes one file from its magic number to its end; does not close it.

    The same calls give the same bytes: the open chunk is kept now and then at the end of the file, as a whole chunk
    that the next record overwrites.
    """

    def __init__(self, file: IO[bytes], library: str, profile: str = "") -> None:
        self._file = file
        self._end = 0  # of what is there to stay
        self._kept = 0  # bytes after it that are not
        self._open = _Open()
        self._due_s = monotonic() + _KEEP_S
        self._compressor = zstandard.ZstdCompressor()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts: dict[int, int] = {}
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._append(_MAGIC + _bytes(Header(profile, library)))

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Number of the new schema."""
        if len(self._schemas) == 0xFFFF:
            raise ValueError("an MCAP file cannot hold more than 65535 schemas")
        self._schemas.append(Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name))
        self._fill(_bytes(self._schemas[-1]))
        return len(self._schemas)

    def channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Number of the new channel; schema 0: none."""
        if len(self._channels) == 0xFFFF:
            raise ValueError("an MCAP file cannot hold more than 65535 channels")
        number = len(self._channels) + 1
        self._channels.append(Channel(number, topic, encoding, dict(metadata), schema))
        self._fill(_bytes(self._channels[-1]))
        return number

    def message(self, channel: int, sequence: int, log_time_ns: int, publish_time_ns: int, data: bytes) -> None:
        """ValueError for times and sequence numbers that MCAP cannot hold."""
        length = len(data)
        try:
            head = _MESSAGE.pack(_MESSAGE_OPCODE, _BODY + length, channel, sequence, log_time_ns, publish_time_ns)
        except struct.error:
            times = f"{log_time_ns}, {publish_time_ns}"
            raise ValueError(f"times {times} or sequence {sequence}: not what an MCAP file can hold") from None
        chunk = self._open
        times_of = chunk.times.get(channel)
        if times_of is None:
            times_of = chunk.times[channel] = []
        times_of += (log_time_ns, chunk.size)
        chunk.parts += (head, data)
        chunk.size += _MESSAGE.size + length
        if chunk.size > _CHUNK_BYTES:
            self._close_chunk()
        elif monotonic() >= self._due_s:
            self.keep()

    def attachment(self, attachment: Attachment) -> None:
        self._close_chunk()
        record = _bytes(attachment)
        self._attachments.append(
            AttachmentIndex(
                offset=self._end,
                length=len(record),
                log_time=attachment.log_time,
                create_time=attachment.create_time,
                data_size=len(attachment.data),
                name=attachment.name,
                media_type=attachment.media_type,
            )
        )
        self._append(record)

    def metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        self._close_chunk()
        record = _bytes(Metadata(name, dict(mapping)))
        self._metadata.append(MetadataIndex(self._end, len(record), name))
        self._append(record)

    def keep(self) -> None:
        """Give the operating system all that has come so far, so that it survives this program."""
        self._due_s = monotonic() + _KEEP_S
        if self._open.times:
            record, _ = self._chunk()
            self._file.seek(self._end)
            self._file.write(record)
            self._kept = max(self._kept, len(record))
        self._file.flush()

    def finish(self) -> None:
        """Write what is open, and the summary."""
        self._close_chunk()
        self._append(_bytes(DataEnd(0)))
        groups: Sequence[tuple[Opcode, Sequence[McapRecord]]] = (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        )
        start, summary, offsets = self._end, b"", b""
        for opcode, records in groups:
            if records:
                group = b"".join(map(_bytes, records))
                offsets += _bytes(SummaryOffset(opcode, start + len(summary), len(group)))
                summary += group
        offsets_start = start + len(summary)
        footer = _FOOTER.pack(Opcode.FOOTER, 20, start, offsets_start)
        crc = zlib.crc32(footer, zlib.crc32(offsets, zlib.crc32(summary)))
        self._append(summary + offsets + _bytes(Footer(start, offsets_start, crc)) + _MAGIC)

    def _fill(self, record: bytes) -> None:
        self._open.parts.append(record)
        self._open.size += len(record)

    def _chunk(self) -> tuple[bytes, ChunkIndex]:
        """The open chunk's record and, but for its message indexes, what the summary says about it."""
        content = b"".join(self._open.parts)
        packed = self._compressor.compress(content)
        times = [time for entries in self._open.times.values() for time in entries[::2]]
        first, last, length = min(times), max(times), _CHUNK.size - 9 + len(packed)
        crc = zlib.crc32(content)
        head = _CHUNK.pack(Opcode.CHUNK, length, first, last, len(content), crc, 4, b"zstd", len(packed))
        index = ChunkIndex(
            chunk_length=len(head) + len(packed),
            chunk_start_offset=self._end,
            compression="zstd",
            compressed_size=len(packed),
            message_end_time=last,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=first,
            uncompressed_size=len(content),
        )
        return head + packed, index

    def _close_chunk(self) -> None:
        if not self._open.times:  # schemas and channels wait for the first message
            return
        record, index = self._chunk()
        place = start = self._end + len(record)
        pieces = [record]
        for channel, entries in self._open.times.items():
            body = struct.pack(f"<{len(entries)}Q", *entries)
            pieces.append(_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(body), channel, len(body)) + body)
            index.message_index_offsets[channel] = place
            place += len(pieces[-1])
            self._counts[channel] = self._counts.get(channel, 0) + len(entries) // 2
        index.message_index_length = place - start
        self._chunks.append(index)
        self._open = _Open()
        self._append(b"".join(pieces))
        self._due_s = monotonic() + _KEEP_S

    def _append(self, data: bytes) -> None:
        if self._kept:
            self._file.seek(self._end)
        self._file.write(data)
        self._file.flush()
        self._end += len(data)
        if self._kept > len(data):
            self._file.truncate(self._end)
        self._kept = 0

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
