"""Messages in a piece of memory full of records: found, sorted, and handed out, many at a time.

One message costs well below a microsecond so: only the chain of lengths is followed in Python, all else is numpy's.
"""

import functools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from logs.reader.records import HEAD, MESSAGE_HEAD_BYTES, SHORTEST, Op, Span, is_header
from logs.source import RawMessage

Times = NDArray[np.uint64]
Places = NDArray[np.int64]

_BATCH_MESSAGES = 1024
_HEADER = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)  # packed: 31 bytes, as it stands in the file
_ALONE = frozenset({Op.CHUNK, Op.ATTACHMENT, Op.DATA_END, Op.FOOTER})
_new: Callable[[Iterable[object]], RawMessage] = functools.partial(tuple.__new__, RawMessage)


class Stop(Enum):
    """Why a chain of records ends: with the buffer; before a record that is taken alone; before what is no record."""

    BUFFER = auto()
    ALONE = auto()
    BROKEN = auto()


@dataclass(frozen=True, slots=True)
class Walk:
    """A chain of whole records. messages: where each begins; others: the rest; end: where the chain does."""

    messages: list[int]
    others: list[Span]
    end: int
    stop: Stop

    @property
    def last(self) -> int:
        """Where the last record begins; -1 where there is none."""
        return max([-1, *self.messages[-1:], *(span.start for span in self.others[-1:])])

    def until(self, place: int) -> "Walk":
        """The records before the one that begins there."""
        messages = [start for start in self.messages[-1:] if start < place]
        others = [span for span in self.others if span.start < place]
        return Walk(self.messages[:-1] + messages, others, place, self.stop)


def walk(buffer: bytes, start: int = 0, loose_left: int | None = None) -> Walk:
    """Follow the records from `start`.

    loose_left: outside a chunk, where records stand that are taken alone: how many bytes of the file there are from
    the buffer's begin on. A record that goes beyond them is none.
    """
    messages: list[int] = []
    others: list[Span] = []
    end, unpack, head_size = len(buffer), HEAD.unpack_from, HEAD.size
    shortest_message, message = SHORTEST[Op.MESSAGE], int(Op.MESSAGE)
    last_head = end - head_size
    stop = Stop.BUFFER
    while start <= last_head:
        opcode, length = unpack(buffer, start)
        following = start + head_size + length
        if opcode == message and length >= shortest_message and following <= end:
            messages.append(start)
        elif not is_header(opcode, length) or (loose_left is not None and following > loose_left):
            stop = Stop.BROKEN
            break
        elif loose_left is not None and opcode in _ALONE:
            stop = Stop.ALONE
            break
        elif following > end:
            break
        else:
            others.append(Span(opcode, start, following))
        start = following
    return Walk(messages, others, start, stop)


def headers(buffer: bytes, places: Places) -> NDArray[np.void]:
    """The fixed fields of the messages that begin at these places."""
    if not len(places):
        return np.empty(0, _HEADER)
    everywhere: NDArray[np.void] = np.ndarray(
        (len(buffer) - MESSAGE_HEAD_BYTES + 1,), dtype=_HEADER, buffer=buffer, strides=(1,)
    )
    return everywhere[places]


@dataclass(slots=True)
class Unpacked:
    """Messages that wait for their turn, in the order of log time and, at equal times, as they stand in the file.

    order: where in the file they stand; block: where the block does that they are part of. times: (n,) log times;
    places: (n,) where each begins in the buffer.
    """

    block: int
    order: int
    buffer: bytes
    times: Times
    places: Places

    @property
    def bytes_held(self) -> int:
        return len(self.buffer) + self.times.nbytes + self.places.nbytes

    def sizes(self) -> NDArray[np.int64]:
        """(n,) bytes of each message's record."""
        return headers(self.buffer, self.places)["length"].astype(np.int64) + HEAD.size

    def take(self, count: int) -> "Unpacked":
        """The first so many; they are no longer in this."""
        first = Unpacked(self.block, self.order, self.buffer, self.times[:count], self.places[:count])
        self.times, self.places = self.times[count:], self.places[count:]
        return first

    def compact(self) -> "Unpacked":
        """The same messages in a buffer that holds nothing else, if that saves half of it."""
        sizes = self.sizes()
        ends = np.cumsum(sizes)
        if 2 * int(sizes.sum()) > len(self.buffer):
            return self
        pairs = zip(self.places.tolist(), (self.places + sizes).tolist(), strict=True)
        buffer = b"".join([self.buffer[start:end] for start, end in pairs])
        return Unpacked(self.block, self.order, buffer, self.times.copy(), ends - sizes)

    def count_before(self, turn: tuple[int, int]) -> int:
        """How many come before the block that stands at turn[1] has its turn at log time turn[0]."""
        return int(np.searchsorted(self.times, np.uint64(turn[0]), "right" if self.block < turn[1] else "left"))

    def batches(self) -> Iterator[Iterator[RawMessage]]:
        """The messages, some at a time."""
        buffer = self.buffer
        for start in range(0, len(self.places), _BATCH_MESSAGES):
            places = self.places[start : start + _BATCH_MESSAGES]
            head = headers(self.buffer, places)
            starts = (places + MESSAGE_HEAD_BYTES).tolist()
            ends = (places + head["length"].astype(np.int64) + HEAD.size).tolist()
            data = [buffer[start:end] for start, end in zip(starts, ends, strict=True)]
            yield map(
                _new,
                zip(
                    head["channel"].tolist(),
                    head["log_time"].tolist(),
                    head["publish_time"].tolist(),
                    head["sequence"].tolist(),
                    data,
                    strict=True,
                ),
            )


@dataclass(frozen=True, slots=True, eq=False)
class Wanted:
    """channels: (65536,) by number. first_ns, last_ns: of the log times, both included."""

    channels: NDArray[np.bool_]
    first_ns: int
    last_ns: int


def select(buffer: bytes, places: Places, wanted: Wanted, block: int, order: int) -> Unpacked:
    """Of the messages at these places those that are wanted, sorted."""
    head = headers(buffer, places)
    times = head["log_time"]
    keep = wanted.channels[head["channel"]] & (times >= np.uint64(wanted.first_ns))
    keep &= times <= np.uint64(wanted.last_ns)
    if not keep.all():
        times, places = times[keep], places[keep]
    times = np.ascontiguousarray(times)
    if len(times) > 1 and bool((times[1:] < times[:-1]).any()):
        by_time = np.argsort(times, kind="stable")
        times, places = times[by_time], places[by_time]
    return Unpacked(block, order, buffer, times, places)
