"""Weighing, resampling, moving: what happens to a cloud, whatever it is weighed by."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimators.config import Particles
from estimators.particles.cloud import Cloud, Moments, large, moments, places, put, regroup, tight
from estimators.particles.clusters import occupied
from estimators.particles.resampling import by_cluster, effective, kld_size, shares
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

Parts = Callable[[float], FloatArray]
"""Log-likelihoods of a share of what was observed: (n, 1), or (n, c) where it tells the copies apart."""
LogLikelihood = Callable[[Cloud, Moments, float], tuple[Parts, float]]
"""Of the particles as they are, and how much of what is left the cloud can bear at once, as far as one can tell."""

_RESAMPLE_BELOW = 0.5  # effective share of the particles
MIN_ALIVE = 0.2  # what would leave fewer comes in parts
SMALLEST_PART = 1e-9
_MOST_PARTS = 60
_JITTER = 0.3  # of the cluster's own spread, at each resampling
_FEW_OF_A_PART = 8
_FEW = 60  # effective particles: fewer are not made to have exact moments


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """log_evidence: log of the mean likelihood. shift: (3,) how far the clusters' means went, on the whole."""

    log_evidence: float
    shift: FloatArray


def weigh(
    cloud: Cloud, of: Moments, log_likelihood: LogLikelihood, config: Particles, random: np.random.Generator
) -> tuple[Cloud, Moments, Weighed]:
    """A likelihood so sharp that it would leave hardly a particle alive comes in parts, as a power of it each, and the
    cloud closes in on it (progressive correction, Oudjane & Musso 2000)."""
    left, log_evidence, shift = 1.0, 0.0, np.zeros(3)
    for _ in range(_MOST_PARTS):
        of_part, part = log_likelihood(cloud, of, left)
        while True:
            terms = of_part(part)
            top = float(terms.max())
            weights, sides = _weighted(cloud, terms - top)
            if effective(weights) >= MIN_ALIVE or part <= SMALLEST_PART:
                break
            part *= 0.5
        total = float(weights.sum())
        log_evidence += float(np.log(total)) + top
        cloud.weights, cloud.sides = weights / total, sides
        left -= part
        now = moments(cloud, cloud.labels, len(of.masses))
        shift += _mean_shift(of, now)
        of = now
        if _needs_resampling(cloud, now):
            cloud, of = resample(cloud, now, config, random)
        if left <= 0.0:
            break
    return cloud, of, Weighed(log_evidence, shift)


def weigh_where_sent(
    of: Moments,
    moved: Cloud,
    log_correction: FloatArray,
    log_likelihood: LogLikelihood,
    config: Particles,
    random: np.random.Generator,
) -> tuple[Cloud, Moments, Weighed]:
    """Of a cloud that was sent to where the likelihood is large, with the log of prior over proposal (n,)."""
    of_part, _ = log_likelihood(moved, of, 1.0)
    terms = of_part(1.0) + log_correction[:, None]
    top = float(terms.max())
    weights, moved.sides = _weighted(moved, terms - top)
    total = float(weights.sum())
    moved.weights = weights / total
    now = moments(moved, moved.labels, len(of.masses))
    shift = _mean_shift(of, now)
    if _needs_resampling(moved, now):
        moved, now = resample(moved, now, config, random)
    elif len(now.masses) > 1 or large(now)[0]:
        moved.labels, _, _ = regroup(moved)
        now = moments(moved, moved.labels, int(moved.labels.max()) + 1)
    return moved, now, Weighed(float(np.log(total)) + top, shift)


def resample(cloud: Cloud, of: Moments, config: Particles, random: np.random.Generator) -> tuple[Cloud, Moments]:
    """As many particles as the spread asks for; every cluster keeps its mass. Copies are pulled to the mean of their
    cluster and scattered by as much, so mean and covariance stay as they were (Liu & West 2001, sec. 10.3.2)."""
    masses = np.where(of.masses > config.negligible, of.masses, 0.0)
    masses = masses / masses.sum()
    kept = cloud.take(*by_cluster(cloud.weights, cloud.labels, masses, shares(masses, len(cloud)), random))
    bins = occupied(kept.poses, config.bin_m, config.bin_rad)
    count = int(np.clip(kld_size(bins, config.kld_error, config.kld_quantile), config.count, config.max_count))
    rows, weights = by_cluster(cloud.weights, cloud.labels, masses, shares(masses, count), random)
    labels, parts, local = cloud.labels, cloud.labels, of
    if len(of.masses) > 1 or not tight(of):
        labels, parts, number = regroup(cloud)
        local = moments(cloud, parts, number)
    number = len(local.masses)
    pooled = np.tensordot(local.masses / local.masses.sum(), local.covariances, axes=1)
    cloud, parts = cloud.take(rows, weights), parts[rows]
    _, cloud.labels = _counted(labels[rows])
    around = np.sqrt(1.0 - _JITTER**2) * places(cloud, parts, local.means)
    noise = random.standard_normal((len(cloud), 4))
    if number == 1:
        noise = exact(noise, cloud.weights)
        around += _JITTER * (noise @ _root(local.covariances[0]).T)
    else:
        # a few particles know no spread of their own
        few = np.bincount(parts, minlength=number) < _FEW_OF_A_PART
        spread = local.covariances + np.where(few, 1.0, 0.0)[:, None, None] * pooled
        around += _JITTER * np.einsum("nij,nj->ni", _root(spread)[parts], noise)
    put(cloud, parts, local.means, around)
    return cloud, moments(cloud, cloud.labels, int(cloud.labels.max()) + 1)


def scattered(mean: FloatArray, covariance: FloatArray, count: int, random: np.random.Generator) -> FloatArray:
    """(count, 3) about a pose, of that covariance, robot frame."""
    noise = exact(random.standard_normal((count, 3)), np.full(count, 1.0 / count))
    return se2.retract(mean, noise @ _root(covariance).T)


def drawn(noise: FloatArray, covariance: FloatArray) -> FloatArray:
    """(n, m) of unit normal noise (n, m)."""
    return np.asarray(noise @ _root(covariance).T)


def exact(noise: FloatArray, weights: FloatArray, around: FloatArray | None = None) -> FloatArray:
    """Noise (n, m) with mean zero and covariance one to the digit, and uncorrelated with `around` (n, k) if given: what
    chance does to mean and covariance of a cloud is none of its answer (second-order exact sampling, Pham 2001)."""
    if effective(weights) * len(weights) < _FEW:
        return noise
    weights = weights / weights.sum()
    noise = noise - weights @ noise
    if around is not None:
        weighted = around * weights[:, None]
        noise = noise - around @ np.linalg.lstsq(weighted.T @ around, weighted.T @ noise, rcond=1e-9)[0]
    root = np.linalg.cholesky((noise * weights[:, None]).T @ noise)
    return np.asarray(np.linalg.solve(root, noise.T).T)


def _weighted(cloud: Cloud, terms: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weights (n,), not normalised, and sides (n, c)."""
    likelihood = np.exp(terms)
    if likelihood.shape[1] == 1:
        return cloud.weights * likelihood[:, 0], cloud.sides
    sides = cloud.sides * likelihood
    total = sides.sum(axis=1)
    return cloud.weights * total, sides / np.maximum(total, 1e-300)[:, None]


def _needs_resampling(cloud: Cloud, of: Moments) -> bool:
    if len(of.masses) == 1:
        return effective(cloud.weights) < _RESAMPLE_BELOW
    number = np.bincount(cloud.labels, minlength=len(of.masses))
    squares = np.bincount(cloud.labels, cloud.weights**2, len(of.masses))
    alive = of.masses**2 / np.maximum(number * squares, 1e-300)
    return bool((alive[of.masses > 0.01 * of.masses.max()] < _RESAMPLE_BELOW).any())


def _mean_shift(before: Moments, after: Moments) -> FloatArray:
    """(3,) tangent, averaged over the clusters' masses."""
    by = se2.between(before.means[:, :3], after.means[:, :3])
    return np.asarray(after.masses @ by / after.masses.sum())


def _root(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])


def _counted(labels: IntArray) -> tuple[IntArray, IntArray]:
    """The labels in use, and the same labels counted from zero."""
    used, counted = np.unique(labels, return_inverse=True)
    return used, counted.reshape(-1).astype(np.intp)
