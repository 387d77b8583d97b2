"""From a strip of the right colour to a post: how far up and down it goes, what it stands on, what it carries.

A post ends below on turf and above where its colour ends; beside its upper part there is no turf, which tells it from a
line; and on one side a crossbar as thick as itself goes off from its top, which tells it best from window frames,
curtains and legs.
"""

from dataclasses import dataclass

import numpy as np

from fieldloc.colours import Colour
from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.posts_bars import bars_of
from fieldloc.vision.posts_colour import View
from fieldloc.vision.posts_extent import extent_of
from fieldloc.vision.posts_pairs import Strips
from fieldloc.vision.posts_score import score_of
from fieldloc.vision.turf import Mask, Turf

_NARROWED_PX = 1.5  # shade takes from the width of posts
_SLIMMEST, _STOUTEST = 24.0, 4.2  # height by width, of tall goals and of low ones seen from above
_STOUTEST_CUT = 1.3  # where the picture ends above
_UNBROKEN = 0.4  # for both edges from top to foot, against none
_CUT = 0.5  # of a crossbar is what is known of a post whose upper end is beside the picture
_LIGHT = 1.0  # of the turf's lightest part: white is lighter than any turf in the same light
_GREY = 0.56  # the least part of a white post's colour by its largest
_SURE_BAR = 0.65  # of the places: with that much of a bar, another thing may hide the foot
_ON_TURF = 0.6  # of the points beneath and beside the foot
_WIDEST_GOAL = 3.0  # by its height
_NEARLY, _FAR = 0.2, 1.5  # of a score; of contrasts
_UNLIKE = 2.0  # times slimmer or stouter than the clearest post of the picture
_ALONG = np.linspace(0.05, 0.95, 9)  # shares of the rows with both edges, at which the inside is looked at
_INNER = np.array([0.3, 0.5, 0.7])[:, None, None]  # shares of the width at which it is looked at there
_UPPER = np.linspace(0.05, 0.35, 4)  # shares of the height, from above, at which flanks are looked at
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
    view = View(picture, colour)
    strips, own = _of_colour(strips, view, turf)
    if not len(own):
        return []
    extent = extent_of(strips, view, turf, own)
    side_tops, other_tops, foot_v = extent.tops, extent.other_tops, extent.foot_v
    uppermost = side_tops.min(axis=1)
    stand = _standing(strips, foot_v, foot_v - uppermost, turf, len(picture)) * extent.unbroken
    # a post whose foot another thing hides is still seen down to where that begins, not to less
    good = foot_v > strips.rows[:, 1] - 0.3 * (strips.rows[:, 1] - strips.rows[:, 0])
    good &= _flanks(strips, uppermost, foot_v, turf) < _BESIDE_TOP
    good &= foot_v - uppermost > _STOUTEST_CUT * strips.width_px
    if not good.any():
        return []
    strips, own, stand = strips.take(good), own[good], stand[good]
    side_tops, other_tops, foot_v = side_tops[good], other_tops[good], foot_v[good]
    level = view.likeness_of(own)
    bars, top_v = bars_of(strips, view, side_tops, level)
    top_v = np.where(bars.max(axis=1) > 0.0, top_v, np.minimum(top_v, other_tops.min(axis=1)))
    whole = foot_v - top_v
    stands = (stand >= _ON_TURF) | (bars.max(axis=1) >= _SURE_BAR)
    cut = _leaves(strips, top_v, picture.shape[1])
    good = (
        stands
        & (whole > np.where(cut, _STOUTEST_CUT, _STOUTEST) * strips.width_px)
        & (whole < _SLIMMEST * (strips.width_px + _NARROWED_PX))
    )
    seen = np.minimum(1.0, (strips.rows[:, 1] - strips.rows[:, 0]) / np.maximum(whole, 1.0))
    score = np.maximum(np.where(cut, _CUT, 0.0), bars.max(axis=1))
    score += score_of(strips, view, turf, top_v, foot_v, level) + _UNBROKEN * (seen - 0.5) + 0.4 * (stand - 1.0)
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
    """Of those that overlap, or all but touch, the best; of those that are nearly as good the one with the clearer
    edges: a cord of the net beside a post makes it wider."""
    kept: list[Upright] = []
    for one in uprights:
        rivals = [n for n, other in enumerate(kept) if _touch(one, other)]
        if not rivals:
            kept.append(one)
        elif len(rivals) == 1 and _is_clearer(one, kept[rivals[0]]):
            kept[rivals[0]] = one
    return kept


def _is_clearer(one: Upright, other: Upright) -> bool:
    """Whether one is nearly as good as the other and has clearer edges, or is good enough and has far clearer ones."""
    less = other.score - one.score
    return one.contrast > other.contrast and less < _NEARLY * (2.0 if one.contrast > _FAR * other.contrast else 1.0)


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


def _of_colour(strips: Strips, view: View, turf: Turf) -> tuple[Strips, FloatArray]:
    """Those of the strips whose inside has the post's hue, and (n, 3) its colour where both edges are seen."""
    if not len(strips.width_px):
        return strips, np.zeros((0, 3))
    v = strips.rows[:, :1] + (strips.rows[:, 1:] - strips.rows[:, :1]) * _ALONG
    left, right = strips.left_at(v), strips.right_at(v)
    inside = left + _INNER * (right - left)
    own = np.sort(view.colours_at(inside, v).mean(axis=0), axis=1)[:, v.shape[1] // 2]
    good = view.has_hue(own)
    if min(view.colour) > 127:
        lightest = own.max(axis=1)
        good &= (own.min(axis=1) > _GREY * lightest) & (lightest > _LIGHT * turf.colour.max())
    return strips.take(good), own[good]


def _standing(strips: Strips, foot_v: FloatArray, length: FloatArray, turf: Turf, height: int) -> FloatArray:
    """(n,) the share of turf beneath each foot, at the depth where it is greatest; 1 where the picture ends there."""
    width = np.maximum(strips.width_px, 3.0)
    depth = [np.full_like(width, 3.0), 0.4 * width + 2.0, 0.8 * width + 2.0, 0.15 * length + 3.0, 0.3 * length + 4.0]
    v = foot_v[:, None] + np.array(depth).T
    u = strips.left_at(v)[..., None] + width[:, None, None] * np.array([-0.6, 0.0, 0.5, 1.0, 1.6])
    share = turf.at_uv(u, v[..., None]).mean(axis=-1)
    inside = v < height - 1
    return np.where(inside.sum(axis=1) < 2, 1.0, np.where(inside, share, 0.0).max(axis=1, initial=0.0))


def _flanks(strips: Strips, top_v: FloatArray, foot_v: FloatArray, turf: Turf) -> FloatArray:
    """(n,) the share of turf beside the upper part."""
    v = top_v[:, None] + _UPPER * (foot_v - top_v)[:, None]
    aside = 2.0 + 0.5 * np.maximum(3.0, strips.width_px)[:, None]
    u = np.array([strips.left_at(v) - aside, strips.right_at(v) + aside])
    return np.asarray(turf.at_uv(u, v).mean(axis=(0, 2)))
