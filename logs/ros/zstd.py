"""What rosbag2 compresses itself: whole files, or each message."""

import shutil
from pathlib import Path

import zstandard

from fieldloc.errors import FieldlocError

MAGIC = b"\x28\xb5\x2f\xfd"
_LARGEST_MESSAGE = 1 << 30


def inflated(data: bytes) -> bytes:
    """A message as it was before rosbag2 compressed it. CDR begins with a zero, so that there is no mistaking the two.

    A message that cannot be unpacked stays as it is; its decoder will say that it is bad.
    """
    if not data.startswith(MAGIC):
        return data
    try:
        if zstandard.get_frame_parameters(data).content_size in range(_LARGEST_MESSAGE):
            return zstandard.ZstdDecompressor().decompress(data)
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=64 * len(data) + (1 << 20))
    except zstandard.ZstdError:
        return data


def unpack_file(packed: Path, into: Path) -> None:
    """As much as there is: of a file that is cut off, what comes before. FieldlocError where nothing can be read."""
    try:
        with packed.open("rb") as file, into.open("wb") as out:
            try:
                shutil.copyfileobj(zstandard.ZstdDecompressor().stream_reader(file), out, 1 << 16)
            except zstandard.ZstdError as error:
                if out.tell() == 0:
                    raise FieldlocError(f"{packed}: is not compressed by zstd as its name says: {error}") from None
    except OSError as error:
        raise FieldlocError(f"{packed}: cannot be unpacked: {error.strerror or error}") from None
