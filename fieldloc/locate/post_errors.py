"""Posts: the two sides of an upright cylinder, each a plane through the camera, and the foot, a point."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.locate.cameras import COLUMNS, ERROR, FAR_PX, FOCAL, Cameras, IntArray, clipped, not_zero
from fieldloc.locate.states import cross
from fieldloc.pose import FloatArray

_SIDES = np.array([1.0, 1.0, -1.0, -1.0])  # of a post's four ends: left is counter-clockwise


@dataclass(frozen=True, slots=True, eq=False)
class _Posts:
    """Seen posts against landmarks (k, p, ...): how far and in which direction (..., 2) those are, sines and cosines of
    half their widths; the directions (..., 4) of each end's edge; ends' rays, how much these point ahead along the
    edge's direction, and how much the distance to that changes with a pixel; the foot off the camera (..., 3), a radius
    before the axis; distance along its ray, one where it is not before the camera, and its pixel's change in the field
    (..., 2, 3)."""

    far: FloatArray
    towards: FloatArray
    sine: FloatArray
    cosine: FloatArray
    x: FloatArray
    y: FloatArray
    rays: FloatArray
    ahead: FloatArray
    slope: FloatArray
    foot: FloatArray
    along: FloatArray
    before: NDArray[np.bool_]
    by_ray: FloatArray

    @staticmethod
    def of(cameras: Cameras, match: IntArray) -> "_Posts":
        shape = cameras.shape
        both = cameras.turned(cameras.sight.post_all)
        both = both.reshape(*both.shape[:2], *(1,) * (match.ndim - 2), *both.shape[2:])
        rays, across = both[..., :4, :], both[..., 4:8, :]
        away = shape.posts[match] - cameras.centre[:, :2].reshape(-1, *(1,) * (match.ndim - 1), 2)
        far = np.sqrt(np.maximum(away[..., 0] ** 2 + away[..., 1] ** 2, 1e-6))
        towards = away / far[..., None]
        radius = shape.radii[match]
        if shape.square:  # its silhouette is as wide as the square's corners are apart
            radius = radius * np.abs(towards).sum(axis=-1)
        sine = np.minimum(radius / far, 0.9)
        cosine = np.sqrt(1.0 - sine * sine)
        # the edges' directions: that of the post turned by +- asin(radius / distance)
        turn, ahead = _SIDES * sine[..., None], cosine[..., None]
        x = towards[..., 0, None] * ahead - towards[..., 1, None] * turn
        y = towards[..., 1, None] * ahead + towards[..., 0, None] * turn
        slope = not_zero(across[..., 1] * x - across[..., 0] * y)
        foot = np.empty((*far.shape, 3))
        foot[..., :2] = (far - radius)[..., None] * towards
        foot[..., 2] = -cameras.centre[:, 2].reshape(-1, *(1,) * (match.ndim - 1))
        along = (both[..., 8, :] * foot).sum(axis=-1)
        before = along > 1e-3
        along = np.where(before, along, 1.0)
        forward = rays[..., 0] * x + rays[..., 1] * y
        return _Posts(far, towards, sine, cosine, x, y, rays, forward, slope, foot, along, before, both[..., 9:, :])

    def put_errors(self, out: FloatArray, known: NDArray[np.bool_]) -> None:
        out[..., :4] = clipped((self.rays[..., 1] * self.x - self.rays[..., 0] * self.y) / self.slope)
        at_foot = (self.by_ray @ self.foot[..., None])[..., 0] / self.along[..., None]
        at_foot = clipped(np.where(self.before[..., None], at_foot, FAR_PX))
        out[..., 4:] = np.where(known.reshape(-1, *(1,) * (out.ndim - 2)), at_foot, 0.0)


def post_errors(cameras: Cameras, match: IntArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Of each seen post to landmarks (k, p, q): errors (k, p, q, 6) of the four ends of its edges and its foot's two
    coordinates, and whether the landmark stands before the camera. A foot that is not seen is right."""
    posts = _Posts.of(cameras, match)
    known = cameras.sight.feet.known
    error = np.empty((*match.shape, 6))
    posts.put_errors(error, known)
    return error, (posts.ahead > 0.0).all(axis=-1) & (posts.before | ~known[:, None])


def post_rows(cameras: Cameras, match: IntArray) -> FloatArray:
    """(k, p, 6, 8) of each seen post to its match (k, p), as in `post_errors`."""
    sight, posts = cameras.sight, _Posts.of(cameras, match)
    by_centre, by_turn = np.empty((2, *match.shape, 6, 3))
    # the edge's direction turns as the camera walks past the post, and as it comes nearer
    towards = posts.towards[..., None, :]
    past = np.stack([posts.towards[..., 1], -posts.towards[..., 0]], axis=-1)[..., None, :]
    nearer = (_SIDES * (posts.sine / posts.cosine)[..., None])[..., None] * towards
    forward = posts.ahead / posts.slope
    by_centre[..., :4, :2] = (-forward / posts.far[..., None])[..., None] * (past + nearer)
    by_centre[..., :4, 2] = 0.0
    down = -posts.rays[..., 2] / posts.slope
    by_turn[..., :4, 0], by_turn[..., :4, 1], by_turn[..., :4, 2] = down * posts.x, down * posts.y, forward
    scaled = posts.by_ray / posts.along[..., None, None]
    by_centre[..., 4:, :] = -scaled
    # scaled . (a x foot) = a . (foot x scaled), and the point turns back where the camera turns on
    by_turn[..., 4:, :] = cross(scaled, posts.foot[..., None, :])
    out = np.empty((*match.shape, 6, COLUMNS))
    cameras.put(out, by_centre, by_turn)
    out[..., :4, FOCAL], out[..., 4:, FOCAL] = -sight.post_out, sight.feet.out
    out[..., 4:, :] = np.where(sight.feet.known[:, None, None], out[..., 4:, :], 0.0)
    posts.put_errors(out[..., ERROR], sight.feet.known)
    return out
