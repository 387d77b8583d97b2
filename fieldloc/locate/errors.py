"""How far, in pixels, what was seen is off what a camera at k states would see, and how that changes with the states.

Everything is a plane through the camera (a line of the ground; the side of a post) that the rays to a line's or an
edge's ends should lie in, a point in a direction (a post's foot, a mark), or a circle on the ground. Jacobians are
those at no error: what the lens and the rays' own turning add is of second order. Columns as in `states`, and one more
for a focal length that is longer by a share: all that is seen should then be so much farther out.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fieldloc.locate.shape import Shape
from fieldloc.locate.sight import Points, Sight
from fieldloc.locate.states import centres, cross, rotations, turn_axes
from fieldloc.pose import FloatArray

IntArray = NDArray[np.intp]
_TINY = 1e-9
_SIDES = np.array([1.0, 1.0, -1.0, -1.0])  # of a post's four ends: left is counter-clockwise
_FAR_PX = 1e4  # what is off by more has no meaning as a number of pixels


@dataclass(frozen=True, eq=False)
class Cameras:
    """k states with what follows from them: field_from_camera (k, 3, 3), axes (k, 3, 3), centres (k, 3)."""

    states: FloatArray
    sight: Sight
    shape: Shape
    rotation: FloatArray
    axes: FloatArray
    centre: FloatArray

    @staticmethod
    def at(states: FloatArray, sight: Sight, shape: Shape) -> "Cameras":
        return Cameras(states, sight, shape, rotations(states), turn_axes(states), centres(states))

    @cached_property
    def lines(self) -> "Lines":
        return Lines.of(self)

    def turned(self, vectors: FloatArray) -> FloatArray:
        """Vectors of the camera (n, ..., 3) in the field: (k, n, ..., 3)."""
        flat = vectors.reshape(-1, 3) @ self.rotation.transpose(0, 2, 1)
        return np.asarray(flat.reshape(len(self.states), *vectors.shape))

    def columns(self, by_centre: FloatArray, by_turn: FloatArray, by_focal: FloatArray) -> FloatArray:
        """(k, ..., 7) from the change with the centre (k, ..., 3), with a turn about an axis a as a . by_turn, and with
        the focal length."""
        out = np.empty((*by_centre.shape[:-1], 7))
        out[..., 6] = by_focal
        out[..., :2], out[..., 3] = by_centre[..., :2], by_centre[..., 2]
        flat = by_turn.reshape(len(self.states), -1, 3) @ self.axes.transpose(0, 2, 1)
        turns = flat.reshape(by_turn.shape)
        out[..., 2], out[..., 4:6] = turns[..., 0], turns[..., 1:]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Every end seen beside every line of the map. rays: (k, l, 2, 3) in the field; down: (k, l, 2) how much they point
    down; off: (k, l, 2, m) how far they are from the plane through the camera and each line, slope: (k, l, 2, m) its
    change with a pixel."""

    rays: FloatArray
    down: FloatArray
    off: FloatArray
    slope: FloatArray

    @staticmethod
    def of(cameras: Cameras) -> "Lines":
        both = cameras.turned(cameras.sight.line_both)  # (k, 2, l, 2, 3)
        normals = line_normals(cameras).transpose(0, 2, 1)
        size = (*both.shape[:-1], normals.shape[2])
        off, slope = (both.reshape(size[0], -1, 3) @ normals).reshape(size).transpose(1, 0, 2, 3, 4)
        return Lines(both[:, 0], -both[:, 0, ..., 2], off, slope)


def line_normals(cameras: Cameras) -> FloatArray:
    """(k, m, 3) of the planes through the camera and each line of the map, as long as the camera is off the line."""
    shape = cameras.shape
    dx, dy = shape.directions.T
    away_x = shape.starts[:, 0] - cameras.centre[:, :1]
    away_y = shape.starts[:, 1] - cameras.centre[:, 1:2]
    height = cameras.centre[:, 2:]
    out = np.empty((*away_x.shape, 3))
    out[..., 0], out[..., 1], out[..., 2] = height * dy, -height * dx, away_x * dy - away_y * dx
    return out


def line_errors(cameras: Cameras, match: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of each seen line to its match (k, l): errors (k, l, 2, 2), Jacobian (k, l, 2, 2, 7), pixels per metre (k, l, 2).

    First of both ends, in px, then of the widths there: the logarithm of what is seen to what is expected, NaN where it
    is not seen.
    """
    sight, shape = cameras.sight, cameras.shape
    rays, across = cameras.turned(sight.line_both).transpose(1, 0, 2, 3, 4)
    normals = line_normals(cameras)[np.arange(len(match))[:, None], match][:, :, None, :]
    slope = (across * normals).sum(axis=-1)
    slope = np.where(np.abs(slope) < _TINY, _TINY, slope)
    per_m = np.abs(rays[..., 2] / slope)
    error = np.empty((*match.shape, 2, 2))
    error[:, :, 0] = np.minimum(np.maximum((rays * normals).sum(axis=-1) / slope, -_FAR_PX), _FAR_PX)
    error[:, :, 1] = np.log(sight.widths / np.maximum(per_m * shape.line_width_m, _TINY))
    direction = np.zeros((*match.shape, 1, 3))
    direction[..., 0, :2] = shape.directions[match]
    both = np.empty((*match.shape, 2, 2, 3))
    both[:, :, 0], both[:, :, 1] = rays, across
    scale = slope[:, :, None, :, None]
    by_centre = cross(both, direction[:, :, None]) / scale
    by_turn = cross(both, normals[:, :, None]) / scale
    down = np.maximum(-rays[..., 2], 1e-3)
    by_turn[:, :, 1, :, 0] += rays[..., 1] / down  # rays x up
    by_turn[:, :, 1, :, 1] -= rays[..., 0] / down
    by_focal = np.empty((match.shape[1], 2, 2))
    by_focal[:, 0], by_focal[:, 1] = -sight.line_out, -1.0
    return error, cameras.columns(by_centre, by_turn, by_focal), per_m


@dataclass(frozen=True, slots=True, eq=False)
class _Posts:
    """Seen posts against landmarks (k, p, q): how far and in which direction (k, p, q, 2) those are, radii, sines and
    cosines of half their widths; the directions (k, p, q, 4) of each end's edge."""

    far: FloatArray
    towards: FloatArray
    radius: FloatArray
    sine: FloatArray
    cosine: FloatArray
    x: FloatArray
    y: FloatArray
    rays: FloatArray
    slope: FloatArray

    @staticmethod
    def of(cameras: Cameras, match: IntArray) -> "_Posts":
        sight, shape = cameras.sight, cameras.shape
        away = shape.posts[match] - cameras.centre[:, None, None, :2]
        far = np.sqrt(np.maximum(away[..., 0] ** 2 + away[..., 1] ** 2, 1e-6))
        towards = away / far[..., None]
        radius = shape.radii[match]
        if shape.square:  # its silhouette is as wide as the square's corners are apart
            radius = radius * np.abs(towards).sum(axis=-1)
        sine = np.minimum(radius / far, 0.9)
        cosine = np.sqrt(1.0 - sine * sine)
        # the edges' directions: that of the post turned by +- asin(radius / distance)
        turn = _SIDES * sine[..., None]
        x = towards[..., 0, None] * cosine[..., None] - towards[..., 1, None] * turn
        y = towards[..., 1, None] * cosine[..., None] + towards[..., 0, None] * turn
        rays, across = cameras.turned(sight.post_rays)[:, :, None], cameras.turned(sight.post_across)[:, :, None]
        slope = across[..., 1] * x - across[..., 0] * y
        slope = np.where(np.abs(slope) < _TINY, _TINY, slope)
        return _Posts(far, towards, radius, sine, cosine, x, y, rays, slope)

    def feet(self, cameras: Cameras) -> FloatArray:
        """(k, p, q, 3) off the camera: a radius before the axis, on the ground."""
        out = np.empty((*self.far.shape, 3))
        out[..., :2] = (self.far - self.radius)[..., None] * self.towards
        out[..., 2] = -cameras.centre[:, 2, None, None]
        return out


def post_errors(cameras: Cameras, match: IntArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Of each seen post to landmarks (k, p, q): errors (k, p, q, 6) of the four ends of its edges and its foot's two
    coordinates, and whether the landmark stands before the camera. A foot that is not seen is right."""
    posts = _Posts.of(cameras, match)
    ahead = posts.rays[..., 0] * posts.x + posts.rays[..., 1] * posts.y
    error = np.empty((*match.shape, 6))
    off = (posts.rays[..., 1] * posts.x - posts.rays[..., 0] * posts.y) / posts.slope
    error[..., :4] = np.clip(off, -_FAR_PX, _FAR_PX)
    at_foot, before = point_errors(cameras, cameras.sight.feet, posts.feet(cameras))
    known = cameras.sight.feet.known[:, None]
    error[..., 4:] = np.where(known[..., None], at_foot, 0.0)
    return error, (ahead > 0.0).all(axis=-1) & (before | ~known)


def post_jacobians(cameras: Cameras, match: IntArray) -> FloatArray:
    """(k, p, q, 6, 7) of `post_errors`."""
    posts = _Posts.of(cameras, match)
    ahead = posts.rays[..., 0] * posts.x + posts.rays[..., 1] * posts.y
    normal = np.zeros((*posts.x.shape, 3))
    normal[..., 0], normal[..., 1] = -posts.y, posts.x
    # the edge's direction turns as the camera walks past the post, and as it comes nearer
    past = np.stack([posts.towards[..., 1], -posts.towards[..., 0]], axis=-1)[..., None, :]
    nearer = (_SIDES * (posts.sine / posts.cosine)[..., None])[..., None] * posts.towards[..., None, :]
    by_centre = np.zeros((*posts.x.shape, 3))
    by_centre[..., :2] = (-ahead / posts.slope)[..., None] * (past + nearer) / posts.far[..., None, None]
    jacobian = np.zeros((*match.shape, 6, 7))
    by_turn = cross(posts.rays, normal) / posts.slope[..., None]
    jacobian[..., :4, :] = cameras.columns(by_centre, by_turn, -cameras.sight.post_out[:, None])
    by_state = point_jacobians(cameras, cameras.sight.feet, posts.feet(cameras))
    jacobian[..., 4:, :] = np.where(cameras.sight.feet.known[:, None, None, None], by_state, 0.0)
    return jacobian


def point_errors(cameras: Cameras, points: Points, away: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Of points seen, n, to points (k, n, q, 3) off the camera, field axes: errors (k, n, q, 2), and whether they are
    before the camera."""
    along, before, in_field = _seen_points(cameras, points, away)
    error = (in_field @ away[..., None])[..., 0] / along[..., None]
    return np.clip(np.where(before[..., None], error, _FAR_PX), -_FAR_PX, _FAR_PX), before


def point_jacobians(cameras: Cameras, points: Points, away: FloatArray) -> FloatArray:
    """(k, n, q, 2, 7) of `point_errors`."""
    along, _, in_field = _seen_points(cameras, points, away)
    scaled = in_field / along[..., None, None]
    # scaled . (a x away) = a . (away x scaled), and the point turns back where the camera turns on
    return cameras.columns(-scaled, -cross(away[..., None, :], scaled), points.out[:, None])


def _seen_points(
    cameras: Cameras, points: Points, away: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
    """Distance along the seen ray (k, n, q), one where not before the camera; before; by_ray in the field."""
    along = np.sum(cameras.turned(points.rays)[:, :, None] * away, axis=-1)
    before = along > 1e-3
    return np.where(before, along, 1.0), before, cameras.turned(points.by_ray)[:, :, None]


def circle_errors(cameras: Cameras, circle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of the circle's points to a circle (3,) of the map: errors (k, c), pixels per metre (k, c); what is above the
    horizon is off by far."""
    seen = _SeenCircle.of(cameras, circle)
    error = np.clip((seen.far - circle[2]) / seen.scale, -_FAR_PX, _FAR_PX)
    return np.where(seen.below, error, _FAR_PX), 1.0 / seen.scale


def circle_jacobians(cameras: Cameras, circle: FloatArray) -> FloatArray:
    """(k, c, 7) of `circle_errors`."""
    seen = _SeenCircle.of(cameras, circle)
    scale = seen.scale[..., None]
    by_centre = np.empty_like(seen.rays)
    by_centre[..., :2], by_centre[..., 2] = seen.radial, seen.outward
    by_focal = -np.einsum("kcp,cp->kc", seen.slope, cameras.sight.circle_out) / seen.scale
    jacobian = cameras.columns(by_centre / scale, cross(seen.rays, seen.by_ray) / scale, by_focal)
    return np.where(seen.below[..., None], jacobian, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _SeenCircle:
    """Of points, on the ground: distances to the circle's middle (k, c), directions from it (k, c, 2), how far out they
    go for each height of the camera (k, c); the distance's change with the ray (k, c, 3) and the pixel (k, c, 2), and
    the length of that (k, c), metres."""

    rays: FloatArray
    below: NDArray[np.bool_]
    far: FloatArray
    radial: FloatArray
    outward: FloatArray
    by_ray: FloatArray
    slope: FloatArray
    scale: FloatArray

    @staticmethod
    def of(cameras: Cameras, circle: FloatArray) -> "_SeenCircle":
        sight = cameras.sight
        rays = cameras.turned(sight.circle_rays)
        below = rays[..., 2] < -1e-3
        down = np.where(below, -rays[..., 2], 1.0)
        height = cameras.centre[:, 2:]
        level = rays[..., :2] / down[..., None]
        away = (cameras.centre[:, :2] - circle[:2])[:, None] + height[..., None] * level
        far = np.sqrt(np.maximum(away[..., 0] ** 2 + away[..., 1] ** 2, 1e-12))
        radial = away / far[..., None]
        outward = radial[..., 0] * level[..., 0] + radial[..., 1] * level[..., 1]
        by_ray = np.empty_like(rays)
        by_ray[..., :2], by_ray[..., 2] = radial, outward
        by_ray *= (height / down)[..., None]
        in_camera = by_ray @ cameras.rotation
        slope = (in_camera[..., None, :] @ sight.circle_by_pixel)[..., 0, :]
        scale = np.maximum(np.sqrt(slope[..., 0] ** 2 + slope[..., 1] ** 2), _TINY)
        return _SeenCircle(rays, below, far, radial, outward, by_ray, slope, scale)
