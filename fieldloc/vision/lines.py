"""Straight pieces of white -> lines with both edges, width and a covariance from their own residuals."""

from dataclasses import dataclass

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.detections import SeenLine
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.profiles import measure
from fieldloc.vision.segments import Segments
from fieldloc.vision.settings import VisionSettings
from fieldloc.vision.straight import Plane
from fieldloc.vision.turf import Mask

_SPACING_PX = 1.5  # of profiles along a line
_FEWEST, _MOST = 12, 120  # profiles of a line
_EXTRA_PX = 6.0  # beyond the ends that the runs tell
_OUTLIER = 3.5  # robust standard deviations from the line
_FLOOR_PX = 0.02  # of a middle: interpolation between pixels errs by about this much, however long the line
_LEAST_SHARE = 0.35  # of the profiles between a line's ends with both edges on the line
_ROUGHEST_PX = 1.0  # standard deviation of the middles about the line, or a share of the width
_ROUGHEST_SHARE = 0.12
_BENT = 0.01  # sagitta to length: more bent, and clearly so, is no line; lenses bend less, circles more
_LAGS = 8  # profiles along the line over which residuals are correlated


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """One line's middles: place (m,) along and off (m,) across its segment, pixels of the plane; used: (m,)."""

    place: FloatArray
    off: FloatArray
    width: FloatArray
    used: Mask


def fit_lines(grey: UInt8Array, segments: Segments, plane: Plane, settings: VisionSettings) -> tuple[SeenLine, ...]:
    """Those of the segments (in the plane) that are lines in the picture `grey`, in its pixels."""
    for last in (False, True):  # once to come onto the line, once to measure
        if len(segments.ends) == 0:
            return ()
        fits = _middles(grey, segments, plane, 0.0 if not last else _EXTRA_PX, settings)
        if last:
            break
        segments = _moved(segments, fits)
    scale = min(grey.shape[1] / 640.0, grey.shape[0] / 480.0)
    kept = [row for row, fit in enumerate(fits) if _is_line(fit, settings.least_length_px * max(scale, 1.0))]
    correlation = _correlated([fits[row] for row in kept])
    return tuple(_seen(segments.ends[row], fits[row], correlation, plane) for row in kept)


def _middles(
    grey: UInt8Array, segments: Segments, plane: Plane, extra_px: float, settings: VisionSettings
) -> list[Fit]:
    lengths = segments.lengths
    counts = np.clip(((lengths + 2 * extra_px) / _SPACING_PX).astype(np.intp), _FEWEST, _MOST)
    line = np.repeat(np.arange(len(counts)), counts)
    rank = np.arange(len(line)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = rank / (counts[line] - 1.0)
    place = share * (lengths[line] + 2 * extra_px) - extra_px
    along = (segments.ends[:, 1] - segments.ends[:, 0]) / lengths[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    centres = segments.ends[line, 0] + place[:, None] * along[line]
    width = segments.width_px[line, 0] + (segments.width_px[line, 1] - segments.width_px[line, 0]) * share
    # In the picture: the normal there, and how many of its pixels one of the plane's is.
    if plane.is_picture:
        pixels, normals, zoom = centres, across[line], np.ones(len(line))
    else:
        pixels = plane.to_picture(centres)
        normals = plane.to_picture(centres + across[line]) - plane.to_picture(centres - across[line])
        zoom = 0.5 * np.hypot(normals[:, 0], normals[:, 1])
        normals = 0.5 * normals / zoom[:, None]
    found = measure(grey, pixels, normals, width * zoom)
    good = found.good & (found.step > 0.6 * settings.least_contrast)
    fits = []
    borders = np.cumsum(counts)[:-1]
    off, wide = found.middle_px / zoom, found.width_px / zoom
    for part in np.split(np.arange(len(line)), borders):
        fits.append(_fit(place[part], off[part], wide[part], good[part]))
    return fits


def _fit(place: FloatArray, off: FloatArray, width: FloatArray, good: Mask) -> Fit:
    """Leaves out middles and widths that stand apart from those of the others."""
    used = good.copy()
    for _ in range(4):
        if np.count_nonzero(used) < 6:
            break
        rest = off - _straight(place, off, used, place)
        wide = width - _straight(place, width, used, place)
        limit = _OUTLIER * max(1.4826 * _median(np.abs(rest[used])), 0.05)
        wide_limit = _OUTLIER * max(1.4826 * _median(np.abs(wide[used])), 0.1)
        now = good & (np.abs(rest) < limit) & (np.abs(wide) < wide_limit)
        if (now == used).all():
            break
        used = now
    return Fit(place, off, width, used)


def _straight(place: FloatArray, values: FloatArray, used: Mask, wanted: FloatArray) -> FloatArray:
    """The straight line through values over places, where they are used, at the places wanted."""
    x, y = place[used], values[used]
    middle, mean = x.mean(), y.mean()
    spread = float(np.sum((x - middle) ** 2))
    slope = float((x - middle) @ (y - mean)) / spread if spread > 0.0 else 0.0
    return np.asarray(mean + slope * (wanted - middle))


def _moved(segments: Segments, fits: list[Fit]) -> Segments:
    """The segments where the fits put them; those with hardly a middle stay where they are."""
    ends, widths = segments.ends.copy(), segments.width_px.copy()
    for row, fit in enumerate(fits):
        if np.count_nonzero(fit.used) < 6:
            continue
        along = ends[row, 1] - ends[row, 0]
        length = float(np.hypot(along[0], along[1]))
        across = np.array([-along[1], along[0]]) / length
        ends[row] += _straight(fit.place, fit.off, fit.used, np.array([0.0, length]))[:, None] * across
        least = 0.5 * float(np.min(fit.width[fit.used]))
        widths[row] = np.maximum(_straight(fit.place, fit.width, fit.used, np.array([0.0, length])), least)
    return Segments(ends, widths)


def _is_line(fit: Fit, least_length_px: float) -> bool:
    count = np.count_nonzero(fit.used)
    if count < 8:
        return False
    place = fit.place[fit.used]
    length = float(place[-1] - place[0])
    between = (fit.place >= place[0]) & (fit.place <= place[-1])
    if length < least_length_px or count < _LEAST_SHARE * np.count_nonzero(between):
        return False
    off, width = fit.off[fit.used], _median(fit.width[fit.used])
    rest = off - _straight(fit.place, fit.off, fit.used, place)
    rough = float(np.sqrt(np.mean(rest * rest)))
    if rough > max(_ROUGHEST_PX, _ROUGHEST_SHARE * width) or length < 1.5 * width:
        return False
    x = 2.0 * (place - place[0]) / length - 1.0
    bow = x * x - np.mean(x * x)
    sagitta = float(bow @ rest / (bow @ bow))
    noise = rough / float(np.sqrt(bow @ bow)) * 2.0  # the residuals of neighbours are alike
    return not (abs(sagitta) > _BENT * length and abs(sagitta) > 5.0 * noise)


def _correlated(fits: list[Fit]) -> float:
    """By how much residuals alike in neighbours enlarge a variance: 1 + 2 sum of all their autocorrelations."""
    products = np.zeros(_LAGS + 1)
    pairs = np.zeros(_LAGS + 1)
    for fit in fits:
        rest = np.where(fit.used, fit.off - _straight(fit.place, fit.off, fit.used, fit.place), 0.0)
        rest /= max(float(np.sqrt(np.mean(rest[fit.used] ** 2))), 1e-6)
        for lag in range(_LAGS + 1):
            ahead = slice(lag, None)
            back = slice(None, len(rest) - lag)
            products[lag] += rest[ahead] @ rest[back]
            pairs[lag] += np.count_nonzero(fit.used[ahead] & fit.used[back])
    if not fits:
        return 1.0
    shares = products / np.maximum(pairs, 1.0)
    return float(1.0 + 2.0 * np.maximum(shares[1:], 0.0).sum())


def _seen(ends: FloatArray, fit: Fit, correlation: float, plane: Plane) -> SeenLine:
    along = ends[1] - ends[0]
    along = along / np.hypot(along[0], along[1])
    across = np.array([-along[1], along[0]])
    place = fit.place[fit.used]
    at = place[[0, -1]]
    count = len(place)
    basis = np.stack([np.ones(count), place - place.mean()], axis=1)
    inverse = np.linalg.inv(basis.T @ basis)
    to_ends = np.stack([np.ones(2), at - place.mean()], axis=1)
    shape = to_ends @ inverse @ to_ends.T * correlation / (count - 2.0)
    rest = fit.off[fit.used] - _straight(fit.place, fit.off, fit.used, place)
    off = _straight(fit.place, fit.off, fit.used, at)
    points = ends[0] + at[:, None] * along + off[:, None] * across
    width = _straight(fit.place, fit.width, fit.used, at)
    wide = fit.width[fit.used] - _straight(fit.place, fit.width, fit.used, place)
    covariance = shape * float(rest @ rest)
    width_sigma = np.sqrt(shape.diagonal() * float(wide @ wide) + 2.0 * _FLOOR_PX**2)
    pixels = plane.to_picture(points)
    normals = 0.5 * (plane.to_picture(points + across) - plane.to_picture(points - across))
    zoom = np.hypot(normals[:, 0], normals[:, 1])
    normals = normals / zoom[:, None]
    covariance = covariance * np.outer(zoom, zoom) + _FLOOR_PX**2 * np.eye(2)
    full = np.zeros((4, 4))
    for row in range(2):
        tangent = np.array([-normals[row, 1], normals[row, 0]])
        block = slice(2 * row, 2 * row + 2)
        # Along it nothing is known of an end; what stands there only keeps the matrix positive.
        full[block, block] = covariance[row, row] * (np.outer(normals[row], normals[row]) + np.outer(tangent, tangent))
    full[:2, 2:] = covariance[0, 1] * np.outer(normals[0], normals[1])
    full[2:, :2] = full[:2, 2:].T
    return SeenLine(pixels, full, width * zoom, width_sigma * zoom)


def _median(values: FloatArray) -> float:
    """Much faster than NumPy's for few values."""
    return float(np.sort(values)[len(values) // 2])
