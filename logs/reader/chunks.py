"""Chunks out of the file: whole ones, the beginnings of cut ones, and what is known of those that cannot be read."""

from typing import IO

import numpy as np

from logs.reader.damage import Lost
from logs.reader.decompress import check_size, unpack, unpack_cut
from logs.reader.records import (
    CHUNK_HEAD_BYTES,
    HEAD,
    LIMIT_BYTES,
    ChunkHead,
    Damaged,
    Fields,
    Op,
    message_index_count,
    parse_chunk_head,
)
from logs.reader.unpacked import Walk, walk


def read_head(file: IO[bytes], start: int, end: int) -> ChunkHead:
    """Of a chunk between two places in the file, whatever its own opcode and length say. Damaged if it is none."""
    file.seek(start)
    head = parse_chunk_head(file.read(max(0, min(end - start, CHUNK_HEAD_BYTES))))
    if start + head.end > end:
        raise Damaged("its packed bytes go beyond it")
    return head


def read_chunk(file: IO[bytes], start: int, end: int, *, check: bool = True) -> tuple[bytes, Walk]:
    """The records in a chunk, and where each is. Damaged if they cannot be read to the last.

    check: look at the CRC.
    """
    head = read_head(file, start, end)
    check_size(head)
    if head.packed_size > LIMIT_BYTES:
        raise Damaged(f"is {head.packed_size} bytes long")
    file.seek(start + head.start)
    content = unpack(head, file.read(head.packed_size), check=check)
    found = walk(content)
    if found.end != len(content):
        raise Damaged("its records do not fill it")
    return content, found


def read_cut_chunk(file: IO[bytes], start: int, size: int) -> tuple[bytes, Walk]:
    """The whole records at the beginning of a chunk that the end of the file cuts; unchecked."""
    head = cut_head(file, start, size, padded=True)
    if head is None or size - start > LIMIT_BYTES:
        return b"", walk(b"")
    file.seek(start + head.start)
    content = unpack_cut(head, file.read(head.packed_size))
    return content, walk(content)


def cut_head(file: IO[bytes], start: int, size: int, *, padded: bool = False) -> ChunkHead | None:
    """The head of a chunk that goes beyond the file's end; None where it is not there, or no chunk's.

    padded: also where the record is longer than it needs to be. Without that, two lengths bear each other out.
    """
    file.seek(start)
    record = file.read(CHUNK_HEAD_BYTES)
    try:
        head = parse_chunk_head(record)
        check_size(head)
    except Damaged:
        return None
    opcode, length = HEAD.unpack_from(record)
    agrees = head.end <= HEAD.size + length if padded else head.end == HEAD.size + length
    return head if opcode == Op.CHUNK and agrees and start + head.start <= size else None


def lost_chunk(file: IO[bytes], start: int, end: int, size: int, why: str) -> Lost:
    """What a chunk that cannot be read, and the message indexes after it, still tell."""
    try:
        head = read_head(file, start, end)
        span_ns = (head.first_ns, head.last_ns) if head.first_ns <= head.last_ns else None
    except Damaged:
        span_ns = None
    entries = _indexed(file, end, size)
    if len(entries):
        span_ns = (int(entries[:, 0].min()), int(entries[:, 0].max()))
    return Lost(why, len(entries) or None, span_ns)


def _indexed(file: IO[bytes], start: int, size: int) -> "np.ndarray[tuple[int, int], np.dtype[np.uint64]]":
    """(n, 2) log time and place of each message that the message indexes at this place in the file list."""
    found = [np.empty((0, 2), np.uint64)]
    while start + HEAD.size <= size:
        file.seek(start)
        record = file.read(HEAD.size + 6)
        try:
            count = message_index_count(record)
            length = Fields(record, 1).number(8)
        except Damaged:
            break
        if start + HEAD.size + length > size or length > LIMIT_BYTES:
            break
        entries = file.read(16 * count)
        found.append(np.frombuffer(entries, "<u8").reshape(-1, 2).astype(np.uint64))
        start += HEAD.size + length
    return np.concatenate(found)
