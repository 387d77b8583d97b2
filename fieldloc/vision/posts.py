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
from fieldloc.vision.posts_fit import FittedEdge, fit_edge
from fieldloc.vision.posts_pairs import pairs_of
from fieldloc.vision.posts_shape import Upright, alike, apart, uprights_of
from fieldloc.vision.straight import Plane
from fieldloc.vision.turf import Turf

_LEAST_SCORE = 0.6
_MOST = 6  # posts in a picture, the likeliest
_DEFAULTS = FieldColours()


def find_posts(
    picture: UInt8Array, turf: Turf, colours: FieldColours = _DEFAULTS, camera: Camera | None = None
) -> tuple[SeenPost, ...]:
    """The goal posts in a picture (h, w, 3), the likeliest first; some may be none. Empty where no field is seen.

    camera: its lens' distortion is taken out where edges are fitted; without one they are taken to be straight.
    """
    plane = Plane(camera)
    posts = (_fitted(picture, upright, turf, plane) for upright in find_uprights(picture, turf, colours))
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
    return apart(alike([upright for upright in found if upright.score > _LEAST_SCORE]))[:_MOST]


def _fitted(picture: UInt8Array, upright: Upright, turf: Turf, plane: Plane) -> SeenPost | None:
    """None where an edge cannot be fitted, or both fall on one another."""
    rows = upright.top_v, upright.foot_v
    left = fit_edge(picture, upright.left, rows, upright.width_px, 1, plane)
    right = fit_edge(picture, upright.right, rows, upright.width_px, -1, plane)
    if left is None or right is None:
        return None
    lines = _in_picture(left, rows, plane), _in_picture(right, rows, plane)
    if min((lines[1] - lines[0]) @ (1.0, row) for row in rows) < 1.0:
        return None
    foot = foot_of(picture, lines, rows[1], upright.colour, turf)
    bar_right = bool(upright.bars[1] > upright.bars[0])
    has_bar = bool(upright.bars.max() > 0.0)
    top = top_of(picture, lines, rows[0], upright.colour, bar_right) if has_bar and not upright.cut else None
    ends = (top[0] if top else rows[0]), (foot[0] if foot else rows[1])
    left_px, left_errors = _ends(left, lines[0], ends, plane)
    right_px, right_errors = _ends(right, lines[1], ends, plane)
    covariance = np.zeros((8, 8))
    covariance[:4, :4], covariance[4:, 4:] = left_errors, right_errors
    outer_px, outer_errors = (left_px, left_errors) if bar_right else (right_px, right_errors)
    middle = 0.5 * (left_px[1] + right_px[1])
    middle_errors = 0.25 * (left_errors[2:, 2:] + right_errors[2:, 2:])
    return SeenPost(
        left_px,
        right_px,
        covariance,
        middle if foot else None,
        middle_errors + np.diag([0.0, foot[1]]) if foot else None,
        outer_px[0] if top else None,
        outer_errors[:2, :2] + np.diag([0.0, top[1]]) if top else None,
    )


def _in_picture(edge: FittedEdge, rows: tuple[float, float], plane: Plane) -> FloatArray:
    """(2,) u = a + b v in the picture between the two rows, where it is straight enough for feet and tops."""
    if plane.is_picture:
        return edge.line
    pixels = _points(edge, np.array(rows), plane)
    slope = (pixels[1, 0] - pixels[0, 0]) / (pixels[1, 1] - pixels[0, 1])
    return np.array([pixels[0, 0] - slope * pixels[0, 1], slope])


def _points(edge: FittedEdge, v: FloatArray, plane: Plane) -> FloatArray:
    """(k, 2) pixels of the edge at rows v (k,) of the picture, by a few steps of the secant."""
    y = v.astype(np.float64)
    pixels = np.stack([edge.x_at(y), y], axis=1)
    for _ in range(0 if plane.is_picture else 8):
        pixels = plane.to_picture(np.stack([edge.x_at(y), y], axis=1))
        y = y + (v - pixels[:, 1])
    return pixels


def _ends(edge: FittedEdge, line: FloatArray, ends: tuple[float, float], plane: Plane) -> tuple[FloatArray, FloatArray]:
    """(2, 2) the edge's upper and lower end, and the covariance (4, 4) of both across it."""
    v = np.array(ends)
    pixels = _points(edge, v, plane)
    normal = np.array([1.0, -line[1]]) / np.hypot(1.0, line[1])
    at = plane.from_picture(pixels)
    nudge = np.array([0.5, 0.0])
    moved = plane.to_picture(at + nudge) - plane.to_picture(at - nudge)
    across = np.diag(moved @ normal)
    errors = across @ edge.covariance_at(at[:, 1]) @ across
    return pixels, np.asarray(np.kron(errors, np.outer(normal, normal)))
