"""The records of a ROS 1 bag, version 2.0, one after the other, as far as they are whole.

Every record is a header of `name=value` fields and data, each with its length before it (wiki.ros.org/Bags/Format/2.0).
"""

import bz2
import struct
from collections.abc import Iterator, Mapping
from typing import BinaryIO, NamedTuple

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, FILE_HEADER, INDEX, CHUNK, CONNECTION = 2, 3, 4, 5, 7

_LENGTH = struct.Struct("<I")
_LONGEST_HEADER = 1 << 16  # a connection's has its topic in it twice; nothing is near this
_LOOK_AHEAD = 1 << 20
_LARGEST_CHUNK = 1 << 31
_MARK = b"compression="
_BEFORE_MARK = (
    8,
    16,
    21,
    29,
)  # bytes of the header before it: two lengths; and `op`, `size` or both with their lengths
_BROKEN = (EOFError, OSError, RuntimeError, ValueError)  # what bz2 and lz4 raise on bytes that are none of theirs


class Record(NamedTuple):
    """start, size: of its data in the file. whole: False where the file ends before the data does."""

    kind: int
    fields: Mapping[bytes, bytes]
    start: int
    size: int
    whole: bool

    def number(self, name: bytes) -> int | None:
        value = self.fields.get(name, b"")
        return int.from_bytes(value, "little") if len(value) in (4, 8) else None


class Broken(NamedTuple):
    """Bytes that are no record, up to where the next chunk begins or the file ends."""

    start: int
    end: int


def records(file: BinaryIO, size: int) -> Iterator[Record | Broken]:
    """All records behind the magic. A last one that is cut off has `whole` False."""
    position = len(MAGIC)
    while position < size:
        record = _record(file, position, size)
        if record is None or (not record.whole and _next_chunk(file, position + 1, size) < size):
            following = _next_chunk(file, position + 1, size)
            yield Broken(position, following)
            position = following
        else:
            yield record
            position = record.start + record.size


def _record(file: BinaryIO, position: int, size: int) -> Record | None:
    file.seek(position)
    raw = file.read(4)
    length = int.from_bytes(raw, "little")
    if len(raw) < 4 or length > _LONGEST_HEADER:
        return None
    rest = file.read(length + 4)
    fields = header_fields(rest[:length])
    if len(rest) < length + 4 or fields is None:
        return None
    (data,) = _LENGTH.unpack(rest[length:])
    start = position + 8 + length
    return Record(fields[b"op"][0], fields, start, min(data, size - start), start + data <= size)


def header_fields(header: bytes) -> Mapping[bytes, bytes] | None:
    """None for what is no header: the fields must fill it, and one of them be `op`."""
    fields: dict[bytes, bytes] = {}
    position = 0
    while position < len(header):
        end = position + 4 + int.from_bytes(header[position : position + 4], "little")
        name, equals, value = header[position + 4 : end].partition(b"=")
        if end > len(header) or not equals:
            return None
        fields[name] = value
        position = end
    return fields if len(fields.get(b"op", b"")) == 1 else None


def _next_chunk(file: BinaryIO, position: int, size: int) -> int:
    """Where the next chunk record begins, the file's size if nowhere: one of its three fields is its compression."""
    while position < size:
        file.seek(position)
        block = file.read(_LOOK_AHEAD)
        at = block.find(_MARK)
        while at >= 0:
            for before in _BEFORE_MARK:
                start = position + at - before
                record = _record(file, start, size) if at >= before else None
                if record is not None and record.kind == CHUNK:
                    return start
            at = block.find(_MARK, at + 1)
        if len(block) < _LOOK_AHEAD:
            return size
        position += len(block) - max(_BEFORE_MARK) - len(_MARK)
    return size


class Inner(NamedTuple):
    """A record inside of a chunk. offset: of the record in the chunk."""

    kind: int
    fields: Mapping[bytes, bytes]
    offset: int
    data: bytes


def inner_records(chunk: bytes) -> Iterator[Inner]:
    """The records of an unpacked chunk, as far as they are whole."""
    offset = 0
    while (inner := inner_record(chunk, offset)) is not None:
        yield inner[0]
        offset = inner[1]


def inner_record(chunk: bytes, offset: int) -> tuple[Inner, int] | None:
    """The record at this offset and where the next one begins; None where none is whole."""
    head = offset + 4 + int.from_bytes(chunk[offset : offset + 4], "little")
    start = head + 4
    end = start + int.from_bytes(chunk[head:start], "little")
    if end > len(chunk) or start > len(chunk):
        return None
    fields = header_fields(chunk[offset + 4 : head])
    return None if fields is None else (Inner(fields[b"op"][0], fields, offset, chunk[start:end]), end)


def unpacked(record: Record, data: bytes) -> bytes:
    """A chunk's records; of a chunk that is cut off or damaged, those up to there."""
    compression, limit = record.fields.get(b"compression", b"none"), record.number(b"size") or _LARGEST_CHUNK
    if compression == b"none":
        return data
    try:
        if compression == b"bz2":
            return bz2.BZ2Decompressor().decompress(data, limit)
        if compression == b"lz4":
            from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

            out: bytes = LZ4FrameDecompressor().decompress(data, limit)
            return out
    except _BROKEN:
        pass
    return b""
