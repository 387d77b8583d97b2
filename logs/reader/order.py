"""Messages in the order of their log time out of blocks that may overlap in time, in bounded memory.

A sweep over time: a block is opened when its first message is due. Where so many overlap that they do not fit, the
latest messages are forgotten, and their blocks are opened again when those are due.
"""

import heapq
from bisect import insort
from collections.abc import Callable, Iterable, Iterator
from operator import attrgetter, itemgetter

import numpy as np

from logs.reader.blocks import Block
from logs.reader.unpacked import Unpacked
from logs.source import RawMessage

BUDGET_BYTES = 64 << 20
_MERGED_MESSAGES = 4096
_ORDER = attrgetter("order")
_LOG_TIME = itemgetter(1)

Open = Callable[[Block, int], Iterable[Unpacked]]
"""Opens a block; messages before the given log time are not wanted. What it gives has `order` within the block."""
_Key = tuple[int, int]  # log time and place in the file: a message's turn


def in_time_order(
    blocks: Iterable[Block], open_block: Open, first_ns: int, budget_bytes: int = BUDGET_BYTES
) -> Iterator[Iterable[RawMessage]]:
    """Batches of messages with first_ns <= log time, at equal times as they stand in the file."""
    due = _Due(blocks, first_ns)
    waiting: list[Unpacked] = []  # in the order of the file
    held = 0
    horizon: _Key | None = None  # what comes from then on is left for later
    while due:
        for unpacked in open_block(*due.pop()):
            kept = unpacked if horizon is None else _before(unpacked, horizon, due)
            insort(waiting, kept, key=_ORDER)
            held += kept.bytes_held
        if held > budget_bytes:
            waiting = [unpacked.compact() for unpacked in waiting]
            held = _held(waiting)
        if held > budget_bytes and len(waiting) > 1:
            horizon = _turn_after(waiting, budget_bytes // 2)
            waiting = [_before(unpacked, horizon, due) for unpacked in waiting]
            held = _held(waiting)
        following = due.next()
        if horizon is None or following is None or following >= horizon:
            yield from _ready(waiting, following)
            held, horizon = _held(waiting), None


class _Due:
    """Blocks by the turn of their next message; a block is opened again if messages of it were left for later."""

    def __init__(self, blocks: Iterable[Block], first_ns: int) -> None:
        self._blocks = {block.start: block for block in blocks}
        self._turn_ns = {block.start: max(block.first_ns, first_ns) for block in self._blocks.values()}
        self._from_ns = dict.fromkeys(self._blocks, first_ns)  # a block may claim to begin later than it does
        self._heap: list[_Key] = [(turn_ns, start) for start, turn_ns in self._turn_ns.items()]
        heapq.heapify(self._heap)

    def next(self) -> _Key | None:
        """The earliest turn."""
        while self._heap and self._turn_ns.get(self._heap[0][1]) != self._heap[0][0]:
            heapq.heappop(self._heap)  # it was put earlier since
        return self._heap[0] if self._heap else None

    def __bool__(self) -> bool:
        return self.next() is not None

    def pop(self) -> tuple[Block, int]:
        """The block whose turn it is, and from when on its messages are wanted."""
        _, start = heapq.heappop(self._heap)
        del self._turn_ns[start]
        return self._blocks[start], self._from_ns[start]

    def put(self, start: int, from_ns: int) -> None:
        """The messages of a block from this log time on are left for later."""
        if from_ns < self._turn_ns.get(start, from_ns + 1):
            self._turn_ns[start] = self._from_ns[start] = from_ns
            heapq.heappush(self._heap, (from_ns, start))


def _held(waiting: list[Unpacked]) -> int:
    return sum(unpacked.bytes_held for unpacked in waiting)


def _turn_after(waiting: list[Unpacked], size: int) -> _Key:
    """The turn up to which the earliest messages, of about this size together, come."""
    times = np.concatenate([unpacked.times for unpacked in waiting])
    blocks = np.repeat([unpacked.block for unpacked in waiting], [len(unpacked.times) for unpacked in waiting])
    by_time = np.argsort(times, kind="stable")
    sizes = np.cumsum(np.concatenate([unpacked.sizes() for unpacked in waiting])[by_time])
    last = by_time[min(int(np.searchsorted(sizes, size)), len(times) - 1)]
    return int(times[last]), int(blocks[last]) + 1


def _before(unpacked: Unpacked, horizon: _Key, due: _Due) -> Unpacked:
    """The messages before the horizon; the rest is left for later."""
    count = unpacked.count_before(horizon)
    if count == len(unpacked.times):
        return unpacked
    due.put(unpacked.block, int(unpacked.times[count]))
    return unpacked.take(count).compact()


def _ready(waiting: list[Unpacked], next_due: _Key | None) -> Iterator[Iterable[RawMessage]]:
    """What comes before anything that is not yet opened; it waits no longer."""
    parts = []
    for unpacked in waiting:
        count = len(unpacked.times) if next_due is None else unpacked.count_before(next_due)
        if count:
            parts.append(unpacked.take(count))
    waiting[:] = [unpacked for unpacked in waiting if len(unpacked.times)]
    if len(parts) == 1:
        yield from parts[0].batches()
    elif parts:
        yield from _merged(parts)


def _merged(parts: list[Unpacked]) -> Iterator[list[RawMessage]]:
    by_time = np.argsort(np.concatenate([part.times for part in parts]), kind="stable")
    part_of = np.repeat(np.arange(len(parts)), [len(part.times) for part in parts])[by_time]
    for start in range(0, len(part_of), _MERGED_MESSAGES):
        counts = np.bincount(part_of[start : start + _MERGED_MESSAGES])
        batch: list[RawMessage] = []
        for i in np.flatnonzero(counts).tolist():
            for messages in parts[i].take(int(counts[i])).batches():
                batch += messages
        batch.sort(key=_LOG_TIME)  # stable, and the parts are in the order of the file
        yield batch
