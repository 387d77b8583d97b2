"""Crossbars: what goes off to one side from the top of a post, as thick as it and of its colour.

The edge on that side ends at the bar's underside. Slanted by perspective, cut by the picture or hidden in part, a bar
still shows at most of a few places beside the post.
"""

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.posts_colour import View
from fieldloc.vision.posts_pairs import Strips

_PLACES = np.array([0.7, 1.2, 1.8, 2.5, 3.3, 4.2])  # post's widths beside its edge
_SLOPES = np.linspace(-0.4, 0.4, 8)
_THICKNESSES = np.array([0.8, 1.3])
_JITTER = np.array([-0.12, 0.12])
_THINNEST, _THICKEST = 0.5, 1.6  # a bar, by the post's width
_LEAST = 0.45  # of the places, for there to be one


def bars_of(strips: Strips, view: View, side_tops: FloatArray, own: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 2) the share of places to the left and to the right at which a bar is seen, 0 where there is none, and the
    rows (n,) at which the posts end above.

    side_tops: (n, 2) where their edges end. own: (n,) their likeness to the post's colour.
    """
    shares = _shares(strips, view, side_tops, own)
    shares = np.where(shares > _LEAST, shares, 0.0)
    each = np.arange(len(shares))
    carrying = shares.argmax(axis=1)
    # the edge on the bar's side ends at the bar's underside, the other at its upper side
    under, outer = side_tops[each, carrying], side_tops[each, 1 - carrying]
    width = strips.width_px
    with_bar = np.clip(outer, under - _THICKEST * width, under - _THINNEST * width)
    top_v = np.maximum(np.where(shares.max(axis=1) > 0.0, with_bar, side_tops.min(axis=1)), 0.0)
    # a stay in the middle of a goal has bars on both sides, equally high
    stay = (shares.min(axis=1) > 0.0) & (np.abs(side_tops[:, 0] - side_tops[:, 1]) < 0.4 * width)
    return np.where(stay[:, None], 0.0, shares), top_v


def _shares(strips: Strips, view: View, under_v: FloatArray, own: FloatArray) -> FloatArray:
    """(n, 2) at the height, slope and thickness at which there are most; 0 where fewer than two places are visible."""
    width = np.maximum(strips.width_px, 3.0)[:, None]
    left = strips.left_at(under_v[:, :1]) - _PLACES * width
    right = strips.right_at(under_v[:, 1:]) + _PLACES * width
    # axes: side, strip, jitter, slope, thickness, place, and: above, inside, below
    thick = (_THICKNESSES * width)[:, None, None, :, None]
    lean = (_SLOPES[:, None] * (_PLACES * width)[:, None])[:, None, :, None]
    middle = (under_v.T[:, :, None] + _JITTER * width)[:, :, :, None, None, None] + lean - 0.5 * thick
    beyond = 0.5 * thick + 0.35 * width[..., None, None, None] + 1.0
    u = np.array([left, right])[:, :, None, None, None]
    rows = np.array([middle - beyond, middle, middle + beyond])
    visible = view.contains(u, rows[0]) & view.contains(u, rows[2])
    above, inside, below = view.likeness_at(u, rows)
    outside = np.maximum(above, below)
    # a bar is lit from another side than a post
    least = np.minimum(own - 0.6 * strips.contrast, 0.65 * own)[:, None, None, None, None]
    bar = visible & (inside > least) & (inside - outside > 0.45 * strips.contrast[:, None, None, None, None])
    places = visible.sum(axis=-1)
    share = np.where((places >= 2) & bar[..., 0], bar.sum(axis=-1) / np.maximum(places, 1), 0.0)
    return np.asarray(share.max(axis=(2, 3, 4), initial=0.0).T)
