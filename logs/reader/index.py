"""What a file holds and where: from the summary at its end if that can be trusted, else by reading it all once.

mcap's own seeking reader gives up on files that lack parts of the summary and on unfinished ones; what is read here
instead is every whole record before the first that does not fit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import IO

from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, McapRecord, Message, Metadata, Schema

from logs.reader.records import DAMAGE, MAGIC, Span, has_sound_summary, read, spans
from logs.schema import seconds

_RUN_BYTES = 1 << 18  # messages outside chunks are read in runs of about this size


@dataclass(frozen=True, slots=True)
class Source:
    """What a channel says about its messages."""

    topic: str
    message_encoding: str
    schema_name: str
    schema_encoding: str


@dataclass(frozen=True, slots=True)
class Block:
    """A stretch of whole records with messages in it; log times of the earliest and the latest."""

    start: int
    end: int
    first_ns: int
    last_ns: int


@dataclass(frozen=True, slots=True)
class Index:
    """sources and counts by channel number. damage: what is wrong with the file, one sentence each."""

    sources: Mapping[int, Source]
    counts: Mapping[int, int]
    blocks: tuple[Block, ...]
    metadata: Mapping[str, Mapping[str, str]]
    damage: tuple[str, ...] = ()

    @property
    def message_count(self) -> int:
        return sum(self.counts.values())


def index(file: IO[bytes], size: int) -> Index:
    """The file's contents; never fails on a file that begins with MCAP's magic number."""
    summary = _from_summary(file, size) if has_sound_summary(file, size) else None
    return summary if summary is not None else _from_records(file, size)


def _from_summary(file: IO[bytes], size: int) -> Index | None:
    """None where the summary is absent or lacks what it takes to find every message."""
    try:
        file.seek(0)
        reader = SeekingReader(file, validate_crcs=True, record_size_limit=size)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            return None
        metadata = {record.name: dict(record.metadata) for record in reader.iter_metadata()}
    except (*DAMAGE, OSError):  # OSError: an offset that no file has
        return None
    statistics, chunks = summary.statistics, summary.chunk_indexes
    counts = dict(statistics.channel_message_counts)
    sources = {number: _source(channel, summary.schemas) for number, channel in summary.channels.items()}
    blocks = tuple(
        Block(c.chunk_start_offset, c.chunk_start_offset + c.chunk_length, c.message_start_time, c.message_end_time)
        for c in chunks
    )
    trusted = (
        statistics.chunk_count == len(chunks)
        and statistics.metadata_count == len(summary.metadata_indexes)
        and statistics.message_count == sum(counts.values())
        and all(number in sources for number in counts)
        and all(channel.schema_id in {0, *summary.schemas} for channel in summary.channels.values())
        and all(block.end <= size for block in blocks)
        and not _has_loose_messages(file, size)
    )
    return Index(sources, counts, blocks, metadata) if trusted else None


def _has_loose_messages(file: IO[bytes], size: int) -> bool:
    """Whether messages stand outside chunks, where no index shows them."""
    return any(span.opcode == Opcode.MESSAGE for span in spans(file, len(MAGIC), size))


@dataclass(slots=True)
class _Tally:
    """What has been met so far."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    metadata: dict[str, Mapping[str, str]] = field(default_factory=dict)
    blocks: list[Block] = field(default_factory=list)

    def take(self, records: list[McapRecord], span: Span) -> None:
        times = []
        for record in records:
            if isinstance(record, Message):
                times.append(record.log_time)
                self.counts[record.channel_id] = self.counts.get(record.channel_id, 0) + 1
            elif isinstance(record, Schema):
                self.schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                self.channels.setdefault(record.id, record)
            elif isinstance(record, Metadata):
                self.metadata[record.name] = dict(record.metadata)
        if times:
            self._add(Block(span.start, span.end, min(times), max(times)), span.opcode == Opcode.MESSAGE)

    def _add(self, block: Block, loose: bool) -> None:
        last = self.blocks[-1] if self.blocks else None
        if loose and last and last.end == block.start and block.end - last.start <= _RUN_BYTES:
            self.blocks[-1] = Block(
                last.start, block.end, min(last.first_ns, block.first_ns), max(last.last_ns, block.last_ns)
            )
        else:
            self.blocks.append(block)


def _from_records(file: IO[bytes], size: int) -> Index:
    tally, broken = _Tally(), 0
    position, data_ended, finished = len(MAGIC), False, False
    for span in spans(file, position, size):
        position = span.end
        try:
            records = read(file, span)
        except DAMAGE:
            broken += 1
            continue
        tally.take(records, span)
        data_ended = data_ended or span.opcode == Opcode.DATA_END
        if span.opcode == Opcode.FOOTER:
            finished = file.read(len(MAGIC)) == MAGIC
            break
    known = {number: count for number, count in tally.counts.items() if number in tally.channels}
    lost = sum(tally.counts.values()) - sum(known.values())
    damage = []
    if broken:
        damage.append(f"{_times(broken, 'damaged record')} left out, with the messages in it or them")
    if lost:
        damage.append(f"{_times(lost, 'message')} left out: what channel they belong to was in a damaged record")
    if not finished:
        damage.append(_cut(tally, sum(known.values()), position, size, data_ended))
    sources = {number: _source(channel, tally.schemas) for number, channel in tally.channels.items()}
    return Index(sources, known, tuple(tally.blocks), tally.metadata, tuple(damage))


def _cut(tally: _Tally, messages: int, position: int, size: int, data_ended: bool) -> str:
    if data_ended:
        return f"the index at the end is cut off; all {messages} messages are there"
    if not tally.blocks:
        return "cut off (or still being written) before its first whole message"
    last = seconds(max(block.last_ns for block in tally.blocks))
    return (
        f"cut off (or still being written): {_times(messages, 'message')} read, up to {last}; "
        f"the last {_times(size - position, 'byte')} hold no whole record"
    )


def _source(channel: Channel, schemas: Mapping[int, Schema]) -> Source:
    schema = schemas.get(channel.schema_id)
    name, encoding = (schema.name, schema.encoding) if schema else ("", "")
    return Source(channel.topic, channel.message_encoding, name, encoding)


def _times(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"
