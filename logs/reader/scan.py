"""What a file holds, by reading it from end to end: for one that has no summary, or is cut off, or damaged."""

from typing import IO

import numpy as np

from logs.reader.blocks import Block, Blocks, Contents, Definitions
from logs.reader.chunks import cut_head, lost_chunk, read_chunk, read_cut_chunk
from logs.reader.damage import Cut, Losses
from logs.reader.records import (
    HEAD,
    LIMIT_BYTES,
    MAGIC,
    Damaged,
    Fields,
    Op,
    Span,
    is_header,
    parse_channel,
    parse_metadata,
    parse_schema,
)
from logs.reader.resync import resync
from logs.reader.summary import Summary
from logs.reader.unpacked import Walk, headers, walk

_PIECE_BYTES = 1 << 18


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
        last = len(MAGIC)
        while at is not None and at < self._size and not self._finished:
            last, at = at, self._step(at)
        if not self._finished and self._losses.cut is None:
            self._losses.cut = Cut(self._size - (last if at is None else at), indexed=self._data_ended)

    def _step(self, at: int) -> int | None:
        """Take what stands here; where the next stands, None where there is nothing more."""
        self._file.seek(at)
        piece = self._file.read(_PIECE_BYTES)
        found = walk(piece, loose=True)
        if found.broken and found.end:
            return self._broken_after(at, piece, found)
        if found.end:
            self._take(piece[: found.end], found, at)
            return at + found.end
        opcode, length = HEAD.unpack_from(piece) if len(piece) >= HEAD.size else (0, 0)
        end = at + HEAD.size + length
        if not is_header(opcode, length) or end > self._size:
            return self._broken(at)
        return self._alone(opcode, at, end)

    def _alone(self, opcode: int, at: int, end: int) -> int | None:
        """A record that is not taken together with its neighbours."""
        if opcode == Op.CHUNK:
            return self._chunk(at, end)
        if opcode == Op.ATTACHMENT:
            self._attachments.append(Span(opcode, at, end))
        elif opcode == Op.DATA_END:
            self._data_ended = True
        elif opcode == Op.FOOTER:
            self._file.seek(at + HEAD.size)
            start = Fields(self._file.read(8)).number(8)
            self._file.seek(end)
            self._finished = self._file.read(len(MAGIC)) == MAGIC
            self._losses.index |= start != 0 and self._summary is None
        elif not self._goes_on(end):
            return self._broken(at)
        elif end - at <= LIMIT_BYTES:
            self._file.seek(at)
            record = self._file.read(end - at)
            self._take(record, walk(record, loose=True), at)
        else:
            self._losses.records.add(at)
        return end

    def _goes_on(self, at: int) -> bool:
        """Whether a record may begin here, or the file ends."""
        self._file.seek(at)
        head = self._file.read(HEAD.size)
        if len(head) < HEAD.size:
            return True
        opcode, length = HEAD.unpack(head)
        return is_header(opcode, length) and length <= max(LIMIT_BYTES, self._size)

    def _chunk(self, at: int, end: int) -> int | None:
        try:
            content, found = read_chunk(self._file, at, end)
        except Damaged as error:
            following: int | None = end
            if not self._goes_on(end):
                following = resync(self._file, at + HEAD.size, self._size)
            lost_to = end if following is None else following
            self._losses.chunks[at] = lost_chunk(self._file, at, lost_to, self._size, str(error))
            return following
        self._take(content, found, at, Block(at, end, 0, 0, 1))
        return end

    def _broken(self, at: int) -> int | None:
        """What begins here is damaged, or cut off by the end of the file."""
        head = cut_head(self._file, at, self._size)
        if head is not None:
            content, found = read_cut_chunk(self._file, at, self._size)
            self._losses.cut = Cut(self._size - at, False, head.last_ns, len(found.messages))
            self._take(content, found, at, Block(at, self._size, 0, 0, 1, cut=True))
            return None
        following = resync(self._file, at + 1, self._size)
        if following is not None:
            self._lose(at, following)
        return following

    def _broken_after(self, at: int, piece: bytes, found: Walk) -> int | None:
        """No record follows a run: the length of its last record may be wrong, or what follows is damaged."""
        last = max([*found.messages[-1:], *(span.start for span in found.others[-1:])])
        following = resync(self._file, at + last + 1, self._size)
        broken = found.end
        if following is not None and following < at + found.end:
            broken = last
            others = [span for span in found.others if span.start < last]
            found = Walk([place for place in found.messages if place < last], others, last, True)
        self._take(piece[: found.end], found, at)
        if following is not None:
            self._lose(at + broken, following)
        elif self._losses.cut is None:
            self._losses.cut = Cut(self._size - at - found.end, indexed=self._data_ended)
        return following

    def _lose(self, start: int, end: int) -> None:
        """Count what stands between two places as a damaged record, or as a chunk where its end says so."""
        if self._data_ended:
            self._losses.index = True
            return
        lost = lost_chunk(self._file, start, end, self._size, "it begins with nonsense")
        if lost.messages:
            self._losses.chunks[start] = lost
        else:
            self._losses.records.add(start)

    def _take(self, buffer: bytes, found: Walk, at: int, chunk: Block | None = None) -> None:
        for span in found.others:
            content = buffer[span.start + HEAD.size : span.end]
            try:
                if span.opcode == Op.SCHEMA:
                    self._definitions.add_schema(parse_schema(content))
                elif span.opcode == Op.CHANNEL:
                    self._definitions.add_channel(parse_channel(content))
                elif span.opcode == Op.METADATA and chunk is None:
                    name, pairs = parse_metadata(content)
                    self._metadata[name] = dict(pairs)
            except Damaged:
                self._losses.records.add(at + span.start)
        if not found.messages:
            return
        self._data_ended = False  # that was none
        head = headers(buffer, np.array(found.messages, np.int64))
        counts = np.bincount(head["channel"], minlength=len(self._counts))
        self._counts += counts
        channels = self._blocks.shared(frozenset(np.flatnonzero(counts).tolist()))
        first, last = int(head["log_time"].min()), int(head["log_time"].max())
        if chunk is None:
            self._blocks.add(Block(at + found.messages[0], at + found.end, first, last, 0, channels))
        else:
            self._blocks.add(Block(chunk.start, chunk.end, first, last, 1, channels, chunk.cut))
