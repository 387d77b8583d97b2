"""Picture files <-> arrays. Inside fieldloc a picture is (h, w, 3) uint8 in OpenCV's order blue, green, red."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fieldloc.errors import FieldlocError

UInt8Array = NDArray[np.uint8]

_WAY_OUT = "give a JPEG, PNG or another picture that OpenCV reads"


def decode(data: bytes, name: str) -> UInt8Array:
    """The picture in the bytes of a file: grey, 16 bit and transparency become 8-bit BGR, turned as its EXIF says.

    FieldlocError, with `name` (a path, or topic and stamp), where it is none. A file that was cut off may still give
    what is left of it.
    """
    if not data:
        raise FieldlocError(f"{name}: is empty; {_WAY_OUT}")
    try:
        picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    except (cv2.error, MemoryError):
        raise FieldlocError(
            f"{name}: is damaged or too large to decode; {_WAY_OUT}, of at most 100 megapixels"
        ) from None
    if picture is None:
        raise FieldlocError(f"{name}: not a picture; {_WAY_OUT}")
    return as_bgr(picture)


def load_picture(path: str | Path) -> UInt8Array:
    """As `decode`, from a file."""
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise FieldlocError(f"{path}: no such picture; give the path of a JPEG or PNG file") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        raise FieldlocError(f"{path}: cannot be read as a picture: {error}") from None
    return decode(data, str(path))


def encode(picture: UInt8Array, suffix: str, quality: int = 95) -> bytes:
    """The bytes of a file of that suffix (".png", ".jpg", ..); quality (1 to 100) is JPEG's and WebP's.

    FieldlocError for a suffix that names no format.
    """
    options = {".jpg": cv2.IMWRITE_JPEG_QUALITY, ".jpeg": cv2.IMWRITE_JPEG_QUALITY, ".webp": cv2.IMWRITE_WEBP_QUALITY}
    flag = options.get(suffix.lower())
    try:
        done, data = cv2.imencode(suffix, picture, [] if flag is None else [flag, quality])
    except cv2.error:
        done, data = False, np.zeros(0, dtype=np.uint8)
    if not done:
        raise FieldlocError(f"{suffix or 'no suffix'}: no picture can be written so; take .png or .jpg")
    return data.tobytes()


def as_bgr(pixels: NDArray[np.generic]) -> UInt8Array:
    """(h, w), (h, w, 1), (h, w, 3) or (h, w, 4), blue first, 8 or 16 bit -> a picture. ValueError for anything else."""
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 3, 4) or 0 in pixels.shape:
        raise ValueError(f"a picture is (h, w), (h, w, 1), (h, w, 3) or (h, w, 4), this is {pixels.shape}")
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)  # type: ignore[operator]
    if pixels.dtype != np.uint8:
        raise ValueError(f"a picture has uint8 or uint16 pixels, these are {pixels.dtype}")
    channels = pixels.repeat(3, axis=2) if pixels.shape[2] == 1 else pixels[:, :, :3]
    return np.ascontiguousarray(channels, dtype=np.uint8)
