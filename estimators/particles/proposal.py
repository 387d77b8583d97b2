"""Where an observation sends a cloud: particles drawn where it is likely, weighed for having been.

An observation that is much sharper than the cloud leaves hardly a particle alive. So each part of the cloud that can
pass for a Gaussian is taken to what Kalman's update makes of it, solution by solution, and the particles are weighed by

    prior x likelihood / proposal

which is what corrects for the update's being an approximation (extended Kalman proposals: Doucet, Godsill & Andrieu
2000, sec. II-D; van der Merwe et al. 2000). A share stays where it was, in case that nothing seen is right.
"""

from dataclasses import dataclass

import numpy as np

from estimators.particles.cloud import Cloud, Moments, parts_of, places, put
from estimators.particles.resampling import systematic
from estimators.particles.sides import Copies
from fieldloc import pose as se2
from fieldloc.mixture import IntArray, MixtureFactor
from fieldloc.pose import FloatArray

_STAY = 0.05  # of the particles, at least
_SHARP = 0.25  # smaller than this part of the cloud's volume, weighing alone would leave too few
_FAR = 4.0  # squared distance, in sigmas of the cloud, to where the observation sends it
_LEAST_VARIANCE = np.diag([1e-3, 1e-3, 1e-3]) ** 2
_MOST_WAYS = 12  # solutions of each part


@dataclass(frozen=True, slots=True, eq=False)
class Ways:
    """Of each part (p,) up to w ways to go, the first being to stay. shares: (p, w), rows add up to one. steps:
    (p, w, 3) and covariances (p, w, 3, 3) in the tangent at the part's mean, which has covariance `before` (p, 3, 3).
    """

    shares: FloatArray
    steps: FloatArray
    covariances: FloatArray
    before: FloatArray


def proposed(
    cloud: Cloud, of: Moments, mixture: MixtureFactor, copies: Copies, random: np.random.Generator
) -> tuple[Cloud, FloatArray] | None:
    """The cloud moved, and the log of prior over proposal (n,). None where weighing alone will do."""
    parts, local = parts_of(cloud, of)
    before = local.covariances[:, :3, :3] + _LEAST_VARIANCE
    ways = _ways(mixture, copies, local.means[:, :3], before, _sides(cloud, parts, local.masses))
    if ways is None:
        return None
    way = _chosen(ways.shares, parts, random)
    place = places(cloud, parts, local.means)
    there = np.linalg.cholesky(ways.covariances) @ np.linalg.inv(np.linalg.cholesky(ways.before))[:, None]
    tangent = se2.log(place[:, :3])
    to = ways.steps[parts, way] + np.einsum("nij,nj->ni", there[parts, way], tangent)
    # the compass' offset goes along with the heading as far as the two belong together
    lean = np.linalg.solve(ways.before, local.covariances[:, :3, 3:])[..., 0]
    offset = place[:, 3] + np.sum(lean[parts] * (to - tangent), axis=1)
    moved = Cloud(cloud.poses, cloud.offsets_rad, cloud.weights.copy(), cloud.sides.copy(), cloud.labels)
    put(moved, parts, local.means, np.column_stack([se2.exp(to), offset]))
    return moved, _log_correction(ways, parts, to)


def _sides(cloud: Cloud, parts: IntArray, masses: FloatArray) -> FloatArray:
    """(p, c) of each part."""
    sums = [np.bincount(parts, cloud.weights * side, len(masses)) for side in cloud.sides.T]
    return np.stack(sums, axis=-1) / np.maximum(masses, 1e-300)[:, None]


def _ways(
    mixture: MixtureFactor, copies: Copies, means: FloatArray, before: FloatArray, sides: FloatArray
) -> Ways | None:
    number, several = len(means), 1 if mixture.symmetric else len(copies)
    at = copies.of(means)[:, :several].reshape(-1, 3)
    out = mixture.expand(at, np.repeat(before, several, axis=0))
    if not len(out.ids):
        return None
    part, copy = np.divmod(out.parent, several)
    log_blind = out.log_blind(mixture, len(at)).reshape(number, several).max(axis=1)
    log_share = out.evidence + (np.log(np.maximum(sides[part, copy], 1e-300)) if several > 1 else 0.0)
    order = np.lexsort((-log_share, part))
    part, log_share = part[order], log_share[order]
    rank = np.arange(len(part)) - np.searchsorted(part, part)
    kept = (rank < _MOST_WAYS) & (log_share > log_blind[part] - 5.0)
    if not kept.any():
        return None
    part, log_share, rank, order = part[kept], log_share[kept], rank[kept] + 1, order[kept]
    width = int(rank.max()) + 1
    logs = np.full((number, width), -np.inf)
    logs[:, 0], logs[part, rank] = log_blind, log_share
    shares = np.exp(logs - np.logaddexp.reduce(logs, axis=1)[:, None])
    steps, covariances = np.zeros((number, width, 3)), np.repeat(before[:, None], width, axis=1)
    steps[part, rank] = out.step[order]
    covariances[part, rank] = out.updated[order] + 1e-3 * _LEAST_VARIANCE
    if not _worth_it(shares, steps, covariances, before):
        return None
    shares[:, 0] = np.maximum(shares[:, 0], _STAY)
    return Ways(shares / shares.sum(axis=1)[:, None], steps, covariances, before)


def _worth_it(shares: FloatArray, steps: FloatArray, covariances: FloatArray, before: FloatArray) -> bool:
    """Whether any way that counts is to a place that few particles are at."""
    volume = np.linalg.slogdet(covariances)[1] - np.linalg.slogdet(before)[1][:, None]
    far = np.sum(steps * np.linalg.solve(before[:, None], steps[..., None])[..., 0], axis=-1)
    return bool(((shares > _STAY) & ((volume < 2.0 * np.log(_SHARP)) | (far > _FAR)))[:, 1:].any())


def _chosen(shares: FloatArray, parts: IntArray, random: np.random.Generator) -> IntArray:
    """(n,) way of each particle, as many as the shares of its part say; which ones, by chance."""
    if len(shares) == 1:
        return random.permutation(systematic(shares[0], len(parts), random))
    steps = np.cumsum(shares, axis=1)
    return np.asarray(np.sum(random.random(len(parts))[:, None] > steps[parts, :-1], axis=1))


def _log_correction(ways: Ways, parts: IntArray, to: FloatArray) -> FloatArray:
    """Log of prior over proposal (n,) at tangents (n, 3)."""
    precision, log_norm = np.linalg.inv(ways.covariances), -0.5 * np.linalg.slogdet(ways.covariances)[1]
    with np.errstate(divide="ignore"):
        log_share = np.log(ways.shares)
    terms = []
    for way in range(ways.shares.shape[1]):
        off = to - ways.steps[parts, way]
        misfit = np.einsum("ni,nij,nj->n", off, precision[parts, way], off)
        terms.append(log_norm[parts, way] - 0.5 * misfit)
    proposal = np.logaddexp.reduce(np.stack(terms, axis=-1) + log_share[parts], axis=-1)
    return np.asarray(terms[0] - proposal)
