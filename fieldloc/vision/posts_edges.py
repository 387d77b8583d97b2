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
from fieldloc.vision.posts_colour import likeness
from fieldloc.vision.turf import Turf

_LONG_SIDE_PX = 1000  # what is larger is halved, or more
_ABOVE, _BELOW = 0.16, 0.10  # of the picture's height: the band's reach from the border's highest and lowest point
_QUIET = 0.65  # of the band's pixels change less from side to side than an edge does
_LEAST_CHANGE = 8.0  # of Sobel's operator: two grey levels a pixel
_LEAST_ROWS = 4  # of the band
_STEEPEST = 0.3  # sideways per downwards: roll, and the lean that tilt gives to what is upright


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
        height, width = self.likeness.shape
        column = np.clip(np.floor((u + 0.5) / self.scale[0]).astype(np.intp), 0, width - 1)
        row = np.clip(np.floor((v - self.top + 0.5) / self.scale[1]).astype(np.intp), 0, height - 1)
        return np.asarray(self.likeness[row, column], dtype=np.float64)


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
    reduced = np.asarray(cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return Band(likeness(reduced, colour), top, np.array([across, down]))


def upright_edges(band: Band) -> tuple[Edges, Edges]:
    """Where, from left to right, a post's colour begins, and where it ends."""
    change = np.asarray(cv2.Sobel(band.likeness, cv2.CV_16S, 1, 0, ksize=3), dtype=np.int16)
    across = np.abs(np.asarray(cv2.Sobel(band.likeness, cv2.CV_16S, 0, 1, ksize=3), dtype=np.int16))
    sample = np.abs(change[::3, ::3]).ravel()
    least = max(
        _LEAST_CHANGE, float(np.partition(sample, int(_QUIET * (sample.size - 1)))[int(_QUIET * (sample.size - 1))])
    )
    return _edges(change, across, least, band), _edges(-change, across, least, band)


def _edges(change: NDArray[np.int16], across: NDArray[np.int16], least: float, band: Band) -> Edges:
    """Ridges of the change, linked from row to row and fitted by lines."""
    highest = np.asarray(cv2.dilate(change, np.ones((1, 3), dtype=np.uint8)))
    ridge = (change == highest) & (change > least) & (change > across)
    thick = cv2.dilate(ridge.view(np.uint8), np.ones((3, 1), dtype=np.uint8))  # a row may be missing
    count, labels, stats, _ = cv2.connectedComponentsWithStats(thick, connectivity=8, ltype=cv2.CV_16U)
    tall = np.flatnonzero(stats[:, cv2.CC_STAT_HEIGHT] - 2 >= _LEAST_ROWS)
    numbers = np.zeros(count, dtype=np.intp)
    numbers[tall[tall > 0]] = np.arange(1, 1 + np.count_nonzero(tall > 0))
    spots = np.flatnonzero(ridge)
    label = numbers[np.asarray(labels).ravel()[spots]]
    spots, label = spots[label > 0], label[label > 0] - 1
    v, u = np.divmod(spots, change.shape[1])
    lines, rows = _fitted(u + _peak_offset(change.ravel(), spots), v.astype(np.float64), label)
    across_px, down_px = (float(x) for x in band.scale)
    steep = np.abs(lines[:, 1]) * across_px / down_px < _STEEPEST
    lines, rows = lines[steep], rows[steep]
    # to the picture's pixels: u = (column + 0.5) across - 0.5, v = (row + 0.5) down - 0.5 + top
    slope = lines[:, 1] * across_px / down_px
    middle = (0.5 * down_px) - 0.5 + band.top
    intercept = (lines[:, 0] + 0.5) * across_px - 0.5 - slope * middle
    edges = rows * down_px + band.top - 0.5 + np.array([0.0, down_px])
    return Edges(np.stack([intercept, slope], axis=1), edges)


def _peak_offset(change: NDArray[np.int16], spots: NDArray[np.intp]) -> FloatArray:
    """(n,) where in its pixel the change is largest, by a parabola."""
    here = change[spots].astype(np.float64)
    before = change[np.maximum(spots - 1, 0)].astype(np.float64)
    after = change[np.minimum(spots + 1, change.size - 1)].astype(np.float64)
    return np.clip(0.5 * (before - after) / np.minimum(before - 2.0 * here + after, -1e-9), -0.5, 0.5)


def _fitted(u: FloatArray, v: FloatArray, label: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    """Lines (m, 2) and first and last rows (m, 2) of the groups that are straight, fitted with Cauchy weights."""
    groups = int(label.max()) + 1 if label.size else 0
    weight = np.ones_like(u)

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(label, values * weight, minlength=groups), dtype=np.float64)

    intercept = slope = np.zeros(groups)
    residual = np.zeros_like(u)
    for _ in range(3):
        mass = total(np.ones_like(u))
        mean_u, mean_v = total(u) / mass, total(v) / mass
        du, dv = u - mean_u[label], v - mean_v[label]
        slope = total(du * dv) / np.maximum(total(dv * dv), 1e-9)
        intercept = mean_u - slope * mean_v
        residual = du - slope[label] * dv
        weight = 1.0 / (1.0 + (1.5 * residual) ** 2)
    on_line = np.abs(residual) < 1.2
    first, last = np.full(groups, np.inf), np.full(groups, -np.inf)
    there, rows_there = label[on_line], v[on_line]  # rows ascend: what is written last stays
    last[there], first[there[::-1]] = rows_there, rows_there[::-1]
    rows = last - first + 1.0
    straight = (rows >= _LEAST_ROWS) & (np.bincount(label, on_line, minlength=groups) >= 0.6 * rows)
    return np.stack([intercept, slope], axis=1)[straight], np.stack([first, last], axis=1)[straight]
