"""Lines: the plane through the camera and a line of the ground, in which the rays to both ends of a seen one lie."""

from dataclasses import dataclass

import numpy as np

from fieldloc.locate.cameras import COLUMNS, ERROR, FAR_PX, FOCAL, Cameras, IntArray, clipped, not_zero
from fieldloc.pose import FloatArray

_THREAD_PX = 2.2  # so wide do a lens and a camera's colour pattern make a thread: 1.7 px to 2.6
_LEAST_SLOPE = 0.3  # of a width's change with that of what is painted: where all is blur, what is seen still pulls


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Every end seen beside every line of the map. rays: (k, l, 2, 3) in the field; down: (k, l, 2) how much they point
    down; off: (k, l, 2, m) how far they are from the plane through the camera and each line, slope: (k, l, 2, m) its
    change with a pixel."""

    rays: FloatArray
    down: FloatArray
    off: FloatArray
    slope: FloatArray

    @staticmethod
    def of(cameras: Cameras) -> "Lines":
        shape, both = cameras.shape, cameras.line_ends
        normals = _normals(cameras, shape.starts, shape.directions).transpose(0, 2, 1)
        rays, across = both[:, :, 0], both[:, :, 1]
        size = (*rays.shape[:-1], len(shape.starts))
        off, slope = ((part.reshape(size[0], -1, 3) @ normals).reshape(size) for part in (rays, across))
        return Lines(rays, -rays[..., 2], off, slope)


def _normals(cameras: Cameras, starts: FloatArray, directions: FloatArray) -> FloatArray:
    """(k, m, 3) of the planes through the camera and lines (m, 2) or (k, m, 2) of the map, as long as the camera is off
    the line."""
    dx, dy = directions[..., 0], directions[..., 1]
    away_x, away_y = starts[..., 0] - cameras.centre[:, :1], starts[..., 1] - cameras.centre[:, 1:2]
    height = cameras.centre[:, 2:]
    out = np.empty((*away_x.shape, 3))
    out[..., 0], out[..., 1], out[..., 2] = height * dy, -height * dx, away_x * dy - away_y * dx
    return out


def line_rows(cameras: Cameras, match: IntArray) -> tuple[FloatArray, FloatArray]:
    """Of each seen line to its match (k, l): rows (k, l, 2, 2, 8), pixels per metre (k, l, 2).

    First of both ends, in px, then of the widths there: the logarithm of what is seen to what is expected, which is
    never less than blur makes of a thread; of no meaning where it is not seen.
    """
    sight, shape, size = cameras.sight, cameras.shape, match.shape
    directions, both = shape.directions[match], cameras.line_ends
    normals = _normals(cameras, shape.starts[match], directions)
    off = (both.reshape(*size, 4, 3) @ normals[..., None]).reshape(*size, 2, 2)
    slope = not_zero(off[:, :, 1])
    down = -both[:, :, 0, :, 2]
    per_m = np.abs(down / slope)
    # an error's change with the normal is ray / slope, and the normal changes with the centre and with turns
    by_state = np.zeros((*size, 3, 6))
    by_state[..., 2, 1], by_state[..., 0, 3] = directions[..., 0], directions[..., 1]
    by_state[..., 2, 0], by_state[..., 1, 3] = -directions[..., 1], -directions[..., 0]
    turned = (normals @ _crossing(cameras.axes)).reshape(*size, 3, 3)
    by_state[..., 2], by_state[..., 4:] = turned[..., 0], turned[..., 1:]
    out = np.empty((*size, 2, 2, COLUMNS))
    scaled = both / slope[:, :, None, :, None]
    out[..., :6] = (scaled.reshape(*size, 4, 3) @ by_state).reshape(*size, 2, 2, 6)
    # a width is one over the depth, too, which changes as the ray turns: rays x up
    level = both[:, :, 0, :, :2] / np.maximum(down, 1e-3)[..., None]
    by_up = np.stack([-cameras.axes[:, 1:, 1], cameras.axes[:, 1:, 0]], axis=1)
    out[:, :, 1, :, 4:6] += (level.reshape(size[0], -1, 2) @ by_up).reshape(*size, 2, 2)
    painted = np.minimum(per_m * shape.line_width_m, FAR_PX)
    expected2 = painted * painted + _THREAD_PX**2
    out[:, :, 1, :, :6] *= np.maximum(1.0 - _THREAD_PX**2 / expected2, _LEAST_SLOPE)[..., None]
    out[..., FOCAL] = sight.line_by_focal
    out[:, :, 0, :, ERROR] = clipped(off[:, :, 0] / slope)
    out[:, :, 1, :, ERROR] = sight.log_widths - 0.5 * np.log(expected2)
    return out, per_m


_CROSS = np.zeros((3, 3, 3))  # of an axis' coordinate, of a vector's, of their cross product's
for _a, _b, _c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _CROSS[_b, _a, _c], _CROSS[_a, _b, _c] = 1.0, -1.0


def _crossing(axes: FloatArray) -> FloatArray:
    """(k, 3, 9): vectors times that are their cross products with the three axes (k, 3, 3), by coordinate, axis."""
    all_of = (axes.reshape(-1, 3) @ _CROSS.reshape(3, 9)).reshape(-1, 3, 3, 3)
    return all_of.transpose(0, 2, 3, 1).reshape(-1, 3, 9)
