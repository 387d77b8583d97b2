"""What a file holds by its own summary, where that can be trusted to the letter."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import IO

from logs.reader.blocks import Block, Blocks, Contents, Definitions
from logs.reader.damage import Losses
from logs.reader.records import (
    HEAD,
    LIMIT_BYTES,
    MAGIC,
    SHORTEST,
    Damaged,
    Fields,
    Op,
    Span,
    parse_channel,
    parse_metadata,
    parse_schema,
    read_spans,
)

_FOOTER_BYTES = HEAD.size + SHORTEST[Op.FOOTER]


@dataclass(slots=True)
class Summary:
    """statistics: message, attachment, metadata and chunk counts. gaps: stretches of the file that no chunk index
    names, but for the last one. complete: whether the chunk indexes are as many as they should be, in order."""

    definitions: Definitions = field(default_factory=Definitions)
    blocks: Blocks = field(default_factory=Blocks)
    statistics: tuple[int, int, int, int] | None = None
    span_ns: tuple[int, int] | None = None
    counts: dict[int, int] = field(default_factory=dict)
    gaps: list[tuple[int, int]] = field(default_factory=list)
    indexed_to: int = len(MAGIC)
    chunks: int = 0
    ordered: bool = True


def read_summary(file: IO[bytes], size: int) -> Summary | None:
    """What stands between the data and the footer; None where there is nothing, or something that is damaged."""
    if size < len(MAGIC) + _FOOTER_BYTES + len(MAGIC):
        return None
    file.seek(size - _FOOTER_BYTES - len(MAGIC))
    footer, magic = file.read(_FOOTER_BYTES), file.read(len(MAGIC))
    if magic != MAGIC or HEAD.unpack_from(footer) != (Op.FOOTER, SHORTEST[Op.FOOTER]):
        return None
    fields = Fields(footer, HEAD.size)
    start, _, crc = fields.number(8), fields.number(8), fields.number(4)
    end = size - _FOOTER_BYTES - len(MAGIC)
    if not len(MAGIC) <= start < end:
        return None
    summary, checksum = Summary(), 0
    try:
        for opcode, record in _records(file, start, end):
            checksum = zlib.crc32(record, checksum)
            _take(summary, opcode, record)
    except Damaged:
        return None
    summary.gaps.append((summary.indexed_to, start))
    return summary if crc in (0, zlib.crc32(footer[:-4], checksum)) else None


def _records(file: IO[bytes], start: int, end: int) -> Iterator[tuple[int, bytes]]:
    file.seek(start)
    while start < end:
        head = file.read(HEAD.size)
        opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, 0)
        start += HEAD.size + length
        if opcode == 0 or start > end or length > LIMIT_BYTES:
            raise Damaged("the summary's records do not fill it")
        yield opcode, head + file.read(length)


def _take(summary: Summary, opcode: int, record: bytes) -> None:
    fields = Fields(record, HEAD.size)
    if opcode == Op.SCHEMA:
        summary.definitions.add_schema(parse_schema(record[HEAD.size :]))
    elif opcode == Op.CHANNEL:
        summary.definitions.add_channel(parse_channel(record[HEAD.size :]))
    elif opcode == Op.STATISTICS:
        messages, _, _, attachments, metadata, chunks = (fields.number(n) for n in (8, 2, 4, 4, 4, 4))
        first, last = fields.number(8), fields.number(8)
        summary.statistics = (messages, attachments, metadata, chunks)
        summary.span_ns = (first, last) if messages else None
        for _ in range(fields.number(4) // 10):
            number = fields.number(2)
            summary.counts[number] = fields.number(8)
    elif opcode == Op.CHUNK_INDEX:
        first, last, start, length = (fields.number(8) for _ in range(4))
        channels = set()
        for _ in range(fields.number(4) // 10):
            channels.add(fields.number(2))
            fields.take(8)
        indexes = fields.number(8)
        summary.ordered &= start >= summary.indexed_to and length > HEAD.size
        if start > summary.indexed_to:
            summary.gaps.append((summary.indexed_to, start))
        known = summary.blocks.shared(frozenset(channels)) if channels else None
        summary.blocks.add(Block(start, start + length, first, last, 1, known))
        summary.indexed_to, summary.chunks = start + length + indexes, summary.chunks + 1


def contents_by(summary: Summary, file: IO[bytes]) -> Contents | None:
    """What the file holds; None where the summary lacks what it takes to find everything."""
    if summary.statistics is None or not summary.ordered:
        return None
    metadata: dict[str, dict[str, str]] = {}
    attachments: list[Span] = []
    metadata_count = 0
    try:
        for start, end in summary.gaps:
            for span in read_spans(file, start, end):
                if span.opcode in (Op.MESSAGE, Op.CHUNK):
                    return None
                if span.opcode == Op.ATTACHMENT:
                    attachments.append(span)
                elif span.opcode in (Op.SCHEMA, Op.CHANNEL, Op.METADATA):
                    content = _content(file, span)
                    if span.opcode == Op.SCHEMA:
                        summary.definitions.add_schema(parse_schema(content))
                    elif span.opcode == Op.CHANNEL:
                        summary.definitions.add_channel(parse_channel(content))
                    else:
                        name, pairs = parse_metadata(content)
                        metadata[name] = dict(pairs)
                        metadata_count += 1
    except Damaged:
        return None
    definitions = summary.definitions
    used = {number: count for number, count in summary.counts.items() if count}
    trusted = (
        summary.statistics == (sum(used.values()), len(attachments), metadata_count, summary.chunks)
        and used.keys() <= definitions.channels.keys()
        and all(channel.schema in {0, *definitions.schemas} for channel in definitions.channels.values())
    )
    if not trusted:
        return None
    losses = Losses(contradicted=len(definitions.contradicted))
    blocks = tuple(summary.blocks)
    return Contents(definitions.sources(), used, blocks, summary.span_ns, metadata, tuple(attachments), losses)


def _content(file: IO[bytes], span: Span) -> bytes:
    if span.end - span.start > LIMIT_BYTES:
        raise Damaged("too big")
    file.seek(span.start + HEAD.size)
    return file.read(span.end - span.start - HEAD.size)
