"""Which part of a straight segment lies inside something, for many segments at once.

A part is a pair of shares (low, high) of the way from the segment's start to its end; low >= high where there is none.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.pose import FloatArray

_BORDER_POINTS = 33  # along each side of the image, to find how far a lens reaches
_SAMPLES = 17  # per segment with a lens
_HALVINGS = 32  # 1/16 of a segment halved so often is less than a millionth of a pixel
_LEAST_AHEAD = 0.05  # cosine: rays farther to the side have no use for x / z

Part = tuple[FloatArray, FloatArray]


def inside_half_spaces(sides: Sequence[tuple[FloatArray, FloatArray]]) -> Part:
    """The part (...) of each segment that is on the right side of every half-space (Cyrus and Beck, 1978).

    sides: per half-space the signed distances (...) of the segments' starts and ends, in any unit; inside is >= 0. NaN
    has no part.
    """
    shape = np.broadcast_shapes(*(np.shape(each) for side in sides for each in side))
    low, high = np.zeros(shape), np.ones(shape)
    for start, end in sides:
        rise = end - start
        crossing = -start / np.where(rise == 0.0, 1.0, rise)
        low = np.where(rise > 0.0, np.maximum(low, crossing), low)
        high = np.where(rise < 0.0, np.minimum(high, crossing), high)
        high = np.where(((rise == 0.0) & (start < 0.0)) | np.isnan(rise), -1.0, high)
    return low, high


def on_image(camera: Camera, start: FloatArray, end: FloatArray) -> Part:
    """The part (...) of each segment between rays (..., 3) in the camera frame that the image shows.

    With a distorted lens from the first to the last bit that it shows, of at least 1/16 of the segment.
    """
    reach = _reach(camera)
    if reach is None:
        low, high = np.zeros(start.shape[:-1]), np.ones(start.shape[:-1])
    else:
        low, high = _in_frustum(reach, start, end)
    if camera.model == "pinhole" and not any(camera.distortion):
        return low, high
    some = low < high
    low[some], high[some] = _on_distorted_image(camera, start[some], end[some], low[some], high[some])
    return low, high


def on_screen(camera: Camera, start: FloatArray, end: FloatArray) -> Part:
    """The part (...) of each segment between pixels (..., 2) that is on the image."""
    sides = []
    for axis, size in ((0, camera.width_px), (1, camera.height_px)):
        sides.append((start[..., axis] + 0.5, end[..., axis] + 0.5))
        sides.append((size - 0.5 - start[..., axis], size - 0.5 - end[..., axis]))
    return inside_half_spaces(sides)


def _in_frustum(reach: FloatArray, start: FloatArray, end: FloatArray) -> Part:
    sides = []
    for axis in (0, 1):
        least, most = reach[axis]
        sides.append((start[..., axis] - least * start[..., 2], end[..., axis] - least * end[..., 2]))
        sides.append((most * start[..., 2] - start[..., axis], most * end[..., 2] - end[..., axis]))
    return inside_half_spaces(sides)


@lru_cache(maxsize=16)
def _reach(camera: Camera) -> FloatArray | None:
    """(2, 2): least and most x / z, then y / z, of rays that the camera shows; generous with a distorted lens, None
    where it may show anything.
    """
    least = -0.5
    right, bottom = camera.width_px - 0.5, camera.height_px - 0.5
    if camera.model == "pinhole" and not any(camera.distortion):
        return np.array(
            [
                [(least - camera.cx_px) / camera.fx_px, (right - camera.cx_px) / camera.fx_px],
                [(least - camera.cy_px) / camera.fy_px, (bottom - camera.cy_px) / camera.fy_px],
            ]
        )
    across, down = np.linspace(least, right, _BORDER_POINTS), np.linspace(least, bottom, _BORDER_POINTS)
    border = [np.column_stack([across, np.full_like(across, v)]) for v in (least, bottom)]
    border += [np.column_stack([np.full_like(down, u), down]) for u in (least, right)]
    rays, exist = camera.ray(np.concatenate(border))
    if not exist.all() or rays[:, 2].min() < _LEAST_AHEAD:  # it does not fill the image, or sees to its sides
        return None
    plane = rays[:, :2] / rays[:, 2:]
    low, high = plane.min(axis=0), plane.max(axis=0)
    margin = 0.02 * (high - low)  # the border bulges between the points
    return np.column_stack([low - margin, high + margin])


def _on_distorted_image(camera: Camera, start: FloatArray, end: FloatArray, low: FloatArray, high: FloatArray) -> Part:
    """The part (m,) between the first and the last sample that is on the image, exact to rounding."""

    def visible(rows: NDArray[np.intp], share: FloatArray) -> NDArray[np.bool_]:
        return camera.project(start[rows] + share[..., None] * (end[rows] - start[rows]))[1]

    count = len(start)
    rows = np.arange(count)
    grid = low[:, None] + np.linspace(0.0, 1.0, _SAMPLES) * (high - low)[:, None]
    seen = visible(np.repeat(rows, _SAMPLES), grid.ravel()).reshape(count, _SAMPLES)
    first, last = seen.argmax(axis=1), _SAMPLES - 1 - seen[:, ::-1].argmax(axis=1)
    ends = []
    for good_at, bad_at in ((first, np.maximum(first - 1, 0)), (last, np.minimum(last + 1, _SAMPLES - 1))):
        end_at = grid[rows, good_at]
        cut = np.flatnonzero(seen.any(axis=1) & (good_at != bad_at))
        good, bad = end_at[cut], grid[cut, bad_at[cut]]
        for _ in range(_HALVINGS):
            middle = 0.5 * (good + bad)
            inside = visible(cut, middle)
            good, bad = np.where(inside, middle, good), np.where(inside, bad, middle)
        end_at[cut] = good
        ends.append(end_at)
    return ends[0], np.where(seen.any(axis=1), ends[1], -1.0)
