"""Where the robot stands when all it knows of two posts is their angle and the ratio of their sizes (sec. 2.1).

The paper's symbols: posts p1, p2 at distance A; C = |robot - p1|, B = |robot - p2|; alpha the angle between the posts
as the robot sees them, unsigned; d1, d2 their apparent sizes; beta, delta the triangle's angles at p1, p2. Only the
ratio d2 / d1 matters, so sizes may have any unit in which size is inversely proportional to distance.

An unsigned angle leaves two mirror images: the robot on the right-hand side of the way from p1 to p2 (the side of eq.
6, p1 is the left post as the robot sees it) and on the left-hand side. Both are always returned, in that order. With
bearings instead of an angle the side is known: `fieldloc.fixes.two_posts`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.fixes.inputs import exactly, trailing
from fieldloc.pose import FloatArray

_LARGEST_RATIO = 1e12  # of the sizes; beyond it the robot is inside a post by any account
_FLATTEST = 1e-12  # sine of the angle; a circle that large is a line to rounding
_RIGHT_LEFT = np.array([1.0, -1.0])


@dataclass(frozen=True, slots=True)
class CentralAngleArc:
    """All places on one side of two posts from which they are seen under the same angle, eqs. 1 and 2.

    centre: (2,) metres, field frame. radius_m: of the circle through both posts. start_rad: direction from the centre
    to post 1. sweep_rad: from there along the arc to post 2, counter-clockwise positive. The arc is the circle's major
    arc where the angle is acute, half of it at 90 degrees (Thales), the minor arc beyond.
    """

    centre: FloatArray
    radius_m: float
    start_rad: float
    sweep_rad: float

    def points(self, fraction: FloatArray) -> FloatArray:
        """Points (..., 2) of the arc, from post 1 at fraction 0 to post 2 at fraction 1."""
        angle = self.start_rad + np.asarray(fraction, dtype=np.float64) * self.sweep_rad
        return np.asarray(self.centre + self.radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def central_angle_arcs(alpha_rad: float, posts: FloatArray) -> tuple[CentralAngleArc, ...]:
    """The arcs on the right and on the left of the way from post 1 to post 2, posts (2, 2).

    The chord's central angle is 2 alpha on the major arc (eq. 1) and 2 (pi - alpha) on the minor arc (eq. 2), so the
    radius is A / (2 sin alpha) for both. Empty where there is no circle: alpha not inside (0, pi), coincident posts,
    NaN.
    """
    p1, p2 = exactly(posts, (2, 2), "posts")
    if not (np.all(np.isfinite([p1, p2])) and 0 < alpha_rad < np.pi and np.sin(alpha_rad) > _FLATTEST):
        return ()
    chord = p2 - p1
    separation = float(np.hypot(*chord))
    if separation == 0:
        return ()
    to_the_right = np.array([chord[1], -chord[0]]) / separation
    radius = separation / (2 * np.sin(alpha_rad))
    arcs = []
    for side in _RIGHT_LEFT:
        # cos / sin and not 1 / tan: zero at 90 degrees, negative (the centre changes sides) beyond
        centre = 0.5 * (p1 + p2) + side * to_the_right * radius * np.cos(alpha_rad)
        start = np.arctan2(p1[1] - centre[1], p1[0] - centre[0])
        arcs.append(CentralAngleArc(centre, float(radius), float(start), float(side * 2 * (np.pi - alpha_rad))))
    return tuple(arcs)


@dataclass(frozen=True, slots=True)
class TwoPostTriangle:
    """The triangle of post 1, post 2 and robot. Values (...), gradients (..., 3) by (alpha_rad, size 1, size 2).

    distance1_m is the paper's C, distance2_m its B, beta_rad and delta_rad the angles at post 1 and post 2 in [0, pi].
    solvable (...): False (and all else zero) where there is no triangle: equal sizes under no angle, sizes or a
    separation that are not positive, an angle outside [0, pi], NaN.
    """

    distance1_m: FloatArray
    distance2_m: FloatArray
    beta_rad: FloatArray
    delta_rad: FloatArray
    distance1_gradient: FloatArray
    distance2_gradient: FloatArray
    beta_gradient: FloatArray
    delta_gradient: FloatArray
    solvable: NDArray[np.bool_]


def two_post_triangle(alpha_rad: FloatArray, sizes: FloatArray, separation_m: FloatArray) -> TwoPostTriangle:
    """Eqs. 3-5 and their derivatives 7-10 and 12 from alpha (...), sizes (..., 2) and separation (...), corrected.

    With r = d2 / d1 = C / B and K = 1 + r^2 - 2 r cos(alpha): B = A / sqrt(K), C = r B. Eq. 5 takes the angles from
    their sine, which cannot tell an obtuse angle from an acute one and whose derivative is infinite at 90 degrees; sine
    and cosine together, beta = atan2(sin alpha, r - cos alpha) and delta = atan2(r sin alpha, 1 - r cos alpha), are
    right and regular everywhere but at K = 0. Eq. 12 has the sign of its alpha term wrong: dB/dalpha = -(B / K) r
    sin(alpha).
    """
    alpha, d1, d2, separation = np.broadcast_arrays(
        np.asarray(alpha_rad, dtype=np.float64),
        *np.moveaxis(trailing(sizes, (2,), "sizes"), -1, 0),
        np.asarray(separation_m, dtype=np.float64),
    )
    finite = np.isfinite(alpha) & np.isfinite(d1) & np.isfinite(d2) & np.isfinite(separation)
    sensible = finite & (d1 > 0) & (d2 > 0) & (separation > 0) & (alpha >= 0) & (alpha <= np.pi)
    sensible &= (d1 / _LARGEST_RATIO < d2) & (d2 / _LARGEST_RATIO < d1)
    alpha, d1, d2, a = (
        np.where(sensible, v, fill) for v, fill in ((alpha, 1.0), (d1, 1.0), (d2, 1.0), (separation, 1.0))
    )
    r = d2 / d1
    cos, sin = np.cos(alpha), np.sin(alpha)
    # (1 - r)^2 + 4 r sin^2(alpha / 2) is 1 + r^2 - 2 r cos(alpha) without cancellation
    k = (1 - r) ** 2 + 4 * r * np.sin(alpha / 2) ** 2
    solvable = sensible & np.isfinite(k) & (k > 0)
    k = np.where(solvable, k, 1.0)
    b = a / np.sqrt(k)
    c = r * b
    r_gradient = np.stack([np.zeros_like(r), -r / d1, r / d2], axis=-1)
    alpha_gradient = np.array([1.0, 0.0, 0.0])
    b_gradient = -(b / k)[..., None] * ((r * sin)[..., None] * alpha_gradient + (r - cos)[..., None] * r_gradient)
    c_gradient = b[..., None] * r_gradient + r[..., None] * b_gradient
    beta_gradient = ((r * cos - 1) / k)[..., None] * alpha_gradient - (sin / k)[..., None] * r_gradient
    delta_gradient = ((r * cos - r * r) / k)[..., None] * alpha_gradient + (sin / k)[..., None] * r_gradient

    def shown(value: FloatArray) -> FloatArray:
        return np.where(solvable if value.ndim == solvable.ndim else solvable[..., None], value, 0.0)

    return TwoPostTriangle(
        distance1_m=shown(c),
        distance2_m=shown(b),
        beta_rad=shown(np.arctan2(sin, r - cos)),
        delta_rad=shown(np.arctan2(r * sin, 1 - r * cos)),
        distance1_gradient=shown(c_gradient),
        distance2_gradient=shown(b_gradient),
        beta_gradient=shown(beta_gradient),
        delta_gradient=shown(delta_gradient),
        solvable=solvable,
    )


@dataclass(frozen=True, slots=True)
class TwoPostPositions:
    """Both mirror positions of the robot, right of the way from post 1 to post 2 first.

    position: (..., 2 sides, 2) metres, field frame. jacobian: (..., 2 sides, 2, 3) by (alpha_rad, size 1, size 2).
    solvable: (...); where it is False position and Jacobian are zero.
    """

    position: FloatArray
    jacobian: FloatArray
    solvable: NDArray[np.bool_]


def positions_from_angle(alpha_rad: FloatArray, sizes: FloatArray, posts: FloatArray) -> TwoPostPositions:
    """Eqs. 6 and 11: the positions seen under alpha (...) and sizes (..., 2) of posts (..., 2, 2), with their Jacobian.

    Eq. 6's two lines, from post 1 and from post 2, are the same point once beta and delta are right; post 1 is used.
    """
    points = trailing(posts, (2, 2), "posts")
    finite = np.asarray(np.isfinite(points).all((-1, -2)))
    points = np.where(finite[..., None, None], points, 0.0)
    chord = points[..., 1, :] - points[..., 0, :]
    triangle = two_post_triangle(alpha_rad, sizes, np.hypot(chord[..., 0], chord[..., 1]))
    theta12 = np.arctan2(chord[..., 1], chord[..., 0])
    direction = theta12[..., None] - _RIGHT_LEFT * triangle.beta_rad[..., None]
    along = np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    across = np.stack([-np.sin(direction), np.cos(direction)], axis=-1)
    c = triangle.distance1_m[..., None, None]
    position = points[..., None, 0, :] + c * along
    direction_gradient = -_RIGHT_LEFT[:, None] * triangle.beta_gradient[..., None, :]
    jacobian = (
        along[..., :, None] * triangle.distance1_gradient[..., None, None, :]
        + c[..., None] * across[..., :, None] * direction_gradient[..., None, :]
    )
    solvable = np.asarray(triangle.solvable)
    return TwoPostPositions(
        position=np.where(solvable[..., None, None], position, 0.0),
        jacobian=np.where(solvable[..., None, None, None], jacobian, 0.0),
        solvable=solvable,
    )
