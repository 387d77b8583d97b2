"""A file's raw messages in the order of their log time, holding no more of the file than overlaps in time."""

from collections.abc import Collection, Iterator, Sequence
from typing import IO

from mcap.records import Message

from logs.reader.index import Block
from logs.reader.records import DAMAGE, read, spans


def in_time_order(file: IO[bytes], blocks: Sequence[Block], channels: Collection[int]) -> Iterator[Message]:
    """Messages of these channels, at equal times as they stand in the file; damaged records are left out."""
    ordered = sorted(blocks, key=lambda block: (block.first_ns, block.start))
    waiting: list[tuple[int, int, int, Message]] = []
    for i, block in enumerate(ordered):
        waiting += _messages(file, block, channels)
        waiting.sort(key=lambda entry: entry[:3])
        if i + 1 < len(ordered):
            ready = 0
            while ready < len(waiting) and waiting[ready][0] < ordered[i + 1].first_ns:
                ready += 1
            yield from (entry[3] for entry in waiting[:ready])
            del waiting[:ready]
    yield from (entry[3] for entry in waiting)


def _messages(file: IO[bytes], block: Block, channels: Collection[int]) -> Iterator[tuple[int, int, int, Message]]:
    for span in spans(file, block.start, block.end):
        try:
            records = read(file, span)
        except DAMAGE:
            continue
        for i, record in enumerate(records):
            if isinstance(record, Message) and record.channel_id in channels:
                yield record.log_time, span.start, i, record
