"""Pixels as cameras deliver them, without compression, as BGR pictures."""

import cv2
import numpy as np
from numpy.typing import NDArray

UInt8Array = NDArray[np.uint8]

_TO_BGR = {
    "bgr8": None,
    "8uc3": None,
    "rgb8": cv2.COLOR_RGB2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
    "8uc4": cv2.COLOR_BGRA2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "mono8": cv2.COLOR_GRAY2BGR,
    "8uc1": cv2.COLOR_GRAY2BGR,
    "mono16": cv2.COLOR_GRAY2BGR,
    "16uc1": cv2.COLOR_GRAY2BGR,
    "bayer_rggb8": cv2.COLOR_BayerRGGB2BGR,
    "bayer_bggr8": cv2.COLOR_BayerBGGR2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGBRG2BGR,
    "bayer_grbg8": cv2.COLOR_BayerGRBG2BGR,
    "yuv422": cv2.COLOR_YUV2BGR_UYVY,
    "uyvy": cv2.COLOR_YUV2BGR_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2,
    "yuyv": cv2.COLOR_YUV2BGR_YUY2,
}
_WIDTHS = {"bgra8": 4, "rgba8": 4, "8uc4": 4, "bgr8": 3, "rgb8": 3, "8uc3": 3, "mono16": 2, "16uc1": 2}
_PAIRED = ("yuv422", "uyvy", "yuv422_yuy2", "yuyv")
_DEEP = ("mono16", "16uc1")


def from_pixels(data: bytes, encoding: str, width_px: int, height_px: int, step: int) -> UInt8Array:
    """(h, w, 3) BGR of rows of `step` bytes. encoding: as ROS and Foxglove name them ("rgb8", "mono8", "yuyv", ...).

    ValueError for an encoding that is not known and for a size that does not fit the data.
    """
    name = encoding.strip().lower()
    if name not in _TO_BGR:
        raise ValueError(f"pixel encoding '{encoding}' is not known; known are {', '.join(_TO_BGR)}")
    bytes_each = 2 if name in _PAIRED else _WIDTHS.get(name, 1)
    row = width_px * bytes_each
    step = step or row
    if width_px < 1 or height_px < 1 or step < row or len(data) < step * (height_px - 1) + row:
        raise ValueError(f"{len(data)} bytes are no picture of {width_px} by {height_px} in {encoding}")
    rows = np.frombuffer(data, np.uint8, count=min(len(data), step * height_px))
    rows = np.pad(rows, (0, step * height_px - len(rows))).reshape(height_px, step)[:, :row]
    if name in _DEEP:
        deep = np.ascontiguousarray(rows).view("<u2").astype(np.float64)
        pixels = (deep * (255.0 / max(float(deep.max()), 1.0))).astype(np.uint8)[..., None]
    else:
        pixels = np.ascontiguousarray(rows.reshape(height_px, width_px, bytes_each))
    code = _TO_BGR[name]
    return np.asarray(pixels if code is None else cv2.cvtColor(pixels, code), dtype=np.uint8)
