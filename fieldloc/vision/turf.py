"""The field's region in a picture, whatever green its turf is.

The turf's hue is the peak of the hues of the picture itself, the lower the pixel the more it counts; shadow, sun and
lines stay inside. The border to what is behind the field is where, going up a column, turf stops being the most of what
is seen; robots in front of it are bridged, as a field is convex.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from fieldloc.colours import FieldColours
from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array

Mask = NDArray[np.bool_]

_LONG_SIDE_PX = 320  # of the reduced picture: a field's region needs no more
_HUES = (24, 98)  # of 180: from yellowish to bluish green, what any turf or carpet sold as such lies in
_SATURATION = 30  # of 255; what is greyer has no hue to speak of
_CHROMA = 10  # of 255; what is darker has none either
_POST_HUES = 6  # to either side of a post's own hue: shade and the light's colour change it so much
_POST_PALE = 60  # of 255: a post that is less saturated has no hue to be known by
_SHARE_OF_PEAK = 0.05  # hues as rare as this beside the peak are not turf
_LEAST_SHARE = 0.02  # of the picture, for there to be a field at all
_LEAST_PART = 0.001  # of the picture: smaller connected parts are specks
_SHARE_OF_SATURATION = 0.35  # of the turf's median, below which it is something else
_SHARE_OF_CHROMA = 0.35  # of the turf's median; deep shadow is at about a half
_DENSE = 0.6  # share of the pixels around one in turf that have its colour
_NARROW = 0.04  # of the width: what rises above the border over fewer columns is no turf
_WIDE, _STEEP = (
    0.12,
    4.0,
)  # nor what does over fewer than these, as steeply on either side: somebody in green behind the
# field
_RUN = 3  # rows of the reduced picture: a column with fewer in turf shows none
_WHITE_POSTS = FieldColours()


@dataclass(frozen=True, slots=True, eq=False)
class Turf:
    """mask: (h', w') pixels of the turf's colour, on a grid `scale` (2,) times coarser than the picture (>= 1, not
    whole in general; pixel (u, v) of the picture is at ((u + 0.5) / scale - 0.5, ..) of the mask): use `at`.

    boundary_px: (k, 2) the field's upper border from left to right, in the picture's pixels; None where no field is
    seen, and mask is all False then. colour: (3,) the turf's mean BGR, zeros without a field.
    """

    mask: Mask
    scale: FloatArray
    boundary_px: FloatArray | None
    colour: FloatArray

    def at(self, points_px: FloatArray) -> Mask:
        """(...,) whether points (..., 2) of the picture have the turf's colour; False beside the picture."""
        return self.at_uv(points_px[..., 0], points_px[..., 1])

    def at_uv(self, u_px: FloatArray, v_px: FloatArray) -> Mask:
        """As `at`, of columns and rows that broadcast."""
        height, width = self.mask.shape
        u, v = (u_px + 0.5) / self.scale[0], (v_px + 0.5) / self.scale[1]
        inside = (u >= 0.0) & (u < width) & (v >= 0.0) & (v < height)  # NaN is nowhere
        place = np.where(inside, np.floor(v) * width + np.floor(u), 0.0).astype(np.intp)
        return np.asarray(self.mask.take(place) & inside, dtype=np.bool_)

    def below_px(self, points_px: FloatArray) -> FloatArray:
        """(...,) how far below the field's upper border points (..., 2) are; negative above, -inf without a field."""
        return self.below_uv(points_px[..., 0], points_px[..., 1])

    def below_uv(self, u_px: FloatArray, v_px: FloatArray) -> FloatArray:
        """As `below_px`, of columns and rows."""
        if self.boundary_px is None:
            return np.full(v_px.shape, -np.inf)
        return np.asarray(v_px - np.interp(u_px, self.boundary_px[:, 0], self.boundary_px[:, 1]), dtype=np.float64)


def find_turf(picture: UInt8Array, colours: FieldColours = _WHITE_POSTS) -> Turf:
    """The field in a picture; without mask and boundary where there is none. colours: a post right before the camera,
    which may be larger than all the turf in sight and of a hue that turf could have, is not the field."""
    height, width = picture.shape[:2]
    factor = max(1.0, max(height, width) / _LONG_SIDE_PX)
    size = max(1, round(width / factor)), max(1, round(height / factor))
    scale = np.array([width / size[0], height / size[1]])
    small = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    coloured = _coloured(small, colours)
    dense = _dense(coloured)
    tops = _tops(dense)
    seen = np.isfinite(tops)
    if np.count_nonzero(dense) < _LEAST_SHARE * dense.size or not seen.any():
        return Turf(np.zeros(coloured.shape, dtype=np.bool_), scale, None, np.zeros(3))
    coarser = np.array([size[0] / dense.shape[1], size[1] / dense.shape[0]])
    border = _upper_hull(np.stack([np.flatnonzero(seen).astype(np.float64), tops[seen]], axis=1))
    border = (border + 0.5) * coarser - 0.5
    # The hull's ends reach to the picture's sides, level, so that the border is told for every column.
    border = np.concatenate([[[-0.5, border[0, 1]]], border, [[size[0] - 0.5, border[-1, 1]]]])
    first = np.ceil(np.interp(np.arange(size[0]), border[:, 0], border[:, 1])).astype(np.int16)
    mask = (coloured > 0) & (np.arange(size[1], dtype=np.int16)[:, None] >= first)
    colour = np.asarray(cv2.mean(small, mask.view(np.uint8))[:3])
    return Turf(mask, scale, (border + 0.5) * scale - 0.5, colour)


def _coloured(small: UInt8Array, colours: FieldColours) -> UInt8Array:
    """255 where a pixel has the hue that is the turf's in this picture, in sun or shadow."""
    hsv = np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2HSV), dtype=np.uint8)
    chroma = np.asarray(cv2.multiply(hsv[:, :, 1], hsv[:, :, 2], scale=1 / 255), dtype=np.uint8)
    hue, vivid, saturation = hsv[::3, ::3, 0], chroma[::3, ::3], hsv[::3, ::3, 1]
    rows = np.broadcast_to(np.linspace(0.2, 1.0, len(hue))[:, None], hue.shape)
    green = (hue >= _HUES[0]) & (hue <= _HUES[1]) & (saturation >= _SATURATION) & (vivid >= _CHROMA)
    if not green.any():
        return np.zeros(small.shape[:2], dtype=np.uint8)
    hue, vivid, saturation = hue[green], vivid[green], saturation[green]
    counts = np.convolve(np.bincount(hue, weights=rows[green] * vivid, minlength=180), np.full(5, 0.2), mode="same")
    others = np.where(_post_hues(colours), 0.0, counts)
    peak = int(np.argmax(others if others.sum() > _LEAST_SHARE * counts.sum() else counts))
    rare = counts < _SHARE_OF_PEAK * counts[peak]
    least = max(_HUES[0], peak + 1 - int(np.argmax(rare[peak::-1])))
    most = min(_HUES[1], peak - 1 + int(np.argmax(rare[peak:])))
    # Turf is about as saturated everywhere; what has its hue by chance, as grey walls in green light, is much paler.
    # Hue and saturation of what is nearly black are noise, so there must be some of the colour itself, too.
    turf = (hue >= least) & (hue <= most)
    paler = max(_SATURATION, _SHARE_OF_SATURATION * _median(saturation[turf]))
    darker = max(_CHROMA, _SHARE_OF_CHROMA * _median(vivid[turf]))
    coloured = cv2.inRange(hsv, (least, paler, 0), (most, 255, 255))
    return np.asarray(cv2.bitwise_and(coloured, cv2.inRange(chroma, darker, 255)), dtype=np.uint8)


@lru_cache(maxsize=16)
def _post_hues(colours: FieldColours) -> Mask:
    """(180,) the hues that posts have."""
    posts = np.array([[one[::-1] for one in colours.posts]], dtype=np.uint8)
    hue, saturation, _ = cv2.cvtColor(posts, cv2.COLOR_BGR2HSV)[0].T.astype(np.intp)
    off = np.abs(np.arange(180)[:, None] - hue[saturation >= _POST_PALE])
    return np.asarray((np.minimum(off, 180 - off) <= _POST_HUES).any(axis=1))


def _median(values: UInt8Array) -> float:
    upto = np.cumsum(np.bincount(values))  # there are far more values than different ones
    return float(np.searchsorted(upto, len(values) // 2, side="right"))


def _dense(coloured: UInt8Array) -> Mask:
    """Where most pixels have the colour, on a grid twice as coarse; without specks: grass is dense, and a field's parts
    between lines and shadows are large.
    """
    size = max(1, coloured.shape[1] // 2), max(1, coloured.shape[0] // 2)
    half = cv2.boxFilter(cv2.resize(coloured, size, interpolation=cv2.INTER_AREA), -1, (3, 3))
    dense = np.asarray(half > 255 * _DENSE, dtype=np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(dense, connectivity=4, ltype=cv2.CV_16U)
    large = stats[:, cv2.CC_STAT_AREA] >= _LEAST_PART * dense.size
    large[0] = False
    return np.asarray(large.take(np.asarray(labels, dtype=np.intp)), dtype=np.bool_)


def _tops(mask: Mask) -> FloatArray:
    """(w',) the upper edge of the stretch of each column with the greatest excess of turf; NaN without one."""
    height, width = mask.shape
    from_below = np.cumsum(np.where(mask[::-1].T, np.int32(1), np.int32(-1)), axis=1, dtype=np.int32)
    excess = from_below.copy()
    excess[:, 1:] -= np.minimum.accumulate(np.minimum(from_below[:, :-1], 0), axis=1)
    best = excess.argmax(axis=1)
    heights = np.where(excess[np.arange(width), best] >= min(_RUN, height), best + 1.0, 0.0)
    # A post, a plant or a leg of the colour makes a peak of few columns, a field's corner does not.
    heights = _changed(heights, cv2.MORPH_OPEN, _NARROW)
    # What stands before the border makes gaps in it, which are no steps beside what rises above it.
    whole = _changed(heights, cv2.MORPH_CLOSE, _WIDE)
    change = np.diff(whole)
    for first, last in pairwise(np.flatnonzero(np.abs(change) > _STEEP).tolist()):
        if change[first] > 0.0 > change[last] and last - first < _WIDE * width:
            heights[first + 1 : last + 1] = np.minimum(heights, max(whole[first], whole[last + 1]))[
                first + 1 : last + 1
            ]
    return np.where(heights > 0.0, height - 0.5 - heights, np.nan)


def _changed(heights: FloatArray, how: int, share: float) -> FloatArray:
    """(w',) opened or closed: without peaks, or gaps, of fewer columns than that share of all."""
    window = np.ones((1, max(3, round(share * len(heights)))), dtype=np.uint8)
    return np.asarray(cv2.morphologyEx(heights[None], how, window)[0])


def _upper_hull(points: FloatArray) -> FloatArray:
    """The corners, from left to right, of the upper convex hull of points (n, 2) sorted by u (v grows downwards)."""
    if len(points) < 3:
        return points
    low = points[:, 1].max() + 1.0
    around = np.concatenate([[[points[0, 0], low]], points, [[points[-1, 0], low]]]).astype(np.float32)
    hull = np.sort(cv2.convexHull(around, returnPoints=False)[:, 0])
    return np.asarray(points[hull[1:-1] - 1])
