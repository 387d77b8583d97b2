"""Position and heading from the bearings of two posts and the ratio of their sizes (sec. 2.1): no scale needed.

With complex numbers the paper's triangle is one line. Let omega = i alpha - rho with alpha = bearing 2 - bearing 1
(signed) and rho = log(size 2 / size 1). The posts are seen at C e^{i b1} and B e^{i b2}, C / B = e^rho, and the map
turns and scales that picture onto the field, so the robot stands at

    z = p1 - (p2 - p1) w,   w = 1 / (e^omega - 1),   heading = arg(p2 - p1) + arg(w) - b1.

|w| = C / A and |1 + w| = B / A. z is an analytic function of omega: an error of size (sigma_alpha, sigma_rho) moves the
robot by B C / A times as much, alpha away from the circle of eq. 1 and rho along it. Nothing special happens where the
paper's beta or delta is 90 degrees, nor where the robot is in line with the posts; only omega = 0, the robot infinitely
far away, is singular.

How many poses explain two posts depends on what is known:

    which post is which, and both bearings   one pose              fix_two_posts
    both bearings, posts all look alike      two for each pair     fix_two_alike_posts
    the unsigned angle only                  two positions         fieldloc.fixes.central_angle

Sizes may have any unit in which size is inversely proportional to distance: sin of a cylinder's half-width (exact, see
`fieldloc.fixes.cylinder`), the paper's f D / C. Posts of different diameters: divide each size by its diameter.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fieldloc.covariance import propagate
from fieldloc.fixes.inputs import exactly, posts_covariance_of, semidefinite, trailing
from fieldloc.fixes.post_fix import PostFix
from fieldloc.fixes.spread import UNKNOWN, honest_covariance
from fieldloc.pose import FloatArray, wrap

_FAR = 3.0  # standard deviations by which the picture must differ from that of a robot infinitely far away
_SIZES = (2, 3)  # of the inputs: the weak ones, whose error bends the solution
_LARGEST_RATIO = 1e12  # of the sizes; beyond it the robot is inside a post by any account
_FARTHEST = 1e-12  # |omega|; below it rounding alone decides where the robot is
_COINCIDENT_M = 1e-9
_NO_SIZE = 1e-100  # one over it is still a number


@dataclass(frozen=True, slots=True)
class TwoPostPoses:
    """Poses from two posts, one or a stack of them.

    pose: (..., 3) field_from_robot. jacobian: (..., 3, 4) of (x, y, heading) by (bearing 1, bearing 2, size 1, size 2).
    post_jacobian: (..., 3, 4) by the posts' (x1, y1, x2, y2).
    solvable: (...) False, and all else zero, where two posts make no triangle.
    """

    pose: FloatArray
    jacobian: FloatArray
    post_jacobian: FloatArray
    solvable: NDArray[np.bool_]

    def first_order_covariance(self, covariance: FloatArray, posts_covariance: FloatArray | None = None) -> FloatArray:
        """(..., 3, 3) of (x_m, y_m, heading_rad) in field axes, eqs. 7-12; infinite variances where not solvable.

        covariance: (..., 4, 4) of (bearing 1, bearing 2, size 1, size 2), correlations and all.
        posts_covariance: (..., 2, 2, 2) of each post's surveyed position (Krotkov), field axes; None: exact.
        """
        noise, survey = semidefinite(covariance, 4), posts_covariance_of(posts_covariance, 2)
        total = propagate(self.jacobian, noise) + propagate(self.post_jacobian, survey)
        return np.where(self.solvable[..., None, None], total, UNKNOWN)


def poses_from_two_posts(bearings_rad: FloatArray, sizes: FloatArray, posts: FloatArray) -> TwoPostPoses:
    """The one pose from which labelled posts (..., 2, 2) appear at bearings (..., 2) with sizes (..., 2).

    All broadcast. Not solvable: coincident posts, sizes that are not positive, equal sizes under no angle, NaN.
    """
    bearings = trailing(bearings_rad, (2,), "bearings_rad")
    sizes = trailing(sizes, (2,), "sizes")
    posts = trailing(posts, (2, 2), "posts")
    shape = np.broadcast_shapes(bearings.shape[:-1], sizes.shape[:-1], posts.shape[:-2])
    finite = np.isfinite(bearings).all(-1) & np.isfinite(sizes).all(-1) & np.isfinite(posts).all((-1, -2))
    solvable = np.broadcast_to(finite & (sizes > _NO_SIZE).all(-1), shape)
    b1, b2 = np.moveaxis(np.where(solvable[..., None], bearings, [0.0, 1.0]), -1, 0)
    d1, d2 = np.moveaxis(np.where(solvable[..., None], sizes, 1.0), -1, 0)
    points = np.where(solvable[..., None, None], posts, [[0.0, 0.0], [1.0, 0.0]])
    p1, p2 = np.moveaxis(points[..., 0] + 1j * points[..., 1], -1, 0)
    chord = p2 - p1
    rho = np.log(d2) - np.log(d1)
    omega = 1j * wrap(b2 - b1) - rho
    solvable = solvable & (np.abs(omega) > _FARTHEST) & (np.abs(chord) > _COINCIDENT_M)
    solvable = solvable & (np.abs(rho) < np.log(_LARGEST_RATIO))
    omega, chord = np.where(solvable, omega, 1.0), np.where(solvable, chord, 1.0)

    w = 1 / np.expm1(omega)
    w_plus_1 = -1 / np.expm1(-omega)
    position = p1 - chord * w
    heading = wrap(np.angle(chord) + np.angle(w) - b1)
    pose = np.stack([position.real, position.imag, heading], axis=-1)

    zero = np.zeros(shape)
    omega_by_input = np.stack([zero - 1j, zero + 1j, 1 / d1, -1 / d2], axis=-1)
    # dw / domega = -w (1 + w), dlog(w) / domega = -(1 + w)
    position_by_input = (chord * w * w_plus_1)[..., None] * omega_by_input
    heading_by_input = (-w_plus_1[..., None] * omega_by_input).imag - np.array([1.0, 0.0, 0.0, 0.0])
    # a post's x moves complex numbers by 1, its y by i
    steps = np.array([1, 1j])
    position_by_post = np.concatenate([w_plus_1[..., None] * steps, -w[..., None] * steps], axis=-1)
    heading_by_post = np.concatenate([-steps / chord[..., None], steps / chord[..., None]], axis=-1).imag
    return TwoPostPoses(
        pose=np.where(solvable[..., None], pose, 0.0),
        jacobian=_rows(position_by_input, heading_by_input, solvable),
        post_jacobian=_rows(position_by_post, heading_by_post, solvable),
        solvable=np.asarray(solvable),
    )


def covariance_of_two_posts(
    bearings_rad: FloatArray,
    sizes: FloatArray,
    covariance: FloatArray,
    posts: FloatArray,
    posts_covariance: FloatArray | None = None,
) -> FloatArray:
    """(..., 3, 3) of (x_m, y_m, heading_rad) in field axes, honest also for far posts; shapes as in `TwoPostPoses`.

    The first-order covariance as long as it is honest (`fieldloc.fixes.spread`); beyond, where the error runs along the
    bend of the circle, the second moment over the sizes' noise. Infinite variances where there is no pose or nothing
    finite could be honest: a size within about three standard deviations of zero, or the whole picture within three of
    that of a robot infinitely far away.
    """
    bearings, sizes = trailing(bearings_rad, (2,), "bearings_rad"), trailing(sizes, (2,), "sizes")
    posts, noise = trailing(posts, (2, 2), "posts"), semidefinite(covariance, 4)
    survey = posts_covariance_of(posts_covariance, 2)
    found = poses_from_two_posts(bearings, sizes, posts)
    shape = np.broadcast_shapes(found.solvable.shape, noise.shape[:-2], survey.shape[:-2])
    inputs = np.empty((*shape, 4))
    inputs[..., :2], inputs[..., 2:] = bearings, sizes
    usable = found.solvable & ~_could_be_infinitely_far(np.where(found.solvable[..., None], inputs, 1.0), noise)

    def solve(at: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
        poses = poses_from_two_posts(at[..., :2], at[..., 2:], posts)
        return poses.pose, poses.jacobian, propagate(poses.post_jacobian, survey), poses.solvable

    out = honest_covariance(solve, inputs, noise, weak=_SIZES)
    return np.where(usable[..., None, None], out, UNKNOWN)


def fix_two_posts(
    bearings_rad: FloatArray,
    sizes: FloatArray,
    covariance: FloatArray,
    posts: FloatArray,
    posts_covariance: FloatArray | None = None,
) -> tuple[PostFix, ...]:
    """The pose from two labelled posts (2, 2), with bearings (2,), sizes (2,), covariance (4, 4) of all four, jointly.

    posts_covariance: (2, 2, 2) of the posts' surveyed positions; None where they are exact. The covariance is that of
    `covariance_of_two_posts`; empty where that is not finite.
    """
    bearings, sizes = exactly(bearings_rad, (2,), "bearings_rad"), exactly(sizes, (2,), "sizes")
    posts, covariance = exactly(posts, (2, 2), "posts"), exactly(covariance, (4, 4), "covariance")
    found = covariance_of_two_posts(bearings, sizes, covariance, posts, posts_covariance)
    if not np.all(np.isfinite(found)):
        return ()
    at = poses_from_two_posts(bearings, sizes, posts)
    first_order = at.first_order_covariance(covariance, posts_covariance)
    return (PostFix(at.pose, found, solver="two_posts.fix_two_posts", first_order_covariance=first_order),)


def fix_two_alike_posts(
    bearings_rad: FloatArray,
    sizes: FloatArray,
    covariance: FloatArray,
    positions: FloatArray,
    positions_covariance: FloatArray | None = None,
) -> tuple[PostFix, ...]:
    """All poses when the two posts seen may be any two of the map's (n, 2), in either order: n (n - 1) of them.

    The scale is unknown, so nothing in the picture prefers a pair: all weights are equal.
    positions_covariance: (n, 2, 2).
    """
    positions = trailing(positions, (2,), "positions")
    number = len(positions)
    survey = np.zeros((number, 2, 2)) if positions_covariance is None else positions_covariance
    survey = exactly(survey, (number, 2, 2), "positions_covariance")
    pairs = [[i, j] for i in range(number) for j in range(number) if i != j]
    fixes = [
        replace(fix, solver="two_posts.fix_two_alike_posts")
        for pair in pairs
        for fix in fix_two_posts(bearings_rad, sizes, covariance, positions[pair], survey[pair])
    ]
    return tuple(fixes)


def _could_be_infinitely_far(inputs: FloatArray, covariance: FloatArray) -> NDArray[np.bool_]:
    """(...): whether noise can make this picture out of that of a robot at no angle and equal distance, omega = 0."""
    b1, b2, d1, d2 = np.moveaxis(inputs, -1, 0)
    positive = (d1 > _NO_SIZE) & (d2 > _NO_SIZE)
    d1, d2 = np.where(positive, d1, 1.0), np.where(positive, d2, 1.0)
    alpha_rho = np.stack([wrap(b2 - b1), np.log(d2) - np.log(d1)], axis=-1)
    jacobian = np.zeros((*d1.shape, 2, 4))
    jacobian[..., 0, :2] = [-1.0, 1.0]
    jacobian[..., 1, 2], jacobian[..., 1, 3] = -1 / d1, 1 / d2
    noise = propagate(jacobian, covariance)
    # no inverse, the noise may be singular: x^T N^-1 x < f^2 is the same as f^2 N - x x^T having no negative eigenvalue
    margin = _FAR**2 * noise - alpha_rho[..., :, None] * alpha_rho[..., None, :]
    return np.asarray(np.linalg.eigvalsh(margin)[..., 0] >= 0)


def _rows(position: NDArray[np.complex128], heading: FloatArray, solvable: NDArray[np.bool_]) -> FloatArray:
    rows = np.stack([position.real, position.imag, heading], axis=-2)
    return np.where(solvable[..., None, None], rows, 0.0)
