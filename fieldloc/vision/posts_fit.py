"""Where exactly posts' edges are: straight lines through what is found in blocks of their rows.

Numbers in a picture go with light to some power that is not known, between 1 and 1 / 2.2 in most cameras; it makes what
is bright wider on both sides. So all is fitted twice, as if it were the one and the other: the edges are half way
between, and the difference is as uncertain as the power, for both edges together. How light falls off towards the edges
is known as roughly: a third fit, that knows nothing of it, says how much depends on it. The rest of the covariance is
the scatter of the blocks about the lines.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.posts_profile import Profiles, fit_profiles
from fieldloc.vision.straight import Plane

_GAMMA = 2.2
_BLOCKS = 6  # of rows along a post
_LEAST_BLOCKS = 4  # in which both edges are found
_MOST_ROWS = 8  # of a block
_SAMPLES = 30  # across
_ACROSS = np.linspace(-1.0, 1.0, _SAMPLES)
_MARGIN = 0.5  # of the width, beside either edge
_MARGIN_PX = 3.5, 12.0
_INSIDE_PX = 1.5  # what must be seen beside an edge; beyond the picture its border goes on
_END = 0.04  # of the length at either end, where crossbar and foot begin
_SHAPE = 0.5  # of what it matters that a round post is not of one light all over, as an error
_STEPS = 4  # of reweighting
_TUNING = 2.5  # of Cauchy's weights, in standard deviations
LIGHT = (255.0 * (np.arange(256) / 255.0) ** _GAMMA).astype(np.float32)
"""(256,) light by a picture's numbers, both from 0 to 255, as most cameras have it."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedEdges:
    """lines: (2, 2) intercept and slope of x = a + b (y - centre) of the left and the right edge, in the plane of
    straight lines. covariance: (4, 4) of these numbers."""

    lines: FloatArray
    centre: float
    covariance: FloatArray

    def x_at(self, side: int, y: FloatArray) -> FloatArray:
        return np.asarray(self.lines[side, 0] + self.lines[side, 1] * (y - self.centre))


@dataclass(frozen=True, slots=True, eq=False)
class RoughPost:
    """left, right: (2,) edges u = a + b v. rows: between which they are seen."""

    left: FloatArray
    right: FloatArray
    rows: tuple[float, float]

    @property
    def width_px(self) -> float:
        return float((self.right - self.left) @ (1.0, 0.5 * (self.rows[0] + self.rows[1])))


@dataclass(frozen=True, slots=True, eq=False)
class _Sampled:
    """values: (3, blocks, samples) as numbers, as light, and as numbers again. at: (samples,) offsets where the post is
    width_px wide, which are shares `scale` (blocks,) of those at the blocks. middle, place: (blocks,) u and v."""

    values: FloatArray
    at: FloatArray
    width_px: float
    scale: FloatArray
    middle: FloatArray
    place: FloatArray


def fit_edges(picture: UInt8Array, posts: list[RoughPost], plane: Plane) -> list[FittedEdges | None]:
    """The edges of each post; None where too little of it is seen."""
    sampled = [_sample(picture, post) for post in posts]
    whole = [one for one in sampled if one is not None]
    if not whole:
        return [None] * len(posts)
    each = 3 * _BLOCKS
    values = np.concatenate([one.values.reshape(each, _SAMPLES) for one in whole])
    at = np.repeat(np.stack([one.at for one in whole]), each, axis=0)
    width = np.repeat([one.width_px for one in whole], each)
    flat = np.tile(np.repeat([False, False, True], _BLOCKS), len(whole))
    fitted = iter(_lines(fit_profiles(values, at, width, flat), whole, plane))
    return [None if one is None else next(fitted) for one in sampled]


def _sample(picture: UInt8Array, post: RoughPost) -> _Sampled | None:
    height, columns = picture.shape[:2]
    margin = _END * (post.rows[1] - post.rows[0])
    first, last = max(0.0, post.rows[0] + margin), min(height - 1.0, post.rows[1] - margin)
    width = post.width_px
    if last - first < _BLOCKS or width < 1.0:
        return None
    v = np.linspace(first, last, _BLOCKS * int(min(max((last - first) / _BLOCKS, 1.0), _MOST_ROWS)))
    middle = 0.5 * (post.left[0] + post.right[0] + (post.left[1] + post.right[1]) * v)
    # by perspective posts get wider or narrower along them, by little
    scale = (post.right[0] - post.left[0] + (post.right[1] - post.left[1]) * v) / width
    at = _ACROSS * (0.5 * width + min(max(_MARGIN * width, _MARGIN_PX[0]), _MARGIN_PX[1]))
    u = middle[:, None] + scale[:, None] * at
    half = 0.5 * scale * width
    if (middle - half).min() < _INSIDE_PX or (middle + half).max() > columns - 1 - _INSIDE_PX:
        return None
    both = [one.reshape(_BLOCKS, -1, _SAMPLES, 3).mean(axis=1) for one in _between_pixels(picture, u, v)]
    values = [one @ _direction(one, at, width) for one in both]
    place, scale, middle = (one.reshape(_BLOCKS, -1).mean(axis=1) for one in (v, scale, middle))
    return _Sampled(np.array([*values, values[0]]), at, width, scale, middle, place)


def _between_pixels(picture: UInt8Array, u: FloatArray, v: FloatArray) -> list[FloatArray]:
    """(rows, samples, 3) of the picture's numbers and of the light they stand for, at points between pixels."""
    top, left = max(0, int(v.min()) - 1), max(0, int(u.min()) - 1)
    part = np.ascontiguousarray(picture[top : int(v.max()) + 3, left : max(0, int(u.max())) + 3])
    columns = (u - left).astype(np.float32)
    rows = np.broadcast_to((v - top).astype(np.float32)[:, None], u.shape)
    both = part.astype(np.float32), cv2.LUT(part, LIGHT)
    at = [cv2.remap(one, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for one in both]
    return [np.asarray(one, dtype=np.float64) for one in at]


def _direction(numbers: FloatArray, at: FloatArray, width: float) -> FloatArray:
    """(3,) of length 1: in which colour the post differs most from what is beside it."""
    inside = numbers[:, np.abs(at) < 0.3 * width].mean(axis=(0, 1))
    difference = inside - numbers[:, np.abs(at) > 0.5 * width + 1.5].mean(axis=(0, 1))
    return np.asarray(difference / max(float(np.linalg.norm(difference)), 1e-9))


def _lines(profiles: Profiles, posts: list[_Sampled], plane: Plane) -> list[FittedEdges | None]:
    shape = len(posts), 3, _BLOCKS
    edges = profiles.edges.reshape(*shape, 2)
    place = np.array([post.place for post in posts])[:, None, :, None]
    middle = np.array([post.middle for post in posts])[:, None, :, None]
    scale = np.array([post.scale for post in posts])[:, None, :, None]
    u = middle + scale * edges
    points = plane.from_picture(np.stack([u, np.broadcast_to(place, u.shape)], axis=-1))
    points = points.transpose(0, 1, 3, 2, 4)  # post, way of fitting, side, block
    exists = np.isfinite(points).all(axis=-1)
    good = profiles.good.reshape(shape)[:, :, None] & exists
    count = np.maximum(np.count_nonzero(exists, axis=(1, 2, 3)), 1)
    centre = np.where(exists, points[..., 1], 0.0).sum(axis=(1, 2, 3)) / count
    variance = profiles.variance.reshape(*shape, 2).transpose(0, 1, 3, 2)
    weight = np.where(good, 1.0 / (np.where(good, variance, 1.0) + 1e-4), 0.0)
    x, y = np.where(good, points[..., 0], 0.0), np.where(good, points[..., 1] - centre[:, None, None, None], 0.0)
    solution, covariance = _robust(x, y, weight)
    enough = np.count_nonzero(good, axis=-1).min(axis=-1) >= _LEAST_BLOCKS
    out: list[FittedEdges | None] = []
    for lines, errors, seen, middle_y in zip(solution, covariance, enough, centre, strict=True):
        if not seen[:2].all():
            out.append(None)
            continue
        total = np.zeros((4, 4))
        for side, own in ((0, slice(0, 2)), (1, slice(2, 4))):
            total[own, own] = 0.5 * (errors[0, side] + errors[1, side])
        tone = (lines[1] - lines[0]).ravel()
        total += np.outer(tone, tone) / 12.0  # anything between the two is as likely
        if seen[2]:
            form = (lines[2] - lines[0]).ravel()
            total += _SHAPE**2 * np.outer(form, form)
        out.append(FittedEdges(0.5 * (lines[0] + lines[1]), float(middle_y), total))
    return out


def _robust(x: FloatArray, y: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(..., 2) of x = a + b y through points (..., n), and their covariances, from the scatter or what the weights say,
    whichever is more."""
    robust = np.ones_like(weight)
    count = np.count_nonzero(weight, axis=-1)
    middle = np.maximum(count - 1, 0) // 2
    each = tuple(np.indices(count.shape))
    terms = np.array([np.ones_like(y), y, y * y, x, x * y])
    for step in range(_STEPS):
        both = weight * robust
        mass, first, second, side, cross = (both * terms).sum(axis=-1)
        determinant = np.maximum(mass * second - first**2, 1e-12)
        intercept, slope = (second * side - first * cross) / determinant, (mass * cross - first * side) / determinant
        residual = x - intercept[..., None] - slope[..., None] * y
        if step == _STEPS - 1:
            break
        scaled = np.where(weight > 0.0, np.abs(residual) * np.sqrt(weight), np.inf)
        scale = np.maximum(1.4826 * np.sort(scaled, axis=-1)[*each, middle], 1e-3)[..., None]
        robust = np.where(weight > 0.0, 1.0 / (1.0 + (np.minimum(scaled, 1e6) / (_TUNING * scale)) ** 2), 0.0)
    spread = np.sum(both * residual**2, axis=-1) / np.maximum(robust.sum(axis=-1) - 2.0, 1.0)
    inverse = np.stack([np.stack([second, -first], axis=-1), np.stack([-first, mass], axis=-1)], axis=-2)
    covariance = inverse * (np.maximum(spread, 1.0) / determinant)[..., None, None]
    return np.stack([intercept, slope], axis=-1), covariance
