"""From a strip of the right colour to a post: how far up and down it goes, what it stands on, what it carries.

A post ends below on turf and above where its colour ends; beside its upper part there is no turf, which tells it from a
line; and on one side a crossbar as thick as itself goes off from its top, which tells it best from window frames,
curtains and legs.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.colours import Colour
from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.posts_bars import bars_of
from fieldloc.vision.posts_colour import View
from fieldloc.vision.posts_pairs import Strips
from fieldloc.vision.posts_score import score_of
from fieldloc.vision.turf import Mask, Turf

_SAMPLES = 56  # along a strip and what may be above and below it
_REACH = 1.5, 9.0  # up and down from the strip, in its lengths and its widths
_GAP = 0.15  # of a strip's length that may be hidden within it
_SLIMMEST, _STOUTEST = 24.0, 4.2  # height by width, of tall goals and of low ones seen from above
_STOUTEST_CUT = 1.3  # where the picture ends above
_CUT = 0.5  # of a crossbar is what is known of a post whose upper end is beside the picture
_DARKEST = 0.4  # of its own light that a post keeps in shade
_DIFFERENT = 6.0  # of 255, from what is beside it
_LIGHT = 1.0  # of the turf's lightest part: white is lighter than any turf in the same light
_GREY = 0.56  # the least part of a white post's colour by its largest
_SURE_BAR = 0.65  # of the places: with that much of a bar, another thing may hide the foot
_ON_TURF = 0.6  # of the points beneath and beside the foot
_WIDEST_GOAL = 3.0  # by its height
_UNLIKE = 2.0  # times slimmer or stouter than the clearest post of the picture
_BESIDE_TOP = 0.5  # of the points beside the upper part may be turf


@dataclass(frozen=True, slots=True, eq=False)
class Upright:
    """left, right: (2,) lines u = a + b v. top_v, foot_v: where it ends; cut: above by the picture's border.

    colour: (3,) BGR of the inside. contrast: of 255, to the side that is more alike. bars: (2,) share of the places to
    the left and to the right of the top at which a crossbar is seen. score: the more the likelier a post, about 0 to 2.
    """

    left: FloatArray
    right: FloatArray
    top_v: float
    foot_v: float
    cut: bool
    colour: FloatArray
    contrast: float
    bars: FloatArray
    score: float

    @property
    def width_px(self) -> float:
        middle = 0.5 * (self.top_v + self.foot_v)
        return float(self.right[0] - self.left[0] + (self.right[1] - self.left[1]) * middle)

    @property
    def slimness(self) -> float:
        """Height by width."""
        return self.height_px / self.width_px

    @property
    def height_px(self) -> float:
        return self.foot_v - self.top_v


def uprights_of(strips: Strips, picture: UInt8Array, turf: Turf, colour: Colour) -> list[Upright]:
    """Those of the strips that could be posts, best first; they may overlap."""
    if not len(strips.width_px):
        return []
    view = View(picture, colour)
    own = _own_colours(strips, view)
    side_tops, foot_v = _ends(strips, view, turf, own)
    stand = _standing(strips, foot_v, foot_v - side_tops.min(axis=1), turf, len(picture))
    # a post whose foot another thing hides is still seen down to where that begins, not to less
    good = foot_v > strips.rows[:, 1] - 0.3 * (strips.rows[:, 1] - strips.rows[:, 0])
    good &= view.has_hue(own)
    if min(colour) > 127:
        good &= (own.min(axis=1) > _GREY * own.max(axis=1)) & (own.max(axis=1) > _LIGHT * turf.colour.max())
    good &= _flanks(strips, side_tops.min(axis=1), foot_v, turf) < _BESIDE_TOP
    good &= foot_v - side_tops.min(axis=1) > _STOUTEST_CUT * strips.width_px
    strips, own, stand = strips.take(good), own[good], stand[good]
    side_tops, foot_v = side_tops[good], foot_v[good]
    if not len(own):
        return []
    level = view.likeness_of(own)
    bars, top_v = bars_of(strips, view, side_tops, level)
    whole = foot_v - top_v
    stands = (stand >= _ON_TURF) | (bars.max(axis=1) >= _SURE_BAR)
    cut = _leaves(strips, top_v, picture.shape[1])
    good = (
        stands
        & (whole > np.where(cut, _STOUTEST_CUT, _STOUTEST) * strips.width_px)
        & (whole < _SLIMMEST * strips.width_px)
    )
    seen = np.minimum(1.0, 2.0 * (strips.rows[:, 1] - strips.rows[:, 0]) / np.maximum(whole, 1.0))
    score = np.maximum(np.where(cut, _CUT, 0.0), bars.max(axis=1))
    score += score_of(strips, view, turf, top_v, foot_v, level) + 0.3 * (seen - 1.0) + 0.4 * (stand - 1.0)
    return [
        Upright(
            strips.left[i],
            strips.right[i],
            float(top_v[i]),
            float(foot_v[i]),
            bool(cut[i]),
            own[i],
            float(strips.contrast[i]),
            bars[i],
            float(score[i]),
        )
        for i in np.flatnonzero(good)
    ]


def _leaves(strips: Strips, top_v: FloatArray, width_px: int) -> Mask:
    """(n,) whether posts go on beside the picture: above, or at one of its sides."""
    beyond = (top_v - 3.0)[:, None]
    left, right = strips.left_at(beyond)[:, 0], strips.right_at(beyond)[:, 0]
    return np.asarray((top_v <= 2.0) | (left < 1.0) | (right > width_px - 2.0))


def alike(uprights: list[Upright]) -> list[Upright]:
    """Best first, without those that are much slimmer or stouter than most: posts of a field are alike.

    Wide ones count more, as what is seen of them is surer; of those that the picture's border cuts nothing is known.
    """
    whole = [one for one in uprights if not one.cut]
    if not whole:
        return sorted(uprights, key=lambda upright: -upright.score)
    slimness = np.array([one.slimness for one in whole])
    weight = np.array([max(one.score, 0.0) * one.width_px for one in whole])
    same = np.abs(np.log(slimness[:, None] / slimness)) < np.log(_UNLIKE)
    usual = slimness[int(np.argmax(same @ weight + weight))]
    kept = [one for one in uprights if one.cut or 1 / _UNLIKE < one.slimness / usual < _UNLIKE]
    return sorted(kept, key=lambda upright: -upright.score)


def apart(uprights: list[Upright]) -> list[Upright]:
    """Of those that overlap, or all but touch, the best."""
    kept: list[Upright] = []
    for one in uprights:
        if not any(_touch(one, other) for other in kept):
            kept.append(one)
    return kept


def is_mate(one: Upright, other: Upright) -> bool:
    """Whether one stands where the other's crossbar leads to, and looks like it."""
    if other.bars.max() == 0.0 or not 1 / _UNLIKE < one.slimness / other.slimness < _UNLIKE:
        return False
    side = 1.0 if other.bars[1] > other.bars[0] else -1.0
    apart_px = side * float(one.left @ (1.0, one.foot_v) - other.left @ (1.0, other.foot_v))
    higher = abs(one.top_v - other.top_v)
    return 0.0 < apart_px < _WIDEST_GOAL * max(one.height_px, other.height_px) and higher < 0.5 * apart_px


def _touch(one: Upright, other: Upright) -> bool:
    if min(one.foot_v, other.foot_v) <= max(one.top_v, other.top_v):
        return False
    v = 0.5 * (max(one.top_v, other.top_v) + min(one.foot_v, other.foot_v))
    left, right = one.left @ (1.0, v), one.right @ (1.0, v)
    others_left, others_right = other.left @ (1.0, v), other.right @ (1.0, v)
    room = 0.2 * min(right - left, others_right - others_left)
    return bool(min(right, others_right) - max(left, others_left) > -room)


def _own_colours(strips: Strips, view: View) -> FloatArray:
    """(n, 3) the inside's colour, where both edges are seen."""
    v = strips.rows[:, :1] + (strips.rows[:, 1:] - strips.rows[:, :1]) * np.linspace(0.05, 0.95, 9)
    left, right = strips.left_at(v), strips.right_at(v)
    inside = np.stack([left + f * (right - left) for f in (0.3, 0.5, 0.7)])
    return np.asarray(np.median(view.colours_at(inside, np.broadcast_to(v, inside.shape)).mean(axis=0), axis=1))


def _ends(strips: Strips, view: View, turf: Turf, own: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the left and the right edge end above (n, 2), and where the post ends below (n,)."""
    length = strips.rows[:, 1] - strips.rows[:, 0]
    reach = np.maximum(_REACH[0] * length, _REACH[1] * strips.width_px)
    first = np.maximum(strips.rows[:, 0] - reach, 0)
    last = np.minimum(strips.rows[:, 1] + reach, len(view.picture) - 1)
    v = first[:, None] + (last - first)[:, None] * np.linspace(0.0, 1.0, _SAMPLES)
    upper, middle, level = _seen(strips, v, view, own)
    # in light and in shade a post keeps its hue, and so does turf
    hue, own_hue, turf_hue = _hue(middle), _hue(own)[:, None], _hue(turf.colour)
    grassy = _total(np.abs(hue - own_hue)) >= _total(np.abs(hue - turf_hue))
    # a line before the foot is of a post's colour, and so is what is beside it
    grassy |= level & turf.at(np.stack([0.5 * (strips.left_at(v) + strips.right_at(v)), v], axis=-1))
    lower = ~grassy & (_total(middle) > _DARKEST * _total(own)[:, None])
    step = np.maximum(v[:, 1] - v[:, 0], 1e-9)
    gap = np.maximum(1, np.round(np.maximum(_GAP * length, 3.0) / step)).astype(np.intp)
    start = np.abs(v - strips.rows.mean(axis=1)[:, None]).argmin(axis=1)
    # another thing may hide a part of a post, but never turf
    below = np.arange(_SAMPLES) > start[:, None]
    ground = np.where(below & grassy, np.arange(_SAMPLES), _SAMPLES).min(axis=1) - 1
    foot = np.minimum(_reached(lower, start, gap, 1), np.maximum(ground, start))
    foot_v = np.take_along_axis(v, foot[:, None], axis=1)[:, 0]
    tops = [np.take_along_axis(v, _reached(side, start, gap, -1)[:, None], axis=1)[:, 0] for side in upper]
    fine = np.linspace(-1.0, 1.0, 11)
    for n, top in enumerate(tops):
        near = np.maximum(top[:, None] + fine * step[:, None], 0.0)
        off = ~_seen(strips, near, view, own)[0][n]
        lowest = len(fine) - 1 - off[:, ::-1].argmax(axis=1)
        edge = np.take_along_axis(near, np.minimum(lowest + 1, len(fine) - 1)[:, None], axis=1)[:, 0]
        tops[n] = np.where(off.any(axis=1), edge, top)
    return np.stack(tops, axis=1), foot_v


def _seen(strips: Strips, v: FloatArray, view: View, own: FloatArray) -> tuple[list[Mask], FloatArray, Mask]:
    """Where (n, k) the inside has its colour and the left side less of it, so of the right; what the inside is; where
    both sides are as the inside."""
    left, right = strips.left_at(v), strips.right_at(v)
    aside = strips.aside_px[:, None]
    middle = np.mean([view.colours_at(left + f * (right - left), v) for f in (0.3, 0.5, 0.7)], axis=0)
    level, contrast = view.likeness_of(own)[:, None], strips.contrast[:, None]
    inside = view.likeness_of(middle)
    same = inside > level - np.maximum(12.0, 0.5 * contrast)
    sides = np.stack([view.likeness_at(left - aside, v), view.likeness_at(right + aside, v)])
    level_sides = np.abs(sides - inside).max(axis=0) < 0.3 * contrast
    # lighter walls may be behind a post, too
    return (
        [same & (np.abs(inside - side) > np.maximum(_DIFFERENT, 0.15 * contrast)) for side in sides],
        middle,
        level_sides,
    )


def _total(colours: FloatArray) -> FloatArray:
    return np.asarray(colours[..., 0] + colours[..., 1] + colours[..., 2])


def _hue(colours: FloatArray) -> FloatArray:
    """(..., 3) shares of blue, green and red, those of the dark drawn to nothing."""
    return np.asarray(colours / (_total(colours)[..., None] + 30.0))


def _reached(good: Mask, start: NDArray[np.intp], gap: NDArray[np.intp], step: int) -> NDArray[np.intp]:
    """(n,) the last good one of each row from its start on, up (-1) or down (+1), without a gap that is too long."""
    if step < 0:
        count = good.shape[1] - 1
        return np.asarray(count - _reached(good[:, ::-1], count - start, gap, 1))
    place = np.broadcast_to(np.arange(good.shape[1]), good.shape)
    counts = good & (place >= start[:, None])
    latest = np.maximum.accumulate(np.where(counts, place, start[:, None]), axis=1)
    stopped = (place - latest > gap[:, None]) & (place > start[:, None])
    end = np.where(stopped.any(axis=1), stopped.argmax(axis=1), good.shape[1] - 1)
    return np.asarray(np.take_along_axis(latest, end[:, None], axis=1)[:, 0])


def _standing(strips: Strips, foot_v: FloatArray, length: FloatArray, turf: Turf, height: int) -> FloatArray:
    """(n,) the share of turf beneath each foot, at the depth where it is greatest; 1 where the picture ends there."""
    width = np.maximum(strips.width_px, 3.0)
    depth = [np.full_like(width, 3.0), 0.4 * width + 2.0, 0.8 * width + 2.0, 0.15 * length + 3.0, 0.3 * length + 4.0]
    v = foot_v[:, None] + np.stack(depth, axis=1)
    u = strips.left_at(v)[..., None] + width[:, None, None] * np.array([-0.6, 0.0, 0.5, 1.0, 1.6])
    share = turf.at(np.stack([u, np.broadcast_to(v[..., None], u.shape)], axis=-1)).mean(axis=-1)
    inside = v < height - 1
    return np.where(inside.sum(axis=1) < 2, 1.0, np.where(inside, share, 0.0).max(axis=1, initial=0.0))


def _flanks(strips: Strips, top_v: FloatArray, foot_v: FloatArray, turf: Turf) -> FloatArray:
    """(n,) the share of turf beside the upper part."""
    v = top_v[:, None] + np.linspace(0.05, 0.35, 4) * (foot_v - top_v)[:, None]
    aside = 2.0 + 0.5 * np.maximum(3.0, strips.width_px)[:, None]
    u = np.stack([strips.left_at(v) - aside, strips.right_at(v) + aside])
    return np.asarray(turf.at(np.stack([u, np.broadcast_to(v, u.shape)], axis=-1)).mean(axis=(0, 2)))
