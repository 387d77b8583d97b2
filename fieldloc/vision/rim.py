"""The circle's line, measured across it as straight lines are."""

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from fieldloc.vision.circle import is_round
from fieldloc.vision.detections import SeenCircle
from fieldloc.vision.ellipse import PARTS, Ellipse, fit_ellipse, on_rim, parts_of
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.profiles import measure
from fieldloc.vision.settings import VisionSettings
from fieldloc.vision.straight import Plane
from fieldloc.vision.stripes import middle_shift
from fieldloc.vision.turf import Mask, Turf

_SPACING_PX = 4.0  # of the points along the circle
_FEWEST, _MOST = 24, 128  # points all around
_FARTHER = 2  # parts beyond those with runs that are measured, too
_OUTLIER = 3.5  # robust standard deviations from the ellipse
_LEAST_OUTLIER_PX = 0.7  # the middle between a circle's edges in perspective is not quite an ellipse
_FLOOR_PX = 0.03  # of a point: what interpolation between pixels errs by
_LEAST_SHARE = 0.5  # of the points where there are runs have to be on the ellipse: things stand before parts of it
_NEIGHBOURS = (np.arange(PARTS)[:, None] + np.arange(-_FARTHER, _FARTHER + 1)) % PARTS
_LEAST_ACROSS_PX = 1.5  # standard deviation of the points to either side of a straight line
_AROUND = 9  # neighbours that tell a point's standard deviation


def _part(turns: FloatArray) -> NDArray[np.intp]:
    """Which of the equal parts of the ellipse's angle turns (n,) are nearest to the middle of."""
    return np.asarray(np.rint(turns * PARTS).astype(np.intp) % PARTS)


_TURNS = (np.arange(8 * PARTS) + 0.5) / (8 * PARTS)
_COS, _SIN, _PARTS = np.cos(2.0 * np.pi * _TURNS)[:, None], np.sin(2.0 * np.pi * _TURNS)[:, None], _part(_TURNS)


def trace(
    grey: UInt8Array,
    ellipse: Ellipse,
    on: FloatArray,
    plane: Plane,
    turf: Turf,
    settings: VisionSettings,
    *,
    bent: bool,
) -> SeenCircle | None:
    """The points of the picture `grey` on the middle of the circle's line, where it is seen.

    ellipse: in the plane. on: (n, 3) the middles of white runs on it, with their widths along the scan lines.
    bent: that what is on it is bent is known already.
    """
    for spacing_px in (2.0 * _SPACING_PX, _SPACING_PX):  # once to come onto the line, once to measure
        centre, axes = ellipse.axes()
        there, widths = _widths(centre, axes, on)
        turns, part = _evenly(centre, axes, spacing_px, np.isfinite(widths))
        points, normals = on_rim(centre, axes, turns)
        pixels, across, zoom = plane.normals_in_picture(points, normals)
        in_picture = zoom * np.abs(normals).max(axis=1)  # of a width along a scan line: that across in the picture
        found = measure(grey, pixels, across, widths[part] * in_picture)
        good = found.good & (found.step > 0.6 * settings.least_contrast)
        middles = points + (found.middle_px / zoom)[:, None] * normals
        known = np.where(np.isfinite(middles), middles, 1e9)
        off, weights = ellipse.beside(known)
        fitted = None
        for _ in range(2):
            fitted = fit_ellipse(middles[good], weights[good])
            if fitted is None:
                return None
            ellipse = fitted
            off, weights = ellipse.beside(known)
            spread = 1.4826 * float(np.sort(np.abs(off[good]))[np.count_nonzero(good) // 2])
            good &= np.abs(off) < max(_OUTLIER * spread, _LEAST_OUTLIER_PX)
        if np.count_nonzero(good & there[part]) < max(_FEWEST // 2, _LEAST_SHARE * np.count_nonzero(there[part])):
            return None
        # In glare a run may be but the whitest part of the line: what was measured near by is its width.
        on = np.column_stack([middles, found.width_px / in_picture])[good]
    # Measured to a fraction of a pixel, two straight lines that run along an ellipse are straight.
    if not bent and not _is_round(ellipse, middles, good):
        return None
    pixels, across = pixels[good], across[good]
    pixels = pixels + found.middle_px[good, None] * across
    shift, unsure = middle_shift(pixels, across, found.width_px[good], turf, grey.shape[0])
    sigma = np.hypot(np.sqrt(_local(off[good] ** 2) + _FLOOR_PX**2) * zoom[good], unsure)
    centre, axes = ellipse.axes()
    lengths = np.hypot(axes[:, 0], axes[:, 1])
    angle = float(np.arctan2(axes[0, 1], axes[0, 0]))
    numbers = np.array([*centre, *lengths, angle])
    return SeenCircle(pixels + shift[:, None] * across, sigma, numbers)


def _is_round(ellipse: Ellipse, middles: FloatArray, good: Mask) -> bool:
    table = np.column_stack([middles, np.zeros(len(middles))])[good]
    gaps = np.flatnonzero(np.diff(np.flatnonzero(good)) > 2) + 1
    aside = float(np.sqrt(max(np.linalg.eigvalsh(np.cov(table[:, :2].T))[0], 0.0)))
    return aside >= _LEAST_ACROSS_PX and is_round(ellipse, [part for part in np.split(table, gaps) if len(part) > 2])


def _evenly(centre: FloatArray, axes: FloatArray, spacing_px: float, seen: Mask) -> tuple[FloatArray, NDArray[np.intp]]:
    """Turns of the ellipse's own angle at which points are about evenly spaced on it, in its parts that are seen; and
    which parts these are.
    """
    speed = np.hypot(*(_COS * axes[1] - _SIN * axes[0]).T)
    path = np.concatenate([[0.0], np.cumsum(np.where(seen[_PARTS], speed, 0.0))])  # what is not seen has no length
    count = int(np.clip(path[-1] * 2.0 * np.pi / (len(speed) * spacing_px), _FEWEST, _MOST))
    turns = np.interp((np.arange(count) + 0.5) * path[-1] / count, path, np.linspace(0.0, 1.0, len(path)))
    part = _part(turns)
    return turns[seen[part]], part[seen[part]]


def _widths(centre: FloatArray, axes: FloatArray, on: FloatArray) -> tuple[Mask, FloatArray]:
    """Per part of the ellipse's angle whether there are runs, and their mean width; in the parts next to those with
    runs that of their neighbours, as the line goes on there where it crosses another; NaN elsewhere.
    """
    part = parts_of(centre, axes, on[:, :2])
    both = np.array([np.bincount(part, weights=on[:, 2], minlength=PARTS), np.bincount(part, minlength=PARTS)])
    there = both[1] > 0
    total, count = np.where(there, both, both[:, _NEIGHBOURS].sum(axis=2))
    return there, np.where(count > 0, total / np.maximum(count, 1.0), np.nan)


def _local(square: FloatArray) -> FloatArray:
    """The mean over each point's neighbours."""
    kernel = np.ones(min(_AROUND, len(square)))
    return np.asarray(np.convolve(square, kernel, mode="same") / np.convolve(np.ones(len(square)), kernel, mode="same"))
