"""MCAP at the level of its records: where each starts and ends, and what mcap reads in it.

An MCAP file is a magic number, then records of one byte opcode, eight bytes length and that many bytes, then the magic
number again (https://mcap.dev/spec). Walking the lengths never reads beyond the file, whatever a damaged byte claims.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from zstandard import ZstdError

MAGIC = b"\x89MCAP0\r\n"
DAMAGE = (McapError, ZstdError, struct.error, ValueError, KeyError, OverflowError, MemoryError, RuntimeError, EOFError)
"""What mcap and its decompressors raise on damaged bytes (a failed CRC is a ValueError, lz4's is a RuntimeError)."""

_HEAD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")  # head, start of the summary, start of its offsets, CRC


@dataclass(frozen=True, slots=True)
class Span:
    """Where a whole record stands in its file; `start` is its opcode's, `end` the next record's."""

    opcode: int
    start: int
    end: int


def spans(file: IO[bytes], start: int, end: int) -> Iterator[Span]:
    """Each whole record from one place in the file to another; stops at the first that does not fit."""
    while start + _HEAD.size <= end:
        file.seek(start)
        opcode, length = _HEAD.unpack(file.read(_HEAD.size))
        if opcode == 0 or start + _HEAD.size + length > end:  # no record has opcode 0: a hole in the file, not a record
            return
        span = Span(opcode, start, start + _HEAD.size + length)
        yield span
        start = span.end


def has_sound_summary(file: IO[bytes], size: int) -> bool:
    """Whether the file ends as a finished one does, with a summary whose CRC, if it has one, is right."""
    if size < len(MAGIC) + FOOTER_SIZE + len(MAGIC):
        return False
    file.seek(size - FOOTER_SIZE - len(MAGIC))
    opcode, _, start, _, expected = _FOOTER.unpack(file.read(FOOTER_SIZE))
    if file.read(len(MAGIC)) != MAGIC or opcode != Opcode.FOOTER or not 0 < start < size:
        return False
    file.seek(start)
    checked = file.read(size - start - len(MAGIC) - 4)  # all but the CRC itself
    return expected in (0, zlib.crc32(checked))


def read(file: IO[bytes], span: Span) -> list[McapRecord]:
    """What the record holds, a chunk's contents one by one; nothing for the kinds that no reader here needs.

    Raises one of DAMAGE. CRCs of chunks are checked.
    """
    file.seek(span.start + _HEAD.size)
    content = file.read(span.end - span.start - _HEAD.size)
    stream = ReadDataStream(BytesIO(content))
    match span.opcode:
        case Opcode.CHUNK:
            return breakup_chunk(Chunk.read(stream), validate_crc=True)
        case Opcode.MESSAGE:
            return [Message.read(stream, len(content))]
        case Opcode.CHANNEL:
            return [Channel.read(stream)]
        case Opcode.SCHEMA:
            return [Schema.read(stream)]
        case Opcode.METADATA:
            return [Metadata.read(stream)]
        case _:
            return []
