"""How far up and down a strip of a post's colour goes, roughly: up as long as there is an edge, down to the turf."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from fieldloc.vision.posts_colour import View, nearest
from fieldloc.vision.posts_pairs import Strips
from fieldloc.vision.turf import Mask, Turf

_SAMPLES = 56  # along a strip and what may be above and below it
_SHARES = np.linspace(0.0, 1.0, _SAMPLES)
_FINE = np.linspace(-1.0, 1.0, 11)  # steps about where it ends above
_INNER = np.array([0.3, 0.5, 0.7])[:, None, None]  # shares of the width at which the inside is looked at
_REACH = 1.5, 9.0  # up and down from the strip, in its lengths and its widths
_GAP = 0.15  # of a strip's length that may be hidden within it
_LEAST_BELOW = 0.5  # of the way down to the foot on which there is an edge
_DARKEST = 0.4  # of its own light that a post keeps in shade
_LESS = 0.3  # of what it differs where both edges are seen: darker beside it
_DIFFERENT = 6.0, 0.15  # of 255, and of the same: another light beside it, be it a lighter wall's


@dataclass(frozen=True, slots=True, eq=False)
class Extent:
    """tops: (n, 2) where the left and the right edge end above; other_tops: where they do as edges to what may be
    lighter, too. foot_v: (n,) where the post ends below; unbroken: (n,) whether there is an edge most of the way."""

    tops: FloatArray
    other_tops: FloatArray
    foot_v: FloatArray
    unbroken: Mask


def extent_of(strips: Strips, view: View, turf: Turf, own: FloatArray) -> Extent:
    """own: (n, 3) colours of the inside."""
    length = strips.rows[:, 1] - strips.rows[:, 0]
    reach = np.maximum(_REACH[0] * length, _REACH[1] * strips.width_px)
    first = np.maximum(strips.rows[:, 0] - reach, 0)
    last = np.minimum(strips.rows[:, 1] + reach, len(view.picture) - 1)
    v = first[:, None] + (last - first)[:, None] * _SHARES
    step = np.maximum(v[:, 1] - v[:, 0], 1e-9)
    gap = np.maximum(1, np.round(np.maximum(_GAP * length, 3.0) / step)).astype(np.intp)
    start = np.abs(v - strips.rows.mean(axis=1)[:, None]).argmin(axis=1)

    left, right = strips.left_at(v), strips.right_at(v)
    aside = strips.aside_px[:, None]
    u = np.array([left - aside, *(left + _INNER * (right - left)), right + aside])
    pixels = nearest(view.picture, u, v)
    middle = pixels[1:4].sum(axis=0, dtype=np.float32) / np.float32(3.0)
    darker, other, like_sides = _edges_seen(strips, view, own, middle, view.likeness(pixels[[0, 4]]))
    tops = _at(v, _reached(np.concatenate([darker, other]), start, gap, -1))
    # a line before the foot is of a post's colour, and so is what is beside it
    turfy = turf.at_uv(u[2], v)
    grassy = _grassy(middle, own, turf) | (like_sides & turfy)
    # another thing may hide a part of a post, but never turf
    lower = ~grassy & (_total(middle) > _DARKEST * _total(own)[:, None])
    below = np.arange(_SAMPLES) > start[:, None]
    ground = np.where(below & grassy, np.arange(_SAMPLES), _SAMPLES).min(axis=1) - 1
    foot = np.minimum(_reached(lower, start, gap, 1), np.maximum(ground, start))
    # between where both edges are seen and the foot there is at least one: a board may go on to one side
    between = (v > strips.rows[:, 1:]) & (np.arange(_SAMPLES) <= foot[:, None])
    seen = np.count_nonzero(between & other.any(axis=0), axis=1)
    unbroken = seen >= _LEAST_BELOW * np.count_nonzero(between, axis=1) - gap
    return Extent(_finer(strips, view, own, tops[:2], step).T, tops[2:].T, _at(v, foot), unbroken)


def _finer(strips: Strips, view: View, own: FloatArray, tops: FloatArray, step: FloatArray) -> FloatArray:
    """(2, n) where edges end above, more exactly: below the lowest place near by at which there is none."""
    near = np.maximum(tops[..., None] + _FINE * step[:, None], 0.0)
    left = strips.left[:, :1] + strips.left[:, 1:] * near
    right = strips.right[:, :1] + strips.right[:, 1:] * near
    aside = strips.aside_px[:, None]
    beside = np.array([left[0] - aside, right[1] + aside])
    u = np.array([beside, *(left + _INNER[..., None] * (right - left))])
    pixels = nearest(view.picture, u, near)
    middle = pixels[1:].sum(axis=0, dtype=np.float32) / np.float32(3.0)
    off = ~_edges_seen(strips, view, own, middle, view.likeness(pixels[0]))[0]
    last = len(_FINE) - 1
    lowest = last - off[..., ::-1].argmax(axis=-1)
    edge = _each_at(near, np.minimum(lowest + 1, last))
    return np.where(off.any(axis=-1), edge, tops)


def _edges_seen(
    strips: Strips, view: View, own: FloatArray, middle: FloatArray, sides: FloatArray
) -> tuple[Mask, Mask, Mask]:
    """Where (2, n, k) the inside has its colour and the left side less of it, so of the right; where the sides differ
    in whatever way; where (n, k) both sides are as the inside.

    middle: (n, k, 3) or (2, n, k, 3) colours inside. sides: (2, n, k) likeness.
    """
    level, contrast = view.likeness_of(own)[:, None], strips.contrast[:, None]
    inside = view.likeness_of(middle)
    same = inside > level - np.maximum(12.0, 0.5 * contrast)
    less = inside - sides
    different = np.abs(less)
    darker = same & (less > _LESS * contrast)
    other = same & (different > np.maximum(_DIFFERENT[0], _DIFFERENT[1] * contrast))
    return np.asarray(darker), np.asarray(other), np.asarray(different.max(axis=0) < _LESS * contrast)


def _grassy(middle: FloatArray, own: FloatArray, turf: Turf) -> Mask:
    """(n, k) where the hue is nearer to the turf's: in light and in shade a post keeps its hue, and so does turf."""
    hue, own_hue, turf_hue = _hue(middle), _hue(own)[:, None], _hue(turf.colour)
    return np.asarray(_total(np.abs(hue - own_hue)) >= _total(np.abs(hue - turf_hue)))


def _total(colours: FloatArray) -> FloatArray:
    return np.asarray(colours[..., 0] + colours[..., 1] + colours[..., 2])


def _hue(colours: FloatArray) -> FloatArray:
    """(..., 3) shares of blue, green and red, those of the dark drawn to nothing."""
    return np.asarray(colours / (_total(colours)[..., None] + 30.0))


def _at(v: FloatArray, index: NDArray[np.intp]) -> FloatArray:
    """(..., n) of v (n, k) what the index (..., n) says."""
    return np.asarray(v[np.arange(len(v)), index])


def _each_at(values: NDArray[np.generic], index: NDArray[np.intp]) -> NDArray[np.generic]:
    """(...) of values (..., k) what the index (...) says."""
    flat = values.reshape(-1, values.shape[-1])
    return np.asarray(flat[np.arange(len(flat)), index.ravel()].reshape(index.shape))


def _reached(good: Mask, start: NDArray[np.intp], gap: NDArray[np.intp], step: int) -> NDArray[np.intp]:
    """(..., n) the last good one of (..., n, k) from the start (n,) on, up (-1) or down (+1), but for short gaps."""
    last = good.shape[-1] - 1
    if step < 0:
        return np.asarray(last - _reached(good[..., ::-1], last - start, gap, 1))
    place, first = np.arange(last + 1), start[:, None]
    latest = np.maximum.accumulate(np.where(good & (place >= first), place, first), axis=-1)
    stopped = place - latest > gap[:, None]
    end = np.where(stopped.any(axis=-1), stopped.argmax(axis=-1), last)
    return np.asarray(_each_at(latest, end))
