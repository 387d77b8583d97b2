"""Where a damaged file goes on: the next place at which records follow each other as they should."""

from typing import IO

import numpy as np

from logs.reader.chunks import cut_head, read_head
from logs.reader.decompress import check_size
from logs.reader.records import HEAD, LIMIT_BYTES, PRIVATE, SHORTEST, Damaged, Op, is_header, message_index_count

_FIRST_PIECE_BYTES = 1 << 12  # most damage is small
_PIECE_BYTES = 1 << 20
_CONVINCING_RECORDS = 4
_SHORTEST = np.array([*SHORTEST, *[1 << 62] * (256 - len(SHORTEST))], np.uint64)


def resync(file: IO[bytes], start: int, size: int) -> int | None:
    """The first place from `start` on where a chain of records begins; None if there is none."""
    piece_bytes = _FIRST_PIECE_BYTES
    while start + HEAD.size <= size:
        file.seek(start)
        piece = file.read(piece_bytes)
        piece_bytes = min(4 * piece_bytes, _PIECE_BYTES)
        for candidate in _candidates(piece, size - start):
            if convinces(file, start + candidate, size):
                return start + candidate
        start += max(1, len(piece) - HEAD.size + 1)
    return None


def _candidates(piece: bytes, left: int) -> list[int]:
    """Where a known opcode and a length that fits stand together. left: bytes of the file from the piece on."""
    count = len(piece) - HEAD.size + 1
    opcodes = np.frombuffer(piece, np.uint8, count)
    high = np.ndarray((count,), "<u4", piece, 5, (1,))
    places = np.flatnonzero((opcodes > 0) & (opcodes < len(SHORTEST)) & (high == 0))
    lengths = np.ndarray((count,), "<u8", piece, 1, (1,))[places]
    fits = (lengths >= _SHORTEST[opcodes[places]]) & (lengths <= np.uint64(max(left, 0)))
    return [int(place) for place in places[fits]]


def goes_on(file: IO[bytes], start: int, size: int) -> bool:
    """Whether what stands here may follow a record: records, or one that is cut, or the file's end."""
    file.seek(start)
    head = file.read(HEAD.size)
    if len(head) < HEAD.size:
        return True
    opcode, length = HEAD.unpack(head)
    cut = is_header(opcode, length) and opcode < PRIVATE and size < start + HEAD.size + length <= start + LIMIT_BYTES
    return cut or convinces(file, start, size)


def convinces(file: IO[bytes], start: int, size: int) -> bool:
    """Whether several records follow each other from here, or a chunk, or fewer to the very end."""
    for met in range(_CONVINCING_RECORDS):
        if start == size:
            return met > 0
        if start > size:
            return False
        file.seek(start)
        record = file.read(HEAD.size + 6)
        if len(record) < HEAD.size:
            return met > 1
        opcode, length = HEAD.unpack_from(record)
        following = start + HEAD.size + length
        if not is_header(opcode, length):
            return False
        if following > size:
            if opcode == Op.CHUNK:
                return cut_head(file, start, size) is not None
            return met > 1 and length <= LIMIT_BYTES
        try:
            if opcode == Op.CHUNK:
                check_size(read_head(file, start, following))
                return True
            if opcode == Op.MESSAGE_INDEX:
                message_index_count(record)
        except Damaged:
            return False
        if opcode == Op.FOOTER:
            return met > 0
        start = following
    return True
