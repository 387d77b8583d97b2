"""Straight pieces of white -> lines with both edges, width and a covariance from their own residuals.

A line's middle is that of the stripe on the ground (`fieldloc.vision.stripes`), nearly half way between its edges.
"""

from dataclasses import dataclass

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.detections import SeenLine
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.profiles import measure
from fieldloc.vision.segments import Segments
from fieldloc.vision.settings import VisionSettings
from fieldloc.vision.straight import Plane
from fieldloc.vision.stripes import middle_shift
from fieldloc.vision.turf import Mask, Turf

_COARSE_PX, _SPACING_PX = 4.0, 1.5  # of profiles along a line, to come onto it and to measure it
LEAST_WIDTHS = 1.5  # a line's length at least
_CUT = 0.5  # of the least length, and of its width: what is seen of one between the picture's border and another line
_FEWEST, _MOST = 12, 120  # profiles of a line
_EXTRA_PX = 6.0  # beyond the ends that the runs tell
_LEAST_USED = 8  # profiles with both edges on the line
_LEAST_SHARE = 0.55  # of the profiles between a line's ends that are not on something else than turf
_LEAST_SMOOTH, _SMOOTH_PX = 0.3, 0.3  # of a line whose middles are hardly rough: what is so straight is worn or pale
_LEAST_SEEN = 0.25  # of all between
_OUTLIER = 3.5  # robust standard deviations from the line
_LEAST_TYPICAL_PX = np.array([[0.05], [0.1]])  # of middles and of widths
_FLOOR_PX, _FLOOR_SHARE = (
    0.01,
    0.0015,
)  # of an end, and of the width: what pixels, their interpolation, JPEG and wear err
# by, however long the line
_ENDS_PX2 = 2.0  # and by its length: what a line ends at moves its last middles, which count the more the shorter it is
_ROUGHEST_PX = 1.0  # standard deviation of the middles about the line, or a share of the width
_ROUGHEST_SHARE = 0.12
_BENT_SIGMAS, _LEAST_BENT_PX = 5.0, 0.25  # a line's sagitta is less than so many standard deviations, or than this:
# taper in perspective, another line at one end and the picture's border bend by tenths of a pixel
_BENT = 0.01  # sagitta to length: a lens bends less, unless it is known; what bends less is a line
_LAGS = 8  # profiles along the line over which residuals are correlated


@dataclass(frozen=True, slots=True, eq=False)
class Middles:
    """Of n lines up to m middles each, in pixels of the plane: place along a line from its first end, off across it,
    width; (n, m) each. used: (n, m) whether it is one. bare: (n, m) where there is turf instead.
    """

    place: FloatArray
    off: FloatArray
    width: FloatArray
    used: Mask
    bare: Mask

    def fit(self, values: FloatArray) -> "Straight":
        """The straight lines through values (..., n, m) over places, by least squares."""
        count = np.maximum(np.count_nonzero(self.used, axis=1), 1)
        middle = (self.place * self.used).sum(axis=1) / count
        away = (self.place - middle[:, None]) * self.used
        slope = (away * values).sum(axis=-1) / np.maximum((away * away).sum(axis=1), 1e-9)
        return Straight(middle, (values * self.used).sum(axis=-1) / count, slope)

    def rest(self, values: FloatArray) -> FloatArray:
        """(..., n, m) what is left of the values, 0 where not used."""
        return np.asarray((values - self.fit(values).at(self.place)) * self.used)


@dataclass(frozen=True, slots=True, eq=False)
class Straight:
    """Of n lines the middle of the places (n,), and what is fitted: its value there and its slope, (..., n) each."""

    middle: FloatArray
    value: FloatArray
    slope: FloatArray

    def at(self, places: FloatArray) -> FloatArray:
        """(..., n, k) at places (n, k)."""
        return np.asarray(self.value[..., None] + self.slope[..., None] * (places - self.middle[:, None]))


def least_length(shape: tuple[int, ...], settings: VisionSettings) -> float:
    """In pixels, of a line in a picture of that shape (h, w)."""
    return settings.least_length_px * max(1.0, min(shape[1] / 640.0, shape[0] / 480.0))


def fit_lines(
    grey: UInt8Array, segments: Segments, plane: Plane, turf: Turf, settings: VisionSettings
) -> tuple[tuple[SeenLine, ...], list[FloatArray]]:
    """Those of the segments (in the plane) that are lines in the picture `grey`, in its pixels; and those that would be
    but for their bend, as middles with the width there (m, 3), in the plane.
    """
    if len(segments.ends) == 0:
        return (), []
    if settings.finder != "runs" or not plane.is_picture:  # runs are between pixels already
        segments = _moved(segments, _middles(grey, segments, plane, turf, _COARSE_PX, 0.0, settings))
    found = _middles(grey, segments, plane, turf, _SPACING_PX, _EXTRA_PX, settings)
    height, width = grey.shape[:2]
    bent_px = _BENT * segments.lengths
    if plane.camera is not None:  # what its distortion leaves is less the shorter a part of a line
        bent_px = bent_px * segments.lengths / width
    least_px = least_length(grey.shape, settings)
    like_lines, straight = _are_lines(found, _CUT * least_px, bent_px)
    short = like_lines & ~straight & (segments.lengths < least_px)
    if short.any():  # of what is so short the other line at its end is a large part
        own = (found.place >= 0.0) & (found.place <= segments.lengths[:, None])
        inner = Middles(found.place, found.off, found.width, found.used & (own | ~short[:, None]), found.bare)
        like_inner, straight_inner = _are_lines(inner, _CUT * least_px, bent_px)
        better = short & like_inner & straight_inner
        used = np.where(better[:, None], inner.used, found.used)
        found, straight = Middles(found.place, found.off, found.width, used, found.bare), straight | better
    bent = like_lines & ~straight & ~short
    arcs = [_curve(segments.ends[row], found, row) for row in np.flatnonzero(bent).tolist()]
    kept = like_lines & straight
    found = Middles(found.place[kept], found.off[kept], found.width[kept], found.used[kept], found.bare[kept])
    return (_seen(segments.ends[kept], found, plane, turf, height) if kept.any() else ()), arcs


def _curve(ends: FloatArray, found: Middles, row: int) -> FloatArray:
    """(m, 3) the middles of one of the segments, whose ends (2, 2) are these, in the plane, and the widths there."""
    used = found.used[row]
    along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    across = np.array([-along[1], along[0]])
    points = ends[0] + found.place[row, used, None] * along + found.off[row, used, None] * across
    return np.column_stack([points, found.width[row, used]])


def _middles(
    grey: UInt8Array,
    segments: Segments,
    plane: Plane,
    turf: Turf,
    spacing_px: float,
    extra_px: float,
    settings: VisionSettings,
) -> Middles:
    lengths = segments.lengths + 2.0 * extra_px
    counts = np.clip((lengths / spacing_px).astype(np.intp), _FEWEST, _MOST)
    real = np.arange(counts.max()) < counts[:, None]
    share = np.arange(counts.max()) / (counts[:, None] - 1.0)
    place = share * lengths[:, None] - extra_px
    row = np.nonzero(real)[0]
    along = (segments.ends[:, 1] - segments.ends[:, 0]) / segments.lengths[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)[row]
    centres = segments.ends[row, 0] + place[real][:, None] * along[row]
    width = (segments.width_px[:, :1] + (segments.width_px[:, 1:] - segments.width_px[:, :1]) * share)[real]
    pixels, normals, zoom = plane.normals_in_picture(centres, across)
    profiles = measure(grey, pixels, normals, width * zoom)
    off, wide = np.zeros(real.shape), np.zeros(real.shape)
    used, bare = np.zeros(real.shape, dtype=np.bool_), np.zeros(real.shape, dtype=np.bool_)
    on = profiles.good & (profiles.step > 0.6 * settings.least_contrast)
    off[real], wide[real] = np.where(on, [profiles.middle_px / zoom, profiles.width_px / zoom], 0.0)
    used[real] = on
    bare[real] = turf.at(pixels)
    return _without_outliers(Middles(place, off, wide, used, bare))


def _without_outliers(found: Middles) -> Middles:
    """Leaves out middles and widths that stand apart from those of the same line."""
    good, values = found.used, np.array([found.off, found.width])
    for _ in range(4):
        count = np.count_nonzero(found.used, axis=1)
        off = np.abs(values - found.fit(values).at(found.place))
        ranked = np.sort(np.where(found.used, off, np.inf), axis=-1)
        typical = 1.4826 * ranked[:, np.arange(len(count)), np.maximum(count - 1, 0) // 2]
        now = good & (off < _OUTLIER * np.maximum(typical, _LEAST_TYPICAL_PX)[..., None]).all(axis=0)
        now[count < _LEAST_USED] = False
        if (now == found.used).all():
            break
        found = Middles(found.place, found.off, found.width, now, found.bare)
    return found


def _moved(segments: Segments, found: Middles) -> Segments:
    """The segments where their middles put them; those with hardly a middle stay where they are."""
    along = segments.ends[:, 1] - segments.ends[:, 0]
    lengths = segments.lengths
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / lengths[:, None]
    ends = np.stack([np.zeros(len(lengths)), lengths], axis=1)
    off, width = found.fit(np.array([found.off, found.width])).at(ends)
    some = found.used.sum(axis=1) >= _LEAST_USED
    width = np.where(some[:, None], np.maximum(width, 0.5 * segments.width_px), segments.width_px)
    off = np.where(some[:, None], off, 0.0)
    return Segments(segments.ends + off[:, :, None] * across[:, None], width)


def _ends_of(found: Middles) -> FloatArray:
    """(n, 2) the places of the first and the last middle."""
    first = np.where(found.used, found.place, np.inf).min(axis=1)
    last = np.where(found.used, found.place, -np.inf).max(axis=1)
    return np.stack([first, last], axis=1)


def _are_lines(found: Middles, least_length_px: float, bent_px: FloatArray) -> tuple[Mask, Mask]:
    """(n,) which are long, smooth and gapless enough, and which are straight; bent_px: (n,) what a lens may bend."""
    count = np.count_nonzero(found.used, axis=1)
    some = count >= _LEAST_USED
    ends = np.where(some[:, None], _ends_of(found), 0.0)
    length = ends[:, 1] - ends[:, 0]
    between = (found.place >= ends[:, :1]) & (found.place <= ends[:, 1:])
    bare = np.count_nonzero(between & found.bare & ~found.used, axis=1)
    x = 2.0 * (found.place - ends[:, :1]) / np.maximum(length, 1.0)[:, None] - 1.0
    rest, bow = found.rest(np.array([found.off, x * x]))
    count = np.maximum(count, 1)
    # A parabola beside the straight line: what is left of the middles then is their noise, alike in neighbours.
    power = np.maximum((bow * bow).sum(axis=1), 1e-9)
    sagitta = (bow * rest).sum(axis=1) / power
    rest = rest - sagitta[:, None] * bow
    rough = np.sqrt((rest * rest).sum(axis=1) / count)
    noise = rough * np.sqrt(_correlation(rest, found.used) / power)
    straight = np.abs(sagitta) <= np.maximum(np.maximum(_BENT_SIGMAS * noise, _LEAST_BENT_PX), bent_px)
    width = (found.width * found.used).sum(axis=1) / count
    smooth = rough <= np.maximum(_ROUGHEST_PX, _ROUGHEST_SHARE * width)
    long = length >= np.maximum(least_length_px, _CUT * width)
    share = np.where(rough < _SMOOTH_PX, _LEAST_SMOOTH, _LEAST_SHARE)
    whole = (count >= share * (count + bare)) & (count >= _LEAST_SEEN * np.count_nonzero(between, axis=1))
    return np.asarray(some & long & smooth & whole), np.asarray(straight)


def _correlation(rest: FloatArray, used: Mask) -> float:
    """By how much residuals alike in neighbours enlarge a variance: 1 + 2 sum of all lines' autocorrelations."""
    typical = np.sqrt((rest * rest).sum(axis=1) / np.maximum(used.sum(axis=1), 1))
    # One line after another with room between them, so that a shifted line meets none but itself.
    table = np.zeros((2, len(rest), rest.shape[1] + _LAGS))
    table[0, :, : rest.shape[1]], table[1, :, : rest.shape[1]] = rest / np.maximum(typical, 1e-6)[:, None], used
    together, pairs = (np.correlate(np.append(row, np.zeros(_LAGS)), row)[1:] for row in table.reshape(2, -1))
    return 1.0 + 2.0 * float((np.maximum(together, 0.0) / np.maximum(pairs, 1.0)).sum())


def _seen(ends: FloatArray, found: Middles, plane: Plane, turf: Turf, height: int) -> tuple[SeenLine, ...]:
    along = ends[:, 1] - ends[:, 0]
    along = along / np.hypot(along[:, :1], along[:, 1:])
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    at = _ends_of(found)
    count = found.used.sum(axis=1)
    values = np.array([found.off, found.width])
    line = found.fit(values)
    rest, wide = (values - line.at(found.place)) * found.used
    off_at, width_at = line.at(at)
    # Least squares of a straight line: the covariance of its values at the ends, for a variance of 1 of each middle.
    spread = (((found.place - line.middle[:, None]) * found.used) ** 2).sum(axis=1)
    away = at - line.middle[:, None]
    shape = 1.0 / count[:, None, None] + away[:, :, None] * away[:, None, :] / spread[:, None, None]
    shape = shape * _correlation(rest, found.used) / (count - 2.0)[:, None, None]
    covariance = shape * (rest * rest).sum(axis=1)[:, None, None]
    width_variance = shape.diagonal(axis1=1, axis2=2) * (wide * wide).sum(axis=1)[:, None] + 2.0 * _FLOOR_PX**2
    points = ends[:, :1] + at[:, :, None] * along[:, None] + off_at[:, :, None] * across[:, None]
    pixels, normals, zoom = plane.normals_in_picture(points, np.broadcast_to(across[:, None], points.shape))
    widths = np.maximum(width_at, 0.0) * zoom
    shift, unsure = middle_shift(pixels, normals, widths, turf, height)
    pixels = pixels + shift[..., None] * normals
    covariance = covariance * zoom[:, :, None] * zoom[:, None, :]
    floor = _FLOOR_PX**2 + (_FLOOR_SHARE * widths) ** 2 + (_ENDS_PX2 / np.maximum(at[:, 1:] - at[:, :1], 1.0)) ** 2
    covariance += floor[:, :, None] * np.eye(2)
    covariance += unsure[:, :, None] * unsure[:, None, :]
    # Along it nothing is known of an end; what stands there, as much as across it, only keeps the matrix positive.
    tangents = np.stack([-normals[..., 1], normals[..., 0]], axis=-1)
    full = covariance[:, :, None, :, None] * normals[:, :, :, None, None] * normals[:, None, None]
    own = covariance.diagonal(axis1=1, axis2=2)[:, :, None, None] * tangents[:, :, :, None] * tangents[:, :, None]
    full[:, 0, :, 0] += own[:, 0]
    full[:, 1, :, 1] += own[:, 1]
    full = full.reshape(-1, 4, 4)
    sigmas = np.sqrt(width_variance) * zoom
    return tuple(SeenLine(*row) for row in zip(pixels, full, widths, sigmas, strict=True))
