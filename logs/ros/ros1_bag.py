"""ROS 1 bags, also those that were never closed, were cut off or have broken chunks.

The index at a bag's end is not needed: every chunk is followed by an index of its own, and the chunk after which it is
missing is read itself.
"""

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from fieldloc.errors import FieldlocError
from logs.ros.bag_records import (
    CHUNK,
    CONNECTION,
    FILE_HEADER,
    INDEX,
    MAGIC,
    MESSAGE,
    Broken,
    Record,
    header_fields,
    inner_record,
    inner_records,
    records,
    unpacked,
)
from logs.source import Attachment, RawMessage, Source

_ENTRY = np.dtype([("time", "<u8"), ("chunk", "<u4"), ("offset", "<u4"), ("connection", "<u4")])
_ON_DISK = np.dtype([("seconds", "<u4"), ("rest", "<u4"), ("offset", "<u4")])
_CHUNKS_AT_HAND = 4  # chunks overlap in time where a publisher was slow, hardly ever more than two at once
_KEPT = ("md5sum", "latching")  # of what a publisher says of itself, but for its name: a topic's publishers are one


class Ros1Bag:
    """A `logs.source.Container`. A channel is a topic with its type, however many nodes published it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.metadata: Mapping[str, Mapping[str, str]] = {}
        self._damage: list[str] = []
        self._chunks: list[Record] = []
        self._sources: dict[int, Source] = {}
        self._channels: dict[int, int] = {}  # by connection
        try:
            with path.open("rb") as file:
                self._entries = self._scan(file, path.stat().st_size)
        except OSError as error:
            raise FieldlocError(f"{path}: cannot be read: {error.strerror or error}") from None
        connections, places = np.unique(self._entries["connection"], return_inverse=True)
        channels = np.array([self._channels.get(number, -1) for number in connections.tolist()], dtype=int)[places]
        if (lost := int((channels < 0).sum())) > 0:
            self._damage.append(f"{lost} messages are of a connection that is described nowhere")
        self._entries = self._entries[channels >= 0]
        self._entry_channels = channels[channels >= 0]
        numbers, counts = np.unique(self._entry_channels, return_counts=True)
        self.counts = dict.fromkeys(self._sources, 0) | dict(zip(numbers.tolist(), counts.tolist(), strict=True))

    @property
    def sources(self) -> Mapping[int, Source]:
        return self._sources

    @property
    def damage(self) -> tuple[str, ...]:
        """What was found when it was opened, and since then while reading."""
        return tuple(self._damage)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        times = self._entries["time"]
        return (int(times[0]), int(times[-1])) if len(times) else None

    def attachments(self) -> Iterator[Attachment]:
        return iter(())

    def messages(
        self, channels: Collection[int], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Log and publish time are the same: when the recorder received it."""
        wanted = np.isin(self._entry_channels, list(channels))
        times = self._entries["time"]
        if start_ns is not None:
            wanted &= times >= max(start_ns, 0)
        if end_ns is not None:
            wanted &= times < max(end_ns, 0)
        unreadable = 0
        at_hand: dict[int, bytes] = {}
        try:
            with self.path.open("rb") as file:
                for channel, (time, number, offset, connection) in self._listed(np.flatnonzero(wanted)):
                    if number not in at_hand:
                        if len(at_hand) == _CHUNKS_AT_HAND:
                            del at_hand[next(iter(at_hand))]
                        at_hand[number] = self._chunk(file, number)
                    data = _message(at_hand[number], offset, connection)
                    if data is None:
                        unreadable += 1
                    else:
                        yield RawMessage(channel, time, time, 0, data)
        except OSError as error:
            raise FieldlocError(f"{self.path}: cannot be read: {error.strerror or error}") from None
        if unreadable:
            self._note(f"{unreadable} messages are in broken chunks and left out")

    def _listed(self, places: NDArray[np.intp]) -> Iterator[tuple[int, tuple[int, int, int, int]]]:
        """Channel, and time, chunk, offset and connection of these entries, a few thousand at once."""
        for start in range(0, len(places), 4096):
            some = places[start : start + 4096]
            yield from zip(self._entry_channels[some].tolist(), self._entries[some].tolist(), strict=True)

    def _chunk(self, file: BinaryIO, number: int) -> bytes:
        record = self._chunks[number]
        file.seek(record.start)
        return unpacked(record, file.read(record.size))

    def _note(self, sentence: str) -> None:
        if sentence not in self._damage:
            self._damage.append(sentence)

    def _scan(self, file: BinaryIO, size: int) -> NDArray[np.void]:
        """Every message's time, chunk, offset and connection, by time and then as in the file."""
        if file.read(len(MAGIC)) != MAGIC:
            raise FieldlocError(f"{self.path}: is no ROS 1 bag of version 2.0; `rosbag fix` brings older ones up to it")
        found: dict[int, list[NDArray[np.void]]] = {}  # by chunk
        if size == len(MAGIC):
            self._note(f"it is cut off at byte {size}")
        for record in records(file, size):
            last = len(self._chunks) - 1
            if isinstance(record, Broken):
                self._note(f"{record.end - record.start} bytes from {record.start} on are broken and left out")
                found.pop(last, None)  # who knows whether that was all of its index
                continue
            if not record.whole or (record.kind == FILE_HEADER and (record.number(b"index_pos") or 0) > size):
                self._note(f"it is cut off at byte {size}")
            if record.kind == CHUNK:
                self._chunks.append(record)
            elif record.kind == INDEX and last >= 0 and record.whole:
                file.seek(record.start)
                entries = _indexed(record, last, file.read(record.size))
                found.setdefault(last, []).append(entries)
                if self._unknown(entries):
                    self._read(file, last)
            elif record.kind == CONNECTION and record.whole:
                file.seek(record.start)
                self._connect(record.fields, file.read(record.size))
            elif record.kind == FILE_HEADER:
                if record.fields.get(b"encryptor"):
                    raise FieldlocError(f"{self.path}: is encrypted; decrypt it first (`rosbag decrypt`)")
                if record.number(b"index_pos") == 0:
                    self._note("it was never closed, so that its index is missing; `rosbag reindex` writes one")
        if self._damage:
            found.pop(len(self._chunks) - 1, None)
        for number in range(len(self._chunks)):
            if number not in found:
                found[number] = [self._read(file, number)]
        entries = np.concatenate([each for parts in found.values() for each in parts] or [np.empty(0, _ENTRY)])
        return entries[np.lexsort((entries["offset"], entries["chunk"], entries["time"]))]

    def _unknown(self, entries: NDArray[np.void]) -> bool:
        return len(entries) > 0 and int(entries["connection"][0]) not in self._channels

    def _read(self, file: BinaryIO, number: int) -> NDArray[np.void]:
        """The entries of a chunk, from the chunk itself, in which connections are described before their messages."""
        out = []
        for inner in inner_records(self._chunk(file, number)):
            if inner.kind == CONNECTION:
                self._connect(inner.fields, inner.data)
            elif inner.kind == MESSAGE and len(time := inner.fields.get(b"time", b"")) == 8:
                seconds, rest = int.from_bytes(time[:4], "little"), int.from_bytes(time[4:], "little")
                connection = int.from_bytes(inner.fields.get(b"conn", b""), "little")
                out.append((seconds * 1_000_000_000 + rest, number, inner.offset, connection & 0xFFFFFFFF))
        return np.array(out, _ENTRY)

    def _connect(self, fields: Mapping[bytes, bytes], data: bytes) -> None:
        """A connection's description: its topic, and as data a header of what its publisher said of it."""
        number = int.from_bytes(fields.get(b"conn", b""), "little")
        said = header_fields(data + b"\4\0\0\0op=\0")  # a header but for the kind of record
        if number in self._channels or said is None:
            return
        source = Source(
            fields.get(b"topic", said.get(b"topic", b"")).decode(errors="replace"),
            "ros1",
            said.get(b"type", b"").decode(errors="replace"),
            "ros1msg",
            said.get(b"message_definition", b""),
            {name: said[name.encode()].decode(errors="replace") for name in _KEPT if name.encode() in said},
        )
        channel = next((known for known, other in self._sources.items() if other == source), None)
        if channel is None:
            channel = len(self._sources) + 1
            self._sources[channel] = source
        self._channels[number] = channel


def _indexed(record: Record, chunk: int, data: bytes) -> NDArray[np.void]:
    """The entries of a chunk, from one of the records behind it: there is one for each connection."""
    on_disk = np.frombuffer(data[: len(data) // _ON_DISK.itemsize * _ON_DISK.itemsize], _ON_DISK)
    entries = np.empty(len(on_disk), _ENTRY)
    entries["time"] = on_disk["seconds"].astype(np.uint64) * 1_000_000_000 + on_disk["rest"]
    entries["chunk"] = chunk
    entries["offset"] = on_disk["offset"]
    entries["connection"] = (record.number(b"conn") or 0) & 0xFFFFFFFF
    return entries


def _message(chunk: bytes, offset: int, connection: int) -> bytes | None:
    """A message's bytes; None where the index points to something else. Its connection may be described before it."""
    while (found := inner_record(chunk, offset)) is not None:
        inner, offset = found
        if inner.kind != CONNECTION:
            right = inner.kind == MESSAGE and int.from_bytes(inner.fields.get(b"conn", b""), "little") == connection
            return inner.data if right else None
    return None
