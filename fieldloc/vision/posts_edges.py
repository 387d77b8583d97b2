"""Upright edges where a picture changes to a post's colour and back, as straight pieces.

A goal post crosses the field's upper border, so only a band about that border is searched, at half its height: what is
upright loses nothing by it, and noise is averaged.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fieldloc.colours import Colour
from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.posts_colour import likeness, nearest
from fieldloc.vision.turf import Turf

_LONG_SIDE_PX = 1000  # what is larger is halved, or more
_ABOVE, _BELOW = 0.16, 0.10  # of the picture's height: the band's reach from the border's highest and lowest point
_QUIET = 0.75  # of the band's pixels change less from side to side than an edge does
_LEAST_CHANGE = 8.0  # of Sobel's operator: two grey levels a pixel
_LEAST_ROWS = 4  # of the band
_MOST = 200  # edges of a kind, the clearest
_STEEPEST = 0.3  # sideways per downwards: roll, and the lean that tilt gives to what is upright


Labels = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """lines: (n, 2) intercept and slope of u = a + b v, picture's pixels. rows: (n, 2) the first and the last v."""

    lines: FloatArray
    rows: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Rows of the picture from top on, reduced by scale (across, down), as likeness to a post's colour."""

    likeness: UInt8Array
    top: int
    scale: NDArray[np.intp]

    def at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """The likeness at points of the picture; those beside the band take the nearest of it."""
        column, row = (u + 0.5) / self.scale[0] - 0.5, (v - self.top + 0.5) / self.scale[1] - 0.5
        return nearest(self.likeness, column, row).astype(np.float64)


def band_about(picture: UInt8Array, turf: Turf, colour: Colour) -> Band | None:
    """The part of the picture in which posts meet the field's border; None where there is no field, or no room."""
    if turf.boundary_px is None:
        return None
    height, width = picture.shape[:2]
    across = max(1, round(max(height, width) / _LONG_SIDE_PX))
    down = 2 * across
    border = np.clip(turf.boundary_px[:, 1], 0, height - 1)
    top = max(0, int(border.min() - _ABOVE * height))
    rows = min(height - top, int(border.max() + _BELOW * height) - top + 1) // down
    columns = width // across
    if rows < _LEAST_ROWS or columns < _LEAST_ROWS:
        return None
    part = picture[top : top + rows * down, : columns * across]
    if across > 1:
        part = np.asarray(cv2.resize(part, (columns, 2 * rows), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    reduced = np.asarray(cv2.addWeighted(part[::2], 0.5, part[1::2], 0.5, 0.0), dtype=np.uint8)
    return Band(likeness(reduced, colour), top, np.array([across, down]))


def upright_edges(band: Band) -> tuple[Edges, Edges]:
    """Where, from left to right, a post's colour begins, and where it ends."""
    change, downwards = (np.asarray(one, dtype=np.int16) for one in cv2.spatialGradient(band.likeness))
    across = np.abs(downwards)
    sample = np.abs(change[::3, ::3]).ravel()
    quiet = int(_QUIET * (sample.size - 1))
    least = max(_LEAST_CHANGE, float(np.searchsorted(np.cumsum(np.bincount(sample)), quiet, side="right")))
    parts = [_ridges(change, across, least), _ridges(-change, across, least)]
    count = int(parts[0][2].max(initial=-1)) + 1
    u, v = (np.concatenate([part[n] for part in parts]) for n in (0, 1))
    lines, rows, label = _pieces(u, v, np.concatenate([parts[0][2], parts[1][2] + count]))
    across_px, down_px = (float(x) for x in band.scale)
    steep = np.abs(lines[:, 1]) * across_px / down_px < _STEEPEST
    lines, rows, ending = lines[steep], rows[steep], label[steep] >= count
    # to the picture's pixels: u = (column + 0.5) across - 0.5, v = (row + 0.5) down - 0.5 + top
    slope = lines[:, 1] * across_px / down_px
    middle = (0.5 * down_px) - 0.5 + band.top
    lines = np.stack([(lines[:, 0] + 0.5) * across_px - 0.5 - slope * middle, slope], axis=1)
    rows = rows * down_px + band.top - 0.5 + np.array([0.0, down_px])
    return Edges(lines[~ending], rows[~ending]), Edges(lines[ending], rows[ending])


def _ridges(
    change: NDArray[np.int16], across: NDArray[np.int16], least: float
) -> tuple[FloatArray, FloatArray, Labels]:
    """Columns and rows (n,) of the ridges of the change, and which of those linked from row to row each is of."""
    highest = np.asarray(cv2.dilate(change, np.ones((1, 3), dtype=np.uint8)))
    ridge = (change == highest) & (change > across) & (change > np.int16(least))
    thick = cv2.dilate(ridge.view(np.uint8), np.ones((3, 1), dtype=np.uint8))  # a row may be missing
    count, labels = cv2.connectedComponents(thick, connectivity=8, ltype=cv2.CV_16U)
    spots = np.flatnonzero(ridge)
    label = np.asarray(labels).take(spots)
    v = spots // change.shape[1]
    first, last = np.zeros(count, dtype=np.intp), np.zeros(count, dtype=np.intp)
    last[label], first[label[::-1]] = v, v[::-1]  # rows ascend: what is written last stays
    tall = last - first + 1 >= _LEAST_ROWS
    tall[0] = False
    number = np.cumsum(tall) - 1
    kept = tall[label]
    spots, v = spots[kept], v[kept]
    label, count = number[label[kept]], int(np.count_nonzero(tall))
    flat = change.ravel()
    if count > _MOST:  # what changes by much over many rows is clearest
        clear = np.bincount(label, flat[spots], minlength=count) / np.sqrt(np.bincount(label, minlength=count))
        most = clear >= np.partition(clear, count - _MOST)[count - _MOST]
        kept, number = most[label], np.cumsum(most) - 1
        spots, v, label = spots[kept], v[kept], number[label[kept]]
    return spots - v * change.shape[1] + _peak_offset(flat, spots), v.astype(np.float64), label


def _peak_offset(change: NDArray[np.int16], spots: NDArray[np.intp]) -> FloatArray:
    """(n,) where in its pixel the change is largest, by a parabola."""
    here = change[spots].astype(np.float64)
    before = change[np.maximum(spots - 1, 0)].astype(np.float64)
    after = change[np.minimum(spots + 1, change.size - 1)].astype(np.float64)
    return np.clip(0.5 * (before - after) / np.minimum(before - 2.0 * here + after, -1e-9), -0.5, 0.5)


def _pieces(u: FloatArray, v: FloatArray, label: Labels) -> tuple[FloatArray, FloatArray, Labels]:
    """As `_fitted`, of what is not straight, as it is bent or goes over into something else, the upper and the lower
    half by themselves."""
    lines, rows, straight = _fitted(u, v, label)
    groups = int(label.max()) + 1 if label.size else 0
    count = np.bincount(label, minlength=groups)
    bent = count >= 3 * _LEAST_ROWS
    bent[straight] = False
    rest = bent[label]
    if not rest.any():
        return lines, rows, straight
    u, v, label = u[rest], v[rest], label[rest]
    middle = np.bincount(label, v, minlength=groups) / np.maximum(count, 1)
    halves = _fitted(u, v, 2 * label + (v > middle[label]))
    return (
        np.concatenate([lines, halves[0]]),
        np.concatenate([rows, halves[1]]),
        np.concatenate([straight, halves[2] // 2]),
    )


def _fitted(u: FloatArray, v: FloatArray, label: Labels) -> tuple[FloatArray, FloatArray, Labels]:
    """Lines (m, 2), first and last rows (m, 2) and labels (m,) of the groups that are straight, fitted with Cauchy
    weights; each group's rows ascend."""
    groups = int(label.max()) + 1 if label.size else 0
    weight: FloatArray | None = None

    def total(values: FloatArray) -> FloatArray:
        weighted = values if weight is None else values * weight
        return np.asarray(np.bincount(label, weighted, minlength=groups), dtype=np.float64)

    intercept = slope = np.zeros(groups)
    residual = np.zeros_like(u)
    rough = np.bincount(label, minlength=groups)
    middle_v = np.bincount(label, v, minlength=groups) / np.maximum(rough, 1)
    middle_u = np.bincount(label, u, minlength=groups) / np.maximum(rough, 1)
    dv, du = v - middle_v[label], u - middle_u[label]
    for _ in range(2):
        mass = np.maximum(rough if weight is None else np.bincount(label, weight, minlength=groups), 1e-9)
        sum_v, sum_u = (total(dv), total(du)) if weight is not None else (0.0, 0.0)
        slope = (total(du * dv) - sum_u * sum_v / mass) / np.maximum(total(dv * dv) - sum_v**2 / mass, 1e-9)
        intercept = (sum_u - slope * sum_v) / mass
        residual = du - (intercept[label] + slope[label] * dv)
        weight = 1.0 / (1.0 + (1.5 * residual) ** 2)
    on_line = np.abs(residual) < 1.2
    first, last = np.full(groups, np.inf), np.full(groups, -np.inf)
    there, rows_there = label[on_line], v[on_line]  # rows ascend: what is written last stays
    last[there], first[there[::-1]] = rows_there, rows_there[::-1]
    rows = last - first + 1.0
    straight = (rows >= _LEAST_ROWS) & (np.bincount(label, on_line, minlength=groups) >= 0.6 * rows)
    lines = np.stack([middle_u + intercept - slope * middle_v, slope], axis=1)
    return lines[straight], np.stack([first, last], axis=1)[straight], np.flatnonzero(straight)
