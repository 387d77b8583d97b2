"""Chains of white runs -> straight pieces: split where they bend, put together where they go on behind something."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from fieldloc.vision.turf import Mask

_BEND_PX = 1.2  # a piece's points stay within this of its chord, and within the next share of its width
_BEND_SHARE = 0.12
_TOGETHER_PX = 1.5  # ends of a piece from the line it is part of, beside the next share of its width ..
_TOGETHER_SHARE = 0.15
_TOGETHER_RAD = 0.012  # .. and for each pixel that it lies beyond that line's end
_WIDTHS = 3.0  # how much wider than the widest end of a line a piece of it may be
_FEWEST = 4  # points of a piece
_MOST_PIECES = 200  # the longest: a field has some twenty lines, and no picture takes forever


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """n straight pieces. ends: (n, 2, 2) in the plane of straight lines; width_px: (n, 2) across, at either end."""

    ends: FloatArray
    width_px: FloatArray

    @property
    def lengths(self) -> FloatArray:
        along = self.ends[:, 1] - self.ends[:, 0]
        return np.asarray(np.hypot(along[:, 0], along[:, 1]))


def straight_pieces(chains: list[FloatArray], least_length_px: float) -> Segments:
    """The straight pieces of chains (m, 3: a point in the plane and the width along the scan line there)."""
    straight: list[FloatArray] = []
    slants = [np.zeros(0)]
    todo = [chain for chain in chains if len(chain) >= _FEWEST]
    while todo:  # those that bend in two, and again
        fits, long, off, begins, slant = _bends(todo, least_length_px)
        straight += [chain for chain, fit in zip(todo, fits, strict=True) if fit]
        slants.append(slant[fits])
        halves = []
        for n in np.flatnonzero(long & ~fits).tolist():
            chain = todo[n]
            farthest = int(np.abs(off[begins[n] : begins[n] + len(chain)]).argmax())
            split = min(max(farthest, 1), len(chain) - 2)
            halves += [chain[: split + 1], chain[split:]]
        todo = [chain for chain in halves if len(chain) >= _FEWEST]
    widths = _tapered([chain[:, 2] for chain in straight]) * np.concatenate(slants)[:, None]
    return Segments(_fitted([chain[:, :2] for chain in straight]), widths)


def _bends(
    chains: list[FloatArray], least_length_px: float
) -> tuple[Mask, Mask, FloatArray, NDArray[np.intp], FloatArray]:
    """(k,) which chains are straight and long enough, and which are long enough; how far all points are off their
    chain's chord, and (k,) where each chain's begin; (k,) across a chain, how wide what is one wide along the scan
    lines is.
    """
    sizes = np.array([len(chain) for chain in chains])
    last = np.cumsum(sizes) - 1
    begins = last - sizes + 1
    u, v, width = np.concatenate(chains).T
    across, down = u[last] - u[begins], v[last] - v[begins]
    length = np.maximum(np.hypot(across, down), 1e-9)
    across, down = across / length, down / length
    off = (v - v[begins].repeat(sizes)) * across.repeat(sizes) - (u - u[begins].repeat(sizes)) * down.repeat(sizes)
    # A run's width is along its scan line, which is the axis the chain goes across.
    slant = np.maximum(np.abs(across), np.abs(down))
    # Neighbours tell how rough the white's edges are: noise is no bend.
    second = np.zeros(len(off))
    second[1:-1] = np.abs(off[2:] - 2.0 * off[1:-1] + off[:-2])
    second[begins] = second[last] = 0.0
    rough, wide, square = np.add.reduceat([second, width, off * off], begins, axis=1)
    mean = np.add.reduceat(off, begins) / sizes
    slack = np.maximum(_BEND_PX, _BEND_SHARE * wide / sizes * slant) + rough / (2.0 * (sizes - 2))
    farthest = np.maximum(np.maximum.reduceat(off, begins) - mean, mean - np.minimum.reduceat(off, begins))
    long = length >= least_length_px
    fits = long & (farthest <= 2.0 * slack) & (square / sizes - mean * mean <= (0.4 * slack) ** 2)
    return fits, long, off, begins, slant


def _fitted(pieces: list[FloatArray]) -> FloatArray:
    """(n, 2, 2): the ends of the straight lines through the points (m, 2) of each piece, in order, which pay little
    heed to the odd one far off.
    """
    if not pieces:
        return np.zeros((0, 2, 2))
    sizes = np.array([len(piece) for piece in pieces])
    begins = np.cumsum(sizes) - sizes
    points = np.concatenate(pieces).T
    weights = np.ones(points.shape[1])
    for _ in range(2):
        mean = np.add.reduceat(weights * points, begins, axis=1) / np.add.reduceat(weights, begins)
        u, v = points - mean.repeat(sizes, axis=1)
        weighted = weights * u
        cross, square = np.add.reduceat(np.stack([weighted * v, weighted * u - weights * v * v]), begins, axis=1)
        angle = 0.5 * np.arctan2(2.0 * cross, square)
        along = np.array([np.cos(angle), np.sin(angle)])
        each = along.repeat(sizes, axis=1)
        off = v * each[0] - u * each[1]
        typical = np.maximum(np.add.reduceat(np.abs(off), begins) / sizes, 0.1)
        weights = 1.0 / (1.0 + (off / (2.0 * typical.repeat(sizes))) ** 2)
    outer = np.array([begins, begins + sizes - 1])
    place = u[outer] * along[0] + v[outer] * along[1]
    return np.asarray((mean[:, None] + place * along[:, None]).T)


def _principal(points: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (2,) and main direction (2,) of weighted points."""
    mean = weights @ points / weights.sum()
    u, v = (points - mean).T
    weighted = weights * u
    angle = 0.5 * math.atan2(2.0 * float(weighted @ v), float(weighted @ u - (weights * v) @ v))
    return mean, np.array([math.cos(angle), math.sin(angle)])


def _tapered(widths: list[FloatArray]) -> FloatArray:
    """(k, 2) the width at either end of each piece, from the medians of the halves of its widths (m,)."""
    if not widths:
        return np.zeros((0, 2))
    sizes = np.array([[len(width) // 2, len(width) - len(width) // 2] for width in widths]).ravel()
    half = np.arange(len(sizes)).repeat(sizes)
    table = np.concatenate(widths)
    ranked = table[np.lexsort((table, half))]
    first, second = ranked[np.cumsum(sizes) - sizes + sizes[::2].repeat(2) // 2].reshape(-1, 2).T
    taper = 0.5 * (second - first)
    ends = np.stack([first - taper, second + taper], axis=1)
    return np.asarray(np.maximum(ends, 0.5 * np.minimum(first, second)[:, None]))


def merged(pieces: Segments) -> Segments:
    """Pieces of one line as one, from the longest on; its ends are those of the pieces farthest apart."""
    order = np.argsort(-pieces.lengths)[:_MOST_PIECES]
    ends, width, weight = pieces.ends[order], pieces.width_px[order], pieces.lengths[order]
    together = _belong(ends, width, ends, width)
    kept_ends, kept_widths = [], []
    left = np.ones(len(ends), dtype=np.bool_)
    for first in range(len(ends)):
        if not left[first]:
            continue
        base, base_width = ends[first], width[first]
        joined, now = left & False, together[first] & left
        for _ in range(3):  # what is joined makes the line longer and surer, so that more may belong to it
            now[first] = True
            if np.count_nonzero(now) == 1 or (now == joined).all():
                break
            joined = now
            base = _joint(ends[joined], weight[joined])
            along = base[1] - base[0]
            place = (ends[joined] - base[0]) @ along / (along @ along)
            base_width = _line_at_ends(place.ravel(), width[joined].ravel(), np.repeat(weight[joined], 2))
            now = _belong(base[None], base_width[None], ends, width)[0] & left
        kept_ends.append(base)
        kept_widths.append(base_width)
        joined[first] = True
        left &= ~joined
    return Segments(np.array(kept_ends).reshape(-1, 2, 2), np.array(kept_widths).reshape(-1, 2))


def _belong(lines: FloatArray, line_width: FloatArray, ends: FloatArray, width: FloatArray) -> Mask:
    """(k, n) which pieces (n, 2, 2), (n, 2) wide, may be parts of which lines (k, 2, 2), (k, 2) wide."""
    along = lines[:, 1] - lines[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    u, v = (along / length[:, None]).T[..., None, None]
    across, down = (ends - lines[:, None, None, 0]).transpose(3, 0, 1, 2)
    place, off = across * u + down * v, np.abs(down * u - across * v)
    beyond = np.maximum(np.maximum(-place, place - length[:, None, None]), 0.0)
    widest = line_width.max(axis=1)[:, None, None]
    slack = _TOGETHER_PX + _TOGETHER_SHARE * np.minimum(width, widest) + _TOGETHER_RAD * beyond
    near = off <= slack
    return np.asarray(near[..., 0] & near[..., 1] & (width.mean(axis=1) < _WIDTHS * widest[..., 0]))


def _line_at_ends(place: FloatArray, width: FloatArray, weight: FloatArray) -> FloatArray:
    """(2,) the straight line through widths over places, at places 0 and 1; no narrower than half the narrowest."""
    total = weight.sum()
    mean, middle = weight @ width / total, weight @ place / total
    spread = float(weight @ (place - middle) ** 2)
    slope = float(weight @ ((place - middle) * (width - mean))) / spread if spread > 0.0 else 0.0
    return np.asarray(np.maximum(mean + slope * (np.array([0.0, 1.0]) - middle), 0.5 * float(width.min())))


def _joint(ends: FloatArray, weight: FloatArray) -> FloatArray:
    """(2, 2): one line through segments (k, 2, 2), each with a weight, from end to end."""
    first, last = ends[:, 0], ends[:, 1]
    points = np.concatenate([first, 0.5 * (first + last), last])
    mean, along = _principal(points, np.concatenate([weight, weight, weight]))
    place = (points - mean) @ along
    return np.asarray(mean + np.array([[place.min()], [place.max()]]) * along)
