"""Pose from two posts when the scale is known too: the angle and both distances, each weighted by what it is worth.

Focal length and diameter known, each post gives a distance of its own, and the three unknowns have four observations.
The pose is the most likely one. One circle of eq. 1 can hold two places that explain both distances nearly equally
well, one to each side of its top: each is a solution with its own weight, unless the valley between them is too shallow
to tell them apart.

Far posts leave a banana along the circle. Where first order, (J^T W J)^-1, does not cover it, the covariance is the
second moment about the solution of the likelihood along the circle, the robot anywhere on the field equally likely
beforehand.
"""

import math
from dataclasses import replace

import numpy as np

from fieldloc.covariance import check_covariance, propagate
from fieldloc.fixes.inputs import exactly, posts_covariance_of
from fieldloc.fixes.post_fix import PostFix
from fieldloc.fixes.ranged_likelihood import Profile, RangedLikelihood, survey_noise
from fieldloc.fixes.sizes import SizeModel
from fieldloc.fixes.spread import is_first_order_honest
from fieldloc.pose import FloatArray, wrap

_REWEIGHTINGS = 3  # the posts' own errors enter the weights from where the robot is; they hardly depend on it
_BEYOND = 40.0  # chi2 above the best at which nothing is left of a likelihood
_VALLEY = 4.0  # chi2 between two minima that makes two solutions of them
_GRID_STEP = 0.1  # of rho, relative to |omega|: the profile has no finer feature
_GRID = 201


def fix_ranged_posts(
    bearings_rad: FloatArray,
    sizes: FloatArray,
    covariance: FloatArray,
    posts: FloatArray,
    size_model: SizeModel,
    posts_covariance: FloatArray | None = None,
) -> tuple[PostFix, ...]:
    """All poses that explain two labelled posts (2, 2), most likely first.

    bearings_rad (2,), sizes (2,) in what the model takes, covariance (4, 4) of (bearing 1, bearing 2, size 1, size 2),
    positive definite; posts_covariance (2, 2, 2) of the surveyed positions. log_weight is the log-likelihood of the
    four observations. Empty for coincident posts, sizes that have no distance, NaN.
    """
    bearings, sizes = exactly(bearings_rad, (2,), "bearings_rad"), exactly(sizes, (2,), "sizes")
    points, noise = exactly(posts, (2, 2), "posts"), check_covariance(covariance, 4)
    survey = posts_covariance_of(posts_covariance, 2)
    finite = np.all(np.isfinite(bearings)) and np.all(np.isfinite(sizes)) and np.all(np.isfinite(points))
    if not finite or np.all(points[0] == points[1]):
        return ()
    ranges = size_model.range_of(sizes)
    if not np.all(np.isfinite(ranges) & (ranges > 0)):
        return ()
    observed = np.concatenate([bearings, sizes])
    places = _minima(RangedLikelihood(points, size_model, observed, noise), ranges)
    fixes: list[PostFix] = []
    for place in places:
        theta, likelihood = place, RangedLikelihood(points, size_model, observed, noise)
        for _ in range(_REWEIGHTINGS if survey.any() else 0):
            total = noise + survey_noise(points, survey, size_model, likelihood.poses(theta)[0][:2])
            likelihood = RangedLikelihood(points, size_model, observed, total)
            theta, _, _ = likelihood.polish(theta)
        fixes += _fix(likelihood, theta, [_valley(likelihood, theta, p)[0] for p in places if p is not place])
    return _best_first(fixes)


def fix_alike_ranged_posts(
    bearings_rad: FloatArray,
    sizes: FloatArray,
    covariance: FloatArray,
    positions: FloatArray,
    size_model: SizeModel,
    positions_covariance: FloatArray | None = None,
) -> tuple[PostFix, ...]:
    """The same when the two posts may be any two of the map's (n, 2), in either order.

    The weights tell the pairs apart. All posts have the model's diameter. How far the posts seen are from each other is
    known with the scale, so pairs at another distance get a chi2 and a weight to match; nothing is cut off here.
    positions_covariance: (n, 2, 2).
    """
    number = len(positions)
    places = exactly(positions, (number, 2), "positions")
    survey = np.zeros((number, 2, 2)) if positions_covariance is None else positions_covariance
    survey = exactly(survey, (number, 2, 2), "positions_covariance")
    pairs = [[i, j] for i in range(number) for j in range(number) if i != j]
    return _best_first(
        [
            replace(fix, solver="ranged_posts.fix_alike_ranged_posts")
            for pair in pairs
            for fix in fix_ranged_posts(bearings_rad, sizes, covariance, places[pair], size_model, survey[pair])
        ]
    )


def _minima(likelihood: RangedLikelihood, ranges: FloatArray) -> list[FloatArray]:
    """theta (3,) at each minimum of the profile that no shallow valley joins to a better one, best first."""
    alpha = float(wrap(likelihood.observed[1] - likelihood.observed[0]))
    separation2 = float(np.sum((likelihood.posts[1] - likelihood.posts[0]) ** 2))
    # where on the circle B C is as observed: |w (1 + w)| = B C / A^2 = 1 / (2 (cosh rho - cos alpha))
    aside = np.arccosh(np.clip(np.cos(alpha) + separation2 / (2 * ranges[0] * ranges[1]), 1.0, 1e9))
    largest = max(aside, abs(float(np.log(ranges[0] / ranges[1])))) + 3.0
    unit = max(abs(alpha), 1e-6)
    steps = np.arange(0.5, np.arcsinh(largest / unit) / _GRID_STEP + 1)
    rho = unit * np.sinh(_GRID_STEP * np.concatenate([-steps[::-1], steps]))
    chi2 = likelihood.profile(rho).chi2
    lower = np.flatnonzero((chi2[1:-1] < chi2[:-2]) & (chi2[1:-1] <= chi2[2:])) + 1
    found = sorted((likelihood.polish(likelihood.profile(rho[[i]]).theta[0]) for i in lower), key=lambda end: end[1])
    kept: list[FloatArray] = []
    for theta, chi2_here, _ in found:
        if all(_valley(likelihood, theta, better)[1] > chi2_here + _VALLEY for better in kept):
            kept.append(theta)
    return kept


def _valley(likelihood: RangedLikelihood, one: FloatArray, other: FloatArray) -> tuple[float, float]:
    """rho and chi2 of the least likely place between two."""
    rho = np.linspace(one[2], other[2], _GRID)
    chi2 = likelihood.profile(rho).chi2
    highest = int(np.argmax(chi2))
    return float(rho[highest]), float(chi2[highest])


def _fix(likelihood: RangedLikelihood, theta: FloatArray, borders: list[float]) -> list[PostFix]:
    """The fix at a minimum; none where nothing there depends on one of the unknowns, as inside of a post."""
    theta, chi2, information = likelihood.polish(theta)
    if np.linalg.eigvalsh(information)[0] <= 0:
        return []
    pose, by_theta = likelihood.poses(theta)
    covariance_of_theta = np.asarray(np.linalg.inv(information))
    first_order = propagate(by_theta, covariance_of_theta)
    ends = _ends(likelihood, float(theta[2]), chi2, math.sqrt(covariance_of_theta[2, 2]), borders)
    along = likelihood.profile(np.asarray(np.linspace(*ends, _GRID), dtype=np.float64))
    spread = _second_moment(likelihood, along, pose)
    covariance = first_order if is_first_order_honest(first_order, spread) else spread
    weight = -0.5 * (chi2 + float(np.linalg.slogdet(likelihood.noise)[1]) + 4 * math.log(math.tau))
    return [PostFix(pose, covariance, weight, "ranged_posts.fix_ranged_posts", chi2, first_order)]


def _ends(
    likelihood: RangedLikelihood, rho: float, chi2: float, sigma: float, borders: list[float]
) -> tuple[float, float]:
    """Where to both sides of a minimum the likelihood is gone, or another solution's begins."""
    reach: FloatArray = sigma * 1.5 ** np.arange(-4.0, 40.0)
    ends = []
    for side in (-1.0, 1.0):
        gone = likelihood.profile(rho + side * reach).chi2 > chi2 + _BEYOND
        far = float(reach[int(np.argmax(gone)) if np.any(gone) else -1])
        ahead = [side * (border - rho) for border in borders if side * (border - rho) > 0]
        ends.append(rho + side * min(far, *ahead, math.inf))
    return ends[0], ends[1]


def _second_moment(likelihood: RangedLikelihood, along: Profile, pose: FloatArray) -> FloatArray:
    """(3, 3) of (x_m, y_m, heading_rad) about a pose (3,), over the likelihood along rho."""
    poses, by_theta = likelihood.poses(along.theta)
    # Laplace over the bearings; a robot anywhere on the field equally likely: the pose's volume element
    volume = np.abs(np.linalg.det(by_theta)) * np.sqrt(np.linalg.det(along.bearing_covariance))
    weights = np.exp(-0.5 * (along.chi2 - along.chi2.min())) * volume
    step = poses - pose
    step[:, 2] = wrap(step[:, 2])
    moments = step[:, :, None] * step[:, None, :] + propagate(by_theta[..., :2], along.bearing_covariance)
    return np.asarray(np.einsum("k,kij->ij", weights / weights.sum(), moments))


def _best_first(fixes: list[PostFix]) -> tuple[PostFix, ...]:
    return tuple(sorted(fixes, key=lambda fix: -fix.log_weight))
