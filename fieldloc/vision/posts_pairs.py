"""Pairs of upright edges between which everything has the post's colour: what may be a piece of a post."""

from dataclasses import dataclass, fields, replace

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
_PLACES = np.linspace(-1.0, 1.0, 5)  # across the inside, which begins beside the blur of its edges
_BLUR_PX = 2.0
_HEIGHTS = np.linspace(0.1, 0.9, 5)  # along what both edges share
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
        return Strips(*(getattr(self, field.name)[which] for field in fields(self)))

    def left_at(self, v: FloatArray) -> FloatArray:
        """(n, k) u of the left edges at rows (n, k)."""
        return np.asarray(self.left[:, :1] + self.left[:, 1:] * v)

    def right_at(self, v: FloatArray) -> FloatArray:
        return np.asarray(self.right[:, :1] + self.right[:, 1:] * v)

    @property
    def aside_px(self) -> FloatArray:
        """(n,) how far beside an edge its side is looked at."""
        return np.clip(0.35 * self.width_px, 2.0, 8.0)


def pairs_of(begins: Edges, ends: Edges, band: Band, turf: Turf, width_px: int) -> Strips:
    """Every pair that is narrow, parallel, and of one colour inside that neither side has."""
    reaches = _reaching(begins, turf)[:, None] | _reaching(ends, turf)
    # nearly all pairs fall out by where they are, told at the middle of the band
    level = band.top + 0.5 * float(band.scale[1]) * len(band.likeness)
    apart = (ends.lines @ (1.0, level)) - (begins.lines @ (1.0, level))[:, None]
    slack = _STEEPER * (level - band.top)
    i, j = np.nonzero(reaches & (apart > _NARROWEST_PX - slack) & (apart < _WIDEST * width_px + slack))
    rows = np.stack(
        [np.maximum(begins.rows[i, 0], ends.rows[j, 0]), np.minimum(begins.rows[i, 1], ends.rows[j, 1])], axis=1
    )
    shared = rows[:, 1] - rows[:, 0]
    difference = ends.lines[j] - begins.lines[i]
    width = difference[:, 0] + difference[:, 1] * rows.mean(axis=1)
    lengths = np.stack([begins.rows[i, 1] - begins.rows[i, 0], ends.rows[j, 1] - ends.rows[j, 0]])
    fits = (width > _NARROWEST_PX) & (width < _WIDEST * width_px)
    fits &= (shared >= _LEAST_ROWS_PX) & (shared >= _LEAST_OVERLAP * lengths.min(axis=0))
    fits &= lengths.max(axis=0) > 2.0 * width
    # edges are parallel but for perspective and for what their own rows leave open
    fits &= np.abs(difference[:, 1]) < _STEEPER + 2.0 / np.maximum(shared, 1.0)
    i, j = i[fits], j[fits]
    strips = Strips(begins.lines[i], ends.lines[j], rows[fits], width[fits], np.zeros(len(i)))
    return _uniform(strips, band) if len(i) else strips


def _reaching(edges: Edges, turf: Turf) -> Mask:
    """(n,) which would come to the field's border if they went on down by their own length: the rest of an edge may be
    hidden, or before a board of the post's colour."""
    v = edges.rows[:, 1] + np.maximum(edges.rows[:, 1] - edges.rows[:, 0], 8.0) + 3.0
    u = edges.lines[:, 0] + edges.lines[:, 1] * v
    return np.asarray(turf.below_px(np.stack([u, v], axis=-1)) > 0.0)


def _uniform(strips: Strips, band: Band) -> Strips:
    v = strips.rows[:, :1] + (strips.rows[:, 1:] - strips.rows[:, :1]) * _HEIGHTS
    left, right = strips.left_at(v), strips.right_at(v)
    aside = np.clip(0.3 * strips.width_px, 1.5 * band.scale[0], 6.0 * band.scale[0])[:, None]
    half = 0.5 - np.clip(_BLUR_PX / strips.width_px, 0.2, 0.4)[:, None, None]
    inside = band.at(left[..., None] + (right - left)[..., None] * (0.5 + half * _PLACES), v[..., None])
    sides = np.stack([band.at(left - aside, v), band.at(right + aside, v)], axis=-1)
    contrast = np.median(inside[..., [0, -1]] - sides, axis=1).min(axis=-1)
    level = np.median(inside, axis=(1, 2))
    unrest = np.median(np.abs(inside - np.median(inside, axis=1, keepdims=True)), axis=(1, 2))
    darkest = np.median(inside.min(axis=-1), axis=1)
    brighter_side = np.median(sides, axis=1).max(axis=-1)
    good = (contrast > np.maximum(5.0, 0.03 * level)) & (unrest < 0.35 * contrast + 4.0)
    good &= darkest > brighter_side + 0.3 * (level - brighter_side)
    length = strips.rows[:, 1] - strips.rows[:, 0]
    clear = np.where(good, contrast * np.sqrt(np.maximum(length, 0.0)), -1.0)
    keep = np.argsort(-clear, kind="stable")[: min(_MOST, int(np.count_nonzero(good)))]
    return replace(strips.take(keep), contrast=contrast[keep])
