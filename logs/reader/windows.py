"""Messages decoded many at a time: one by one costs several times as much."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice, repeat
from typing import NamedTuple

from logs.schema import BadMessage, Record, Schema, decode_many
from logs.source import RawMessage

_FIRST, _MOST = 4, 2048  # messages: few at first, for who wants only one
_MOST_BYTES = 1 << 22  # and no more than that many after a window of so many


class Window(NamedTuple):
    """Messages in order, and of each its channel, its log time and its record: None for those of others."""

    raws: Sequence[RawMessage]
    channels: Sequence[int]
    times_ns: Sequence[int]
    records: Sequence[Record | BadMessage | None]


def in_windows(raws: Iterable[RawMessage], own: Mapping[int, tuple[str, Schema]]) -> Iterator[Window]:
    """own: topic and schema of the channels to decode."""
    following = iter(raws)
    size = _FIRST
    while window := [*islice(following, size)]:
        channels, times_ns, _, _, datas = zip(*window, strict=True)
        mean_bytes = 1 + sum(map(len, datas)) // len(datas)
        size = min(2 * size, _MOST, 1 + _MOST_BYTES // mean_bytes)
        yield Window(window, channels, times_ns, _by_channel(own, channels, datas))


def _by_channel(
    own: Mapping[int, tuple[str, Schema]], channels: Sequence[int], datas: Sequence[bytes]
) -> list[Record | BadMessage | None]:
    of_channel: dict[int, list[bytes]] = {channel: [] for channel in {*channels}}
    for channel, data in zip(channels, datas, strict=True):
        of_channel[channel].append(data)
    read: dict[int, Iterator[Record | BadMessage | None]] = {
        channel: iter(decode_many(own[channel][1], own[channel][0], those)) if channel in own else repeat(None)
        for channel, those in of_channel.items()
    }
    return [*map(next, map(read.__getitem__, channels))]
