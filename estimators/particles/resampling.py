"""Which particles go on, and how many are needed: systematic resampling, and the size that the spread asks for."""

import numpy as np

from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_FEWEST_OF_A_CLUSTER = 30


def systematic(weights: FloatArray, count: int, random: np.random.Generator) -> IntArray:
    """(count,) rows, each as often as its weight says, up to one: low-variance resampling (Carpenter et al. 1999)."""
    steps = np.cumsum(weights)
    at = (np.arange(count) + random.random()) * (steps[-1] / count)
    return np.asarray(np.minimum(np.searchsorted(steps, at, side="right"), len(weights) - 1))


def effective(weights: FloatArray) -> float:
    """Effective sample size over the number of particles."""
    return float(weights.sum() ** 2 / (len(weights) * (weights @ weights)))


def kld_size(bins: int, error: float, quantile: float) -> int:
    """How many samples keep the Kullback-Leibler distance to a distribution over that many bins below `error`, with the
    probability of the standard normal's `quantile` (Fox 2003, eq. 7)."""
    if bins < 2:
        return 1
    k = bins - 1.0
    return int(np.ceil(k / (2.0 * error) * (1.0 - 2.0 / (9.0 * k) + np.sqrt(2.0 / (9.0 * k)) * quantile) ** 3))


def shares(masses: FloatArray, count: int) -> IntArray:
    """(k,) how many of about `count` particles each cluster gets: in proportion, but never too few to move in."""
    fewest = min(_FEWEST_OF_A_CLUSTER, max(count // max(int(np.count_nonzero(masses)), 1), 1))
    wanted = np.maximum(np.rint(count * masses / masses.sum()), fewest)
    return np.where(masses > 0.0, wanted, 0).astype(np.intp)


def by_cluster(
    weights: FloatArray, labels: IntArray, masses: FloatArray, sizes: IntArray, random: np.random.Generator
) -> tuple[IntArray, FloatArray]:
    """Rows and weights of the particles that go on: `sizes` (k,) of each cluster, which keeps its mass to the digit.

    So no cluster dies of bad luck (mixture particle filter, Vermaak et al. 2003): resampling over all clusters at once
    makes their masses walk at random until one has it all.
    """
    if len(sizes) == 1:
        count = int(sizes[0])
        return systematic(weights, count, random), np.full(count, masses[0] / count)
    order = np.argsort(labels, kind="stable")
    of = labels[order]
    expected = weights[order] * (sizes / np.where(masses > 0.0, masses, 1.0))[of]
    total = int(sizes.sum())
    steps = np.cumsum(expected)
    at = (np.arange(total) + random.random()) * (steps[-1] / total)
    rows = order[np.minimum(np.searchsorted(steps, at, side="right"), len(weights) - 1)]
    # a cluster's first and last row may be its neighbour's by rounding: what was really drawn counts
    drawn = np.bincount(labels[rows], minlength=len(sizes))
    return rows, (masses / np.maximum(drawn, 1))[labels[rows]]
