"""What a file holds, by reading it from end to end: for one that has no summary, or is cut off, or damaged."""

from typing import IO

import numpy as np

from logs.reader.blocks import Block, Blocks, Contents, Definitions
from logs.reader.chunks import cut_head, lost_chunk, read_chunk, read_cut_chunk, read_head
from logs.reader.damage import Cut, Losses
from logs.reader.records import (
    CHUNK_HEAD_BYTES,
    HEAD,
    LIMIT_BYTES,
    MAGIC,
    PRIVATE,
    Damaged,
    Fields,
    Op,
    Span,
    is_message_index,
    message_index_count,
    parse_channel,
    parse_chunk_head,
    parse_metadata,
    parse_schema,
)
from logs.reader.resync import convinces, goes_on, resync
from logs.reader.summary import Summary
from logs.reader.unpacked import Stop, Walk, headers, walk

_PIECE_BYTES = 1 << 18
_OF_DATA = frozenset({Op.SCHEMA, Op.CHANNEL, Op.MESSAGE, Op.MESSAGE_INDEX, Op.METADATA})
"""What stands in a run before the data's end; but for the header, all else is of the summary."""

_INDEXED = frozenset({Op.CHUNK, Op.MESSAGE_INDEX})
"""What message indexes follow."""


class Scan:
    """Goes through a file once; `contents` says what was met. A sound summary's definitions are believed first."""

    def __init__(self, file: IO[bytes], size: int, summary: Summary | None) -> None:
        self._file, self._size, self._summary = file, size, summary
        self._definitions = summary.definitions if summary else Definitions()
        self._counts = np.zeros(1 << 16, np.int64)
        self._blocks = Blocks()
        self._metadata: dict[str, dict[str, str]] = {}
        self._attachments: list[Span] = []
        self._losses = Losses()
        self._data_ended = self._finished = False
        self._piece, self._piece_at = b"", 0
        self._previous = Span(Op.HEADER, 0, 0)
        self._run()

    def contents(self) -> Contents:
        sources = self._definitions.sources()
        met = {int(number): int(self._counts[number]) for number in np.flatnonzero(self._counts)}
        counts = {number: count for number, count in met.items() if number in sources}
        losses = self._losses
        losses.homeless = sum(met.values()) - sum(counts.values())
        losses.contradicted = len(self._definitions.contradicted)
        blocks = tuple(self._blocks)
        span = (min(b.first_ns for b in blocks), max(b.last_ns for b in blocks)) if blocks else None
        if self._summary and self._summary.statistics and not (losses.chunks or losses.records):
            losses.miscounted = max(0, self._summary.statistics[0] - sum(met.values()))
        return Contents(sources, counts, blocks, span, self._metadata, tuple(self._attachments), losses)

    def _run(self) -> None:
        at: int | None = len(MAGIC)
        while at is not None and at < self._size and not self._finished:
            at = self._step(at)
        if not self._finished and self._losses.cut is None:
            self._losses.cut = Cut(self._data_ended)

    def _step(self, at: int) -> int | None:
        """Take what stands here; where the next stands, None where there is nothing more."""
        if not self._piece_at <= at <= self._piece_at + len(self._piece) - HEAD.size:
            self._fill(at)
        found = self._walk(at)
        if found.last < 0 and self._piece_at < at:
            self._fill(at)
            found = self._walk(at)
        if found.stop is Stop.BUFFER and self._piece_at + len(self._piece) < self._size:
            if found.last <= at - self._piece_at:  # one record, or less
                return self._alone(at)
            found = found.until(found.last)  # it is not known yet whether a record follows the last one
        if found.last < 0:
            return self._alone(at) if found.stop is Stop.ALONE else self._broken(at)
        return self._broken_after(found) if found.stop is Stop.BROKEN else self._take_run(found)

    def _walk(self, at: int) -> Walk:
        return walk(self._piece, at - self._piece_at, self._size - self._piece_at)

    def _fill(self, at: int) -> None:
        self._file.seek(at)
        self._piece, self._piece_at = self._file.read(_PIECE_BYTES), at

    def _alone(self, at: int) -> int | None:
        """A record that is not taken together with its neighbours."""
        opcode: int
        opcode, length = HEAD.unpack_from(self._piece, at - self._piece_at)
        end: int = at + HEAD.size + length
        if opcode == Op.CHUNK:
            self._previous = Span(opcode, at, end)
            return self._chunk(at, end)
        if opcode == Op.FOOTER:
            return self._footer(at, end)
        if opcode not in (Op.ATTACHMENT, Op.DATA_END):
            return self._big(at, end)
        self._previous = Span(opcode, at, end)
        if opcode == Op.ATTACHMENT:
            self._attachments.append(self._previous)
        else:
            self._data_ended = True
        return end

    def _footer(self, at: int, end: int) -> int | None:
        self._file.seek(at + HEAD.size)
        start = Fields(self._file.read(8)).number(8)
        self._file.seek(end)
        if self._file.read(len(MAGIC) + 1) != MAGIC:
            return self._broken(at) if end < self._size else None
        self._finished = True
        self._losses.index |= start != 0 and self._summary is None
        return end

    def _big(self, at: int, end: int) -> int | None:
        """A record that is longer than a piece; unless its length is wrong."""
        if not goes_on(self._file, end, self._size):
            following = resync(self._file, at + 1, self._size)
            if following is not None and following < end:
                self._lose(at, following)
                return following
        if end - at > LIMIT_BYTES:
            self._losses.records.add(at)
            return end
        self._file.seek(at)
        record = self._file.read(end - at)
        self._take(record, walk(record), at)
        return end

    def _chunk(self, at: int, end: int) -> int | None:
        end = self._end_of_chunk(at, end)
        try:
            content, found = read_chunk(self._file, at, end)
        except Damaged as error:
            following: int | None = end
            if not goes_on(self._file, end, self._size):
                following = resync(self._file, at + HEAD.size, self._size)
            lost_to = end if following is None else following
            self._losses.chunks[at] = lost_chunk(self._file, at, lost_to, self._size, str(error))
            return following
        self._take(content, found, at, Block(at, end, 0, 0, 1))
        return end

    def _end_of_chunk(self, at: int, end: int) -> int:
        """Where its packed bytes end, if records go on there: its length is wrong then, or else it is padded."""
        self._file.seek(at)
        try:
            head = parse_chunk_head(self._file.read(CHUNK_HEAD_BYTES))
        except Damaged:
            return end
        return at + head.end if at + head.end != end and convinces(self._file, at + head.end, self._size) else end

    def _broken(self, at: int) -> int | None:
        """What begins here is damaged, or cut off by the end of the file."""
        whole = cut_head(self._file, at, self._size) is None
        following = resync(self._file, at + 1, self._size) if whole else None
        if following is None:
            self._cut_chunk(at)
        else:
            self._lose(at, following)
        return following

    def _cut_chunk(self, at: int) -> None:
        """What there is of the last chunk, if it is one."""
        head = cut_head(self._file, at, self._size, padded=True)
        if head is not None:
            content, found = read_cut_chunk(self._file, at, self._size)
            self._losses.cut = Cut(False, (head.first_ns, head.last_ns), len(found.messages))
            self._take(content, found, at, Block(at, self._size, 0, 0, 1, cut=True))

    def _broken_after(self, found: Walk) -> int | None:
        """No record follows a run: the length of its last record may be wrong, or what follows is damaged."""
        end = self._piece_at + found.end
        if cut_head(self._file, end, self._size) is None:
            following = resync(self._file, self._piece_at + found.last + 1, self._size)
            if following is not None and following < end:
                end = self._take_run(found.until(found.last))
                self._lose(end, following)
                return following
        self._take_run(found)
        return self._broken(end)

    def _lose(self, start: int, end: int) -> None:
        """Count what stands between two places as a damaged record, or as a chunk where its end says so."""
        self._previous = Span(0, start, end)
        if self._data_ended:
            self._losses.index = True
            return
        lost = lost_chunk(self._file, start, end, self._size, "it begins with nonsense")
        if lost.messages:
            self._previous = Span(Op.CHUNK, start, end)
            self._losses.chunks[start] = lost
        else:
            self._losses.records.add(start)

    def _take_run(self, found: Walk) -> int:
        self._take(self._piece, found, self._piece_at)
        return self._piece_at + found.end

    def _take(self, buffer: bytes, found: Walk, at: int, chunk: Block | None = None) -> None:
        before = self._previous
        for span in found.others:
            try:
                self._take_other(span.opcode, buffer[span.start : span.end], at + span.start, chunk is None)
            except Damaged:
                self._previous = Span(0, at + span.start, at + span.end)
                if self._data_ended:
                    self._losses.index = True
                else:
                    self._losses.records.add(at + span.start)
        messages = found.messages if chunk else self._without_indexes(found, buffer, at, before)
        if not messages:
            return
        self._data_ended = False  # that was none
        head = headers(buffer, np.array(messages, np.int64))
        counts = np.bincount(head["channel"])
        self._counts[: len(counts)] += counts
        channels = self._blocks.shared(frozenset(np.flatnonzero(counts).tolist()))
        first, last = int(head["log_time"].min()), int(head["log_time"].max())
        if chunk is None:
            self._previous = Span(Op.MESSAGE, at + messages[-1], at + found.end)
            self._blocks.add(Block(at + messages[0], at + found.end, first, last, 0, channels))
        else:
            self._blocks.add(Block(chunk.start, chunk.end, first, last, 1, channels, chunk.cut))

    def _without_indexes(self, found: Walk, buffer: bytes, at: int, before: Span) -> list[int]:
        """The messages of a run but for those that are message indexes with a damaged opcode: one bit is enough."""
        indexed = [span for span in found.others if span.opcode == Op.MESSAGE_INDEX]
        ends = {span.end for span in indexed} | ({before.end - at} if before.opcode in _INDEXED else set())
        starts = set(found.messages) if ends else set()
        out = set()
        for place in ends & starts:
            while place in starts and is_message_index(buffer, place):
                self._losses.records.add(at + place)
                out.add(place)
                place += HEAD.size + int.from_bytes(buffer[place + 1 : place + 9], "little")
        return [place for place in found.messages if place not in out] if out else found.messages

    def _take_other(self, opcode: int, record: bytes, at: int, loose: bool) -> None:
        """A record that is no message. Damaged if it is not what it says, or has no business here."""
        previous = self._previous
        if loose:
            self._previous = Span(opcode, at, at + len(record))
        known = self._definitions if not self._data_ended else Definitions()  # what the summary repeats may be damaged
        if opcode == Op.SCHEMA:
            known.add_schema(parse_schema(record[HEAD.size :]))
        elif opcode == Op.CHANNEL:
            known.add_channel(parse_channel(record[HEAD.size :]))
        elif not loose:
            return
        elif opcode == Op.METADATA:
            name, pairs = parse_metadata(record[HEAD.size :])
            self._metadata[name] = dict(pairs)
        elif opcode == Op.MESSAGE_INDEX:
            count = message_index_count(record[: HEAD.size + 6])
            if previous.end != at or (previous.opcode not in _INDEXED and not count):
                raise Damaged("a message index that does not follow a chunk")
            if previous.opcode not in _INDEXED:
                self._chunk_in_disguise(previous)
        elif opcode < PRIVATE and not self._data_ended and opcode not in _OF_DATA and at != len(MAGIC):
            raise Damaged("a record of the summary among the data")

    def _chunk_in_disguise(self, span: Span) -> None:
        """A message index follows something that is no chunk: then its opcode is what is damaged, if not more."""
        read_head(self._file, span.start, span.end)
        self._losses.records.discard(span.start)
        self._attachments = [attachment for attachment in self._attachments if attachment.start != span.start]
        self._chunk(span.start, span.end)
