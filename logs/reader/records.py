"""MCAP at the level of its records: where each starts and ends, and what the small ones say.

An MCAP file is a magic number, then records of one byte opcode, eight bytes length and that many bytes, then the magic
number again (https://mcap.dev/spec). All numbers are little-endian. Nothing here reads beyond what it was given,
whatever a damaged byte claims.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import IO, NamedTuple

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""A record's opcode and the length of what follows."""
LIMIT_BYTES = 1 << 30
"""No record is read into memory, and no chunk unpacked, beyond this size."""


class Op(IntEnum):
    """Kinds of records."""

    HEADER = 1
    FOOTER = 2
    SCHEMA = 3
    CHANNEL = 4
    MESSAGE = 5
    CHUNK = 6
    MESSAGE_INDEX = 7
    CHUNK_INDEX = 8
    ATTACHMENT = 9
    ATTACHMENT_INDEX = 10
    STATISTICS = 11
    METADATA = 12
    METADATA_INDEX = 13
    SUMMARY_OFFSET = 14
    DATA_END = 15


SHORTEST = (0, 8, 20, 14, 16, 22, 40, 6, 64, 36, 48, 46, 8, 20, 17, 4)
"""The least length of a record's content, by opcode. Opcode 0 is none: a hole in a file reads so."""
PRIVATE = 128
"""Opcodes from here on are other programs' own; those in between are of versions to come."""
MESSAGE_HEAD_BYTES = HEAD.size + SHORTEST[Op.MESSAGE]


class Damaged(ValueError):
    """Bytes that are not what their place in the file says."""


class Span(NamedTuple):
    """Where a record stands in its file; `start` is its opcode's, `end` the next record's."""

    opcode: int
    start: int
    end: int


class Fields:
    """A record's content, taken field by field; Damaged where there is less than a field claims."""

    __slots__ = ("_at", "_data")

    def __init__(self, data: bytes, at: int = 0) -> None:
        self._data, self._at = data, at

    @property
    def at(self) -> int:
        return self._at

    def take(self, size: int) -> bytes:
        start, self._at = self._at, self._at + size
        if self._at > len(self._data):
            raise Damaged("a field goes beyond its record")
        return self._data[start : self._at]

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        """Bytes that are no UTF-8 are replaced: a name with a flipped bit still tells its messages apart."""
        return self.take(self.number(4)).decode(errors="replace")

    def pairs(self) -> Mapping[str, str]:
        end = self.number(4) + self._at
        out = {}
        while self._at < end:
            key = self.text()
            out[key] = self.text()
        return out


@dataclass(frozen=True, slots=True)
class Schema:
    number: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Channel:
    number: int
    schema: int
    topic: str
    encoding: str
    metadata: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """What a chunk says about itself. start: where its packed bytes begin, counted from its record's opcode."""

    first_ns: int
    last_ns: int
    size: int
    crc: int
    compression: str
    start: int
    packed_size: int

    @property
    def end(self) -> int:
        """Where its packed bytes end, counted likewise. What there is of its record beyond them is padding."""
        return self.start + self.packed_size


CHUNK_HEAD_BYTES = HEAD.size + 40 + 16  # and a compression's name of up to 16 bytes


def parse_schema(content: bytes) -> Schema:
    fields = Fields(content)
    number, name, encoding = fields.number(2), fields.text(), fields.text()
    return Schema(number, name, encoding, fields.take(fields.number(4)))


def parse_channel(content: bytes) -> Channel:
    fields = Fields(content)
    return Channel(fields.number(2), fields.number(2), fields.text(), fields.text(), fields.pairs())


def parse_metadata(content: bytes) -> tuple[str, Mapping[str, str]]:
    fields = Fields(content)
    return fields.text(), fields.pairs()


def parse_chunk_head(record: bytes) -> ChunkHead:
    """From the first CHUNK_HEAD_BYTES of a chunk's record, its opcode and length included, which are not looked at."""
    fields = Fields(record, HEAD.size)
    first, last, size, crc = fields.number(8), fields.number(8), fields.number(8), fields.number(4)
    name = fields.number(4)
    if name > 16:
        raise Damaged("a compression with a name of more than 16 bytes")
    compression = fields.take(name).decode(errors="replace")
    packed = fields.number(8)
    return ChunkHead(first, last, size, crc, compression, fields.at, packed)


def message_index_count(record: bytes) -> int:
    """How many messages a message index lists, from the first bytes of its record; Damaged if it is none."""
    fields = Fields(record)
    opcode, length = fields.number(1), fields.number(8)
    fields.take(2)
    entries = fields.number(4)
    if opcode != Op.MESSAGE_INDEX or entries % 16 or entries + 6 > length:
        raise Damaged("no message index")
    return entries // 16


def is_message_index(buffer: bytes, place: int) -> bool:
    """Whether the record that begins there is a message index to the last byte, whatever its opcode says."""
    fields = Fields(buffer[place : place + HEAD.size + 6], 1)
    length, _, entries = fields.number(8), fields.number(2), fields.number(4)
    return entries % 16 == 0 and entries + 6 == length


def read_spans(file: IO[bytes], start: int, end: int) -> Iterator[Span]:
    """The records from one place in the file to another. Damaged, at the first that is none, if they do not fill it."""
    while start < end:
        file.seek(start)
        head = file.read(HEAD.size)
        opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, 0)
        following = start + HEAD.size + length
        if not is_header(opcode, length) or following > end:
            raise Damaged("no record")
        yield Span(opcode, start, following)
        start = following


def is_header(opcode: int, length: int) -> bool:
    """Whether a record may begin so. Opcodes of versions to come are taken for damage."""
    return opcode >= PRIVATE or (0 < opcode < len(SHORTEST) and length >= SHORTEST[opcode])
