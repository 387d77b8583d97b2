"""Which part of a straight segment lies inside something, for many segments at once.

A part is a pair of shares (low, high) of the way from the segment's start to its end; low >= high where there is none.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.pose import FloatArray

_BORDER_POINTS = 33  # along each side of the image, to find how far a lens reaches
_SAMPLES = 33  # per segment with a lens
_HALVINGS = 40  # 1/32 of a segment halved so often is below rounding of the share

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

    With a distorted lens from the first to the last bit that it shows, of at least 1/32 of the segment.
    """
    if camera.model == "pinhole":
        reach = _reach(camera)
        low, high = _in_frustum(reach, start, end)
        if not any(camera.distortion):
            return low, high
    else:
        low, high = np.zeros(start.shape[:-1]), np.ones(start.shape[:-1])
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


def _reach(camera: Camera) -> FloatArray:
    """(2, 2): least and most x / z, then y / z, of rays that a pinhole camera shows; generous for a distorted one."""
    least = -0.5
    right, bottom = camera.width_px - 0.5, camera.height_px - 0.5
    if not any(camera.distortion):
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
    if not exist.all():  # the lens does not fill the image: anything in front may be on it
        return np.array([[-1e3, 1e3], [-1e3, 1e3]])
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
        good, bad = grid[rows, good_at], grid[rows, bad_at]
        for _ in range(_HALVINGS):
            middle = 0.5 * (good + bad)
            inside = visible(rows, middle)
            good, bad = np.where(inside, middle, good), np.where(inside, bad, middle)
        ends.append(good)
    nothing = ~seen.any(axis=1)
    return np.where(nothing, 0.0, ends[0]), np.where(nothing, -1.0, ends[1])
