"""An MCAP file as a container: its channels, and its raw messages in the order of their log time."""

import contextlib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import IO

import numpy as np

from fieldloc.errors import FieldlocError
from logs.reader.attachments import read_attachment
from logs.reader.blocks import Block
from logs.reader.chunks import lost_chunk, read_chunk, read_cut_chunk
from logs.reader.damage import Lost
from logs.reader.order import in_time_order
from logs.reader.records import MAGIC, Damaged, Op, read_spans
from logs.reader.resync import resync
from logs.reader.scan import Scan
from logs.reader.summary import contents_by, read_summary
from logs.reader.unpacked import Unpacked, Wanted, select, walk
from logs.source import Attachment, RawMessage, Source

_LAST_NS = 2**64 - 1


class McapContainer:
    """What an MCAP file holds; `logs.source.Container` says what the properties are. Nothing stays open between calls.

    FieldlocError for what is no MCAP file at all. A damaged or unfinished one opens with what is whole in it, and
    `damage` says what is not. A file with a sound summary is not read through for that: a chunk in it that turns out
    bad when it is read is in `damage` from then on.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        with self._open() as file:
            self._size = self._path.stat().st_size
            if file.read(len(MAGIC)) != MAGIC:
                raise FieldlocError(f"{path}: not an MCAP file: it does not begin with MCAP's magic number")
            summary = read_summary(file, self._size)
            contents = contents_by(summary, file) if summary else None
            self._contents = contents or Scan(file, self._size, summary).contents()

    @property
    def path(self) -> Path:
        return self._path

    @property
    def sources(self) -> Mapping[int, Source]:
        return MappingProxyType(dict(self._contents.sources))

    @property
    def counts(self) -> Mapping[int, int]:
        return MappingProxyType(dict(self._contents.counts))

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return self._contents.span_ns

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        return self._contents.metadata

    @property
    def damage(self) -> tuple[str, ...]:
        contents = self._contents
        return contents.losses.sentences(contents.span_ns, sum(contents.counts.values()))

    def messages(
        self, channels: Collection[int], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Messages of these channels with start <= log time < end, in the order of log time, ties as in the file.

        Chunks without any are not unpacked.
        """
        first_ns = 0 if start_ns is None else max(0, start_ns)
        last_ns = _LAST_NS if end_ns is None else min(_LAST_NS, end_ns - 1)
        numbers = [number for number in self._contents.sources if number in channels]
        blocks = [
            block
            for block in self._contents.blocks
            if first_ns <= block.last_ns
            and block.first_ns <= last_ns
            and (block.channels is None or not block.channels.isdisjoint(numbers))
        ]
        if first_ns > last_ns or not numbers or not blocks:
            return
        table = np.zeros(1 << 16, np.bool_)
        table[numbers] = True
        with self._open() as file:

            def open_block(block: Block, from_ns: int) -> Iterator[Unpacked]:
                again = from_ns > first_ns
                return self._read(file, block, Wanted(table, from_ns, last_ns), again)

            for batch in in_time_order(blocks, open_block, first_ns):
                yield from batch

    def attachments(self) -> Iterator[Attachment]:
        """The files inside, one at a time; damaged ones are left out."""
        with self._open() as file:
            for span in self._contents.attachments:
                try:
                    attachment = read_attachment(file, span)
                except Damaged:
                    self._contents.losses.attachments.add(span.start)
                    continue
                yield attachment

    @contextlib.contextmanager
    def _open(self) -> Iterator[IO[bytes]]:
        try:
            with self._path.open("rb") as file:
                yield file
        except OSError as error:
            raise FieldlocError(f"{self._path}: cannot be read: {error.strerror or error}") from None

    def _read(self, file: IO[bytes], block: Block, wanted: Wanted, again: bool) -> Iterator[Unpacked]:
        """A block's messages that are wanted. again: its CRCs were looked at before."""
        if not block.chunks:
            file.seek(block.start)
            buffer = file.read(block.end - block.start)
            places = _loose_messages(file, block, buffer)
            yield select(buffer, np.array(places, np.int64), wanted, block.start, block.start)
        elif block.cut:
            buffer, found = read_cut_chunk(file, block.start, self._size)
            yield select(buffer, np.array(found.messages, np.int64), wanted, block.start, block.start)
        elif block.chunks == 1:
            yield from self._chunk(file, block, (block.start, block.end), wanted, again)
        else:
            for place in self._chunks(file, block):
                yield from self._chunk(file, block, place, wanted, again)

    def _chunks(self, file: IO[bytes], block: Block) -> Iterator[tuple[int, int]]:
        """Where the chunks of a block of several are."""
        at: int | None = block.start
        while at is not None:
            try:
                for span in read_spans(file, at, block.end):
                    at = span.end
                    if span.opcode == Op.CHUNK:
                        yield span.start, span.end
                return
            except Damaged:
                if at not in self._contents.losses.chunks:
                    self._contents.losses.records.add(at)
                at = resync(file, at + 1, block.end)

    def _chunk(
        self, file: IO[bytes], block: Block, place: tuple[int, int], wanted: Wanted, again: bool
    ) -> Iterator[Unpacked]:
        start, end = place
        if start in self._contents.losses.chunks:
            return
        try:
            content, found = read_chunk(file, start, end, check=not again)
        except Damaged as error:
            lost = lost_chunk(file, start, end, self._size, str(error))
            if block.chunks == 1:
                lost = Lost(lost.why, lost.messages, (block.first_ns, block.last_ns))
            self._contents.losses.chunks[start] = lost
            return
        unpacked = select(content, np.array(found.messages, np.int64), wanted, block.start, start)
        if len(unpacked.times):
            if unpacked.times[0] < block.first_ns:
                self._contents.losses.late.add(start)
            yield unpacked


def _loose_messages(file: IO[bytes], block: Block, buffer: bytes) -> list[int]:
    """Where in the block each message begins; the block may have been put together around damage."""
    found = walk(buffer)
    places = found.messages
    while found.end < len(buffer):
        following = resync(file, block.start + found.end + 1, block.end)
        if following is None:
            break
        found = walk(buffer, following - block.start)
        places += found.messages
    return places
