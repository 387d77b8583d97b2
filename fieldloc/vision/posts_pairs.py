"""Pairs of upright edges between which everything has the post's colour: what may be a piece of a post."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from fieldloc.vision.posts_edges import Band, Edges
from fieldloc.vision.turf import Mask, Turf

_NARROWEST_PX = 2.0
_WIDEST = 0.12  # of the picture's width: a post at arm's length
_STEEPER = 0.05  # sideways per downwards, one edge than the other
_LEAST_OVERLAP = 0.5  # of the shorter edge
_LEAST_ROWS_PX = 8.0
_PLACES = np.array([0.25, 0.5, 0.75])  # across the inside, which begins beside the blur of its edges
_BLUR_PX = 2.0
_HEIGHTS = np.linspace(0.1, 0.9, 5)  # along what both edges share
_NEAREST = 6  # ends that go with a beginning
_MOST = 28  # pairs go on, the clearest first


@dataclass(frozen=True, slots=True, eq=False)
class Strips:
    """left, right: (n, 2) lines u = a + b v. rows: (n, 2) v from which to which both edges are seen.

    width_px: (n,). contrast: (n,) of 255, in likeness to the post's colour, against the side that is more alike.
    """

    left: FloatArray
    right: FloatArray
    rows: FloatArray
    width_px: FloatArray
    contrast: FloatArray

    def take(self, which: Mask | NDArray[np.intp]) -> "Strips":
        return Strips(self.left[which], self.right[which], self.rows[which], self.width_px[which], self.contrast[which])

    def left_at(self, v: FloatArray) -> FloatArray:
        """(n, k) u of the left edges at rows (n, k)."""
        return np.asarray(self.left[:, :1] + self.left[:, 1:] * v)

    def right_at(self, v: FloatArray) -> FloatArray:
        return np.asarray(self.right[:, :1] + self.right[:, 1:] * v)

    @property
    def aside_px(self) -> FloatArray:
        """(n,) how far beside an edge its side is looked at."""
        return np.minimum(np.maximum(0.35 * self.width_px, 2.0), 8.0)


def pairs_of(begins: Edges, ends: Edges, band: Band, turf: Turf, width_px: int) -> Strips:
    """Every pair that is narrow, parallel, and of one colour inside that neither side has."""
    i, j = _beside(begins, ends, band, width_px)
    reaches = _reaching(begins, turf)[i] | _reaching(ends, turf)[j]
    i, j = i[reaches], j[reaches]
    one, other = (_numbers(edges)[:, which] for edges, which in ((begins, i), (ends, j)))
    offset, steeper = other[:2] - one[:2]
    first, last = np.maximum(one[2], other[2]), np.minimum(one[3], other[3])
    shared = np.maximum(last - first, 1.0)
    width = offset + steeper * (0.5 * (first + last))
    fits = (width > _NARROWEST_PX) & (width < _WIDEST * width_px)
    fits &= (shared >= _LEAST_ROWS_PX) & (shared >= _LEAST_OVERLAP * np.minimum(one[4], other[4]))
    fits &= np.maximum(one[4], other[4]) > 2.0 * width
    # edges are parallel but for perspective and for what their own rows leave open
    fits &= np.abs(steeper) < _STEEPER + 2.0 / shared
    fits[fits] = _among_slimmest(i[fits], (width / shared)[fits])
    i, j, rows = i[fits], j[fits], np.stack([first[fits], last[fits]], axis=1)
    strips = Strips(begins.lines[i], ends.lines[j], rows, width[fits], np.zeros(len(i)))
    return _uniform(strips, band) if len(i) else strips


def _numbers(edges: Edges) -> FloatArray:
    """(5, n) intercept, slope, first and last row and length of edges."""
    return np.concatenate([edges.lines.T, edges.rows.T, edges.rows[None, :, 1] - edges.rows[:, 0]])


def _beside(begins: Edges, ends: Edges, band: Band, width_px: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of rows of both that are as far apart as a post's edges, at the middle of the band."""
    level = band.top + 0.5 * float(band.scale[1]) * len(band.likeness)
    slack = _STEEPER * (level - band.top)
    left, right = begins.lines @ (1.0, level), ends.lines @ (1.0, level)
    order = np.argsort(right, kind="stable")
    first = np.searchsorted(right[order], left + _NARROWEST_PX - slack)
    last = np.searchsorted(right[order], left + _WIDEST * width_px + slack)
    counts = last - first
    i = np.repeat(np.arange(len(left)), counts)
    return i, order[np.arange(len(i)) - np.repeat(np.cumsum(counts) - counts - first, counts)]


def _among_slimmest(i: NDArray[np.intp], width: FloatArray) -> Mask:
    """(n,) which of the pairs have one of the narrowest few widths of those with the same beginning i: what is of one
    colour has few edges inside."""
    order = np.lexsort((width, i))
    sorted_i = i[order]
    rank = np.arange(len(i)) - np.searchsorted(sorted_i, sorted_i)
    kept = np.zeros(len(i), dtype=np.bool_)
    kept[order] = rank < _NEAREST
    return kept


def _reaching(edges: Edges, turf: Turf) -> Mask:
    """(n,) which would come to the field's border if they went on down by their own length: the rest of an edge may be
    hidden, or before a board of the post's colour."""
    v = edges.rows[:, 1] + np.maximum(edges.rows[:, 1] - edges.rows[:, 0], 8.0) + 3.0
    u = edges.lines[:, 0] + edges.lines[:, 1] * v
    return np.asarray(turf.below_uv(u, v) > 0.0)


def _uniform(strips: Strips, band: Band) -> Strips:
    """Those of one colour inside that neither side has, the clearest first."""
    v = strips.rows[:, :1] + (strips.rows[:, 1:] - strips.rows[:, :1]) * _HEIGHTS
    left, right = strips.left_at(v), strips.right_at(v)
    aside = np.minimum(np.maximum(0.3 * strips.width_px, 1.5 * band.scale[0]), 6.0 * band.scale[0])[:, None]
    within = np.minimum(np.maximum(_BLUR_PX / strips.width_px, 0.2), 0.4)[:, None] * (right - left)
    outmost = np.array([left - aside, left + within, right - within, right + aside])
    values = band.at(outmost, v)
    contrast = np.minimum(_median(values[1] - values[0]), _median(values[2] - values[3]))
    clear = np.flatnonzero(contrast > 5.0)
    contrast, length = contrast[clear], (strips.rows[:, 1] - strips.rows[:, 0])[clear]
    begin, end = outmost[1, clear], outmost[2, clear]
    between = band.at(begin + _PLACES[:, None, None] * (end - begin), v[clear])
    inside = np.concatenate([values[1:2, clear], between, values[2:3, clear]])
    typical = _median(inside)
    level = _median(typical.T)
    unrest = _median(np.abs(inside - typical[..., None])).mean(axis=0)
    darkest = _median(inside.min(axis=0))
    brighter_side = np.maximum(_median(values[0, clear]), _median(values[3, clear]))
    good = (contrast > 0.03 * level) & (unrest < 0.35 * contrast + 4.0)
    good &= darkest > brighter_side + 0.3 * (level - brighter_side)
    score = np.where(good, contrast * np.sqrt(np.maximum(length, 0.0)), -1.0)
    keep = np.argsort(-score, kind="stable")[: min(_MOST, int(np.count_nonzero(good)))]
    kept = clear[keep]
    return Strips(strips.left[kept], strips.right[kept], strips.rows[kept], strips.width_px[kept], contrast[keep])


def _median(values: FloatArray) -> FloatArray:
    """(...,) of an odd number of values (..., k)."""
    return np.asarray(np.sort(values, axis=-1)[..., values.shape[-1] // 2])
