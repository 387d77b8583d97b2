"""How likely a strip that stands on the field is a post: what tells it from windows, nets, robots' legs and chairs.

A goal stands at the edge of the field, on turf that goes on behind it for some widths of a post; its light is even from
top to foot; and there is no other thing like it close by.
"""

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.posts_colour import View
from fieldloc.vision.posts_pairs import Strips
from fieldloc.vision.turf import Turf

_ROWS = np.linspace(0.03, 0.97, 24)  # shares of the height at which the light is looked at
_ACROSS = np.array([0.25, 0.5, 0.75])[:, None, None]  # shares of the width there
_CLEAR = 0.5  # at most, for contrast as a share of a post's own light
_EVEN, _UNEVEN = 0.4, 0.1  # for even light; its scatter, as a share, that speaks neither for nor against
_BEHIND, _AT_BORDER = 0.1, 0.3  # widths of turf behind a foot; against less
_INSIDE, _WITHIN = 6.0, 0.4  # widths; against more
_LIKE = 1.35  # times as wide
_NEAR = 1.5, 8.0  # widths aside: nearer it is the same thing, farther another post
_REPEATED = 0.25  # against each like it, up to three


def score_of(
    strips: Strips, view: View, turf: Turf, top_v: FloatArray, foot_v: FloatArray, level: FloatArray
) -> FloatArray:
    """(n,) about -1 to 1, without what a crossbar says. level: (n,) likeness of the inside to the post's colour."""
    score = np.minimum(_CLEAR, strips.contrast / np.maximum(level, 1.0))
    score += _EVEN * np.clip(1.0 - _unevenness(strips, view, top_v, foot_v) / _UNEVEN, -1.5, 1.0)
    middle = 0.5 * (strips.left_at(foot_v[:, None]) + strips.right_at(foot_v[:, None]))[:, 0]
    behind = turf.below_uv(middle, foot_v) / strips.width_px
    score -= np.where(behind < _BEHIND, _AT_BORDER, np.where(behind > _INSIDE, _WITHIN, 0.0))
    return np.asarray(score - _REPEATED * np.minimum(_like_it(strips, top_v, foot_v), 3))


def _unevenness(strips: Strips, view: View, top_v: FloatArray, foot_v: FloatArray) -> FloatArray:
    """(n,) scatter of the light along the inside, as a share of it."""
    v = top_v[:, None] + (foot_v - top_v)[:, None] * _ROWS
    left, right = strips.left_at(v), strips.right_at(v)
    inside = view.likeness_at(left + _ACROSS * (right - left), v).mean(axis=0)
    return np.asarray(inside.std(axis=1) / np.maximum(inside.mean(axis=1), 1.0))


def _like_it(strips: Strips, top_v: FloatArray, foot_v: FloatArray) -> FloatArray:
    """(n,) how many others as wide are beside each, nearer than another post would be."""
    level = 0.5 * (top_v + foot_v)[:, None]
    middle = 0.5 * (strips.left_at(level) + strips.right_at(level))[:, 0]
    width = strips.width_px
    away = np.abs(middle - middle[:, None]) / width[:, None]
    alike = np.abs(np.log(width / width[:, None])) < np.log(_LIKE)
    beside = np.minimum(foot_v, foot_v[:, None]) > np.maximum(top_v, top_v[:, None])
    return np.asarray(np.count_nonzero((away > _NEAR[0]) & (away < _NEAR[1]) & alike & beside, axis=1))
