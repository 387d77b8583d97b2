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
    by_start = {block.start: block for block in blocks}
    due: list[_Key] = [(max(block.first_ns, first_ns), block.start) for block in by_start.values()]
    heapq.heapify(due)
    waiting: list[Unpacked] = []  # in the order of the file
    horizon: _Key | None = None  # what comes later is not worth keeping
    again: set[int] = set()  # blocks of which the first messages were had
    while due:
        key = heapq.heappop(due)
        if horizon is not None and key >= horizon:
            horizon = None
        from_ns = key[0] if key[1] in again else first_ns  # a block may claim to begin later than it does
        for unpacked in open_block(by_start[key[1]], from_ns):
            insort(waiting, unpacked, key=_ORDER)
        if horizon is not None:
            again |= _forget(waiting, horizon, due, key[1])
        if len(waiting) > 1 and sum(unpacked.bytes_held for unpacked in waiting) > budget_bytes:
            horizon = _turn_after(waiting, budget_bytes // 2)
            again |= _forget(waiting, horizon, due)
        yield from _ready(waiting, due[0] if due else None)
    yield from _ready(waiting, None)


def _turn_after(waiting: list[Unpacked], size: int) -> _Key:
    """The turn up to which the earliest messages, of about this size together, come."""
    times = np.concatenate([unpacked.times for unpacked in waiting])
    blocks = np.repeat([unpacked.block for unpacked in waiting], [len(unpacked.times) for unpacked in waiting])
    by_time = np.argsort(times, kind="stable")
    sizes = np.cumsum(np.concatenate([unpacked.sizes() for unpacked in waiting])[by_time])
    last = by_time[min(int(np.searchsorted(sizes, size)), len(times) - 1)]
    return int(times[last]), int(blocks[last]) + 1


def _forget(waiting: list[Unpacked], horizon: _Key, due: list[_Key], only: int | None = None) -> set[int]:
    """Drop the messages from `horizon` on (of one block only, where one is given), and note when they are due.

    Which blocks they are of.
    """
    again: dict[int, int] = {}
    for i, unpacked in enumerate(waiting):
        if only is not None and unpacked.block != only:
            continue
        keep = unpacked.count_before(horizon)
        if keep < len(unpacked.times):
            first_ns = int(unpacked.times[keep])
            again[unpacked.block] = min(first_ns, again.get(unpacked.block, first_ns))
            kept = unpacked.take(keep)
            waiting[i] = kept.compact() if kept.sizes().sum() < len(kept.buffer) // 2 else kept
    for block, first_ns in again.items():
        heapq.heappush(due, (first_ns, block))
    waiting[:] = [unpacked for unpacked in waiting if len(unpacked.times)]
    return set(again)


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
