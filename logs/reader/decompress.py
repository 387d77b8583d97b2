"""Unpacking a chunk, never into more memory than it says it needs, nor than is plausible."""

import zlib

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from logs.reader.records import LIMIT_BYTES, ChunkHead, Damaged

_SMALL_BYTES = 1 << 26
_PLAUSIBLE_RATIO = 2000  # a chunk beyond _SMALL_BYTES that shrank more is no recording, but made to fill memory
_PIECE_BYTES = 1 << 16
KNOWN = ("", "zstd", "lz4")
"""The compressions that MCAP names."""


def unpack(head: ChunkHead, packed: bytes, *, check: bool = True) -> bytes:
    """The records in a chunk. Damaged if it is not what it says, or if its CRC is wrong (0: it has none).

    check: look at the CRC.
    """
    check_size(head)
    try:
        content = _unpack(head, packed)
    except (zstandard.ZstdError, RuntimeError, ValueError, MemoryError, EOFError) as error:  # lz4's are RuntimeErrors
        raise Damaged(str(error)) from None
    if check and head.crc and zlib.crc32(content) != head.crc:
        raise Damaged("its checksum is wrong")
    return content


def check_size(head: ChunkHead) -> None:
    """Damaged if a chunk claims to be bigger than is read here."""
    if head.compression not in KNOWN:
        raise Damaged(f"compressed by {head.compression!r}, which is not known here")
    if head.size > LIMIT_BYTES or head.size > max(_SMALL_BYTES, _PLAUSIBLE_RATIO * head.packed_size):
        raise Damaged(f"claims to unpack to {head.size} bytes")


def _unpack(head: ChunkHead, packed: bytes) -> bytes:
    if not head.compression:
        return packed
    if head.compression == "zstd":
        if zstandard.frame_content_size(packed) not in (-1, head.size):  # -1: the frame does not say
            raise Damaged("its size is not what it claims")
        content = zstandard.ZstdDecompressor().decompress(packed, max_output_size=head.size) if head.size else b""
    else:
        if lz4.frame.get_frame_info(packed)["content_size"] not in (0, head.size):  # 0: the frame does not say
            raise Damaged("its size is not what it claims")
        content = bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=head.size + 1))
    if len(content) != head.size:
        raise Damaged("its size is not what it claims")
    return content


def unpack_cut(head: ChunkHead, packed: bytes) -> bytes:
    """As much as the first bytes of a chunk's packed bytes give; no CRC can be checked."""
    check_size(head)
    if not head.compression:
        return packed
    out: list[bytes] = []
    left = head.size
    try:
        if head.compression == "zstd":
            with zstandard.ZstdDecompressor().stream_reader(packed) as stream:
                while left and (piece := stream.read(min(left, _PIECE_BYTES))):
                    out.append(piece)
                    left -= len(piece)
        else:
            decompressor = lz4.frame.LZ4FrameDecompressor()
            for at in range(0, len(packed), _PIECE_BYTES):
                piece = bytes(decompressor.decompress(packed[at : at + _PIECE_BYTES], max_length=left))
                out.append(piece)
                left -= len(piece)
                if decompressor.eof or not left:
                    break
    except (zstandard.ZstdError, RuntimeError, ValueError, MemoryError, EOFError):
        pass  # what came before the damage is all there is
    return b"".join(out)
