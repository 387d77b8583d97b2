"""Goal posts in a picture, found without learning: what stands upright on the field in a post's colour.

upright edges about the field's border -> pairs with one colour between them -> how far up and down each goes, whether
it stands on turf and carries a crossbar -> those that are alike and apart -> edges, foot and top to parts of a pixel
"""

import numpy as np

from fieldloc.camera import Camera
from fieldloc.colours import FieldColours
from fieldloc.pose import FloatArray
from fieldloc.vision.detections import SeenPost
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.posts_edges import band_about, upright_edges
from fieldloc.vision.posts_ends import foot_of, top_of
from fieldloc.vision.posts_fit import FittedEdges, RoughPost, fit_edges
from fieldloc.vision.posts_pairs import pairs_of
from fieldloc.vision.posts_shape import Upright, alike, apart, is_mate, uprights_of
from fieldloc.vision.straight import Plane
from fieldloc.vision.turf import Turf

_LEAST_WHOLE, _LEAST_CUT = 0.65, 0.7  # scores of posts with both ends in the picture, and of others
_LEAST_ALONE, _LEAST_MATE = 0.5, 0.4  # where nothing scores more; where another post's crossbar leads there
_MOST, _FEW = 4, 3  # posts in a picture, the likeliest
_LOWER_MIDDLE = np.kron([[0.0, 0.5, 0.0, 0.5]], np.eye(2))  # of a post's four ends
_DEFAULTS = FieldColours()


def find_posts(
    picture: UInt8Array, turf: Turf, colours: FieldColours = _DEFAULTS, camera: Camera | None = None
) -> tuple[SeenPost, ...]:
    """The goal posts in a picture (h, w, 3), the likeliest first; some may be none. Empty where no field is seen.

    camera: its lens' distortion is taken out where edges are fitted; without one they are taken to be straight.
    """
    plane = Plane(camera)
    uprights = find_uprights(picture, turf, colours)
    rough = [RoughPost(one.left, one.right, (one.top_v, one.foot_v)) for one in uprights]
    edges = fit_edges(picture, rough, plane)
    posts = (_seen(picture, one, fit, turf, plane) for one, fit in zip(uprights, edges, strict=True) if fit is not None)
    return tuple(post for post in posts if post is not None)


def find_uprights(picture: UInt8Array, turf: Turf, colours: FieldColours) -> list[Upright]:
    """What may be posts, roughly, likeliest first."""
    found: list[Upright] = []
    for colour in colours.posts:
        band = band_about(picture, turf, colour)
        if band is None:
            return []
        begins, ends = upright_edges(band)
        strips = pairs_of(begins, ends, band, turf, picture.shape[1])
        found += uprights_of(strips, picture, turf, colour)
    sure = [one for one in found if one.score > (_LEAST_CUT if one.cut else _LEAST_WHOLE)]
    if not sure:
        return apart(alike([one for one in found if one.score > _LEAST_ALONE]))[:_FEW]
    sure = apart(alike(sure))
    mates = [one for one in found if one.score > _LEAST_MATE and any(is_mate(one, other) for other in sure)]
    return apart(sure + [one for one in alike(sure + mates) if one not in sure])[:_MOST]


def _seen(picture: UInt8Array, upright: Upright, edges: FittedEdges, turf: Turf, plane: Plane) -> SeenPost | None:
    """None where both edges fall on one another."""
    rows = upright.top_v, upright.foot_v
    lines = _in_picture(edges, 0, rows, plane), _in_picture(edges, 1, rows, plane)
    if min((lines[1] - lines[0]) @ (1.0, row) for row in rows) < 1.0:
        return None
    foot = foot_of(picture, lines, rows[1], upright.colour, turf)
    bar_right = bool(upright.bars[1] > upright.bars[0])
    has_bar = bool(upright.bars.max() > 0.0)
    top = top_of(picture, lines, rows[0], upright.colour, bar_right) if has_bar and not upright.cut else None
    ends = (top[0] if top else rows[0]), (foot[0] if foot else rows[1])
    pixels, covariance = _ends(edges, lines, ends, plane)
    outer = slice(0, 2) if bar_right else slice(4, 6)
    return SeenPost(
        pixels[0],
        pixels[1],
        covariance,
        0.5 * (pixels[0, 1] + pixels[1, 1]) if foot else None,
        _LOWER_MIDDLE @ covariance @ _LOWER_MIDDLE.T + np.diag([0.0, foot[1]]) if foot else None,
        pixels[0 if bar_right else 1, 0] if top else None,
        covariance[outer, outer] + np.diag([0.0, top[1]]) if top else None,
    )


def _in_picture(edges: FittedEdges, side: int, rows: tuple[float, float], plane: Plane) -> FloatArray:
    """(2,) u = a + b v in the picture between the two rows, where it is straight enough for feet and tops."""
    pixels = _points(edges, side, np.array(rows), plane)
    slope = (pixels[1, 0] - pixels[0, 0]) / (pixels[1, 1] - pixels[0, 1])
    return np.array([pixels[0, 0] - slope * pixels[0, 1], slope])


def _points(edges: FittedEdges, side: int, v: FloatArray, plane: Plane) -> FloatArray:
    """(k, 2) pixels of the edge at rows v (k,) of the picture, by a few steps of the secant."""
    y = v.astype(np.float64)
    pixels = np.stack([edges.x_at(side, y), y], axis=1)
    for _ in range(0 if plane.is_picture else 8):
        pixels = plane.to_picture(np.stack([edges.x_at(side, y), y], axis=1))
        y = y + (v - pixels[:, 1])
    return pixels


def _ends(
    edges: FittedEdges, lines: tuple[FloatArray, FloatArray], ends: tuple[float, float], plane: Plane
) -> tuple[FloatArray, FloatArray]:
    """(2, 2, 2) upper and lower end of the left and of the right edge, and the covariance (8, 8) of all across them."""
    v = np.array(ends)
    pixels = np.array([_points(edges, side, v, plane) for side in (0, 1)])
    spread = np.zeros((8, 4))  # from the edges' four numbers to the eight of their ends
    for side in (0, 1):
        normal = np.array([1.0, -lines[side][1]]) / np.hypot(1.0, lines[side][1])
        at = plane.from_picture(pixels[side])
        nudge = np.array([0.5, 0.0])
        moved = (plane.to_picture(at + nudge) - plane.to_picture(at - nudge)) @ normal
        own = np.stack([np.ones(2), at[:, 1] - edges.centre], axis=1) * moved[:, None]
        spread[4 * side : 4 * side + 4, 2 * side : 2 * side + 2] = (own[:, None] * normal[:, None]).reshape(4, 2)
    return pixels, spread @ edges.covariance @ spread.T
