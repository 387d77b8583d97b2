"""What several logs say together of the same numbers, each solved under the same prior: that counts once."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldloc.covariance import propagate
from fieldloc.pose import FloatArray

_SAYS_SOMETHING = 0.01  # information of a log along a direction, as a share of the prior's


class Fused(NamedTuple):
    """mean (n,), covariance (n, n). disagreement: chi-square per degree of freedom of the logs about their common
    mean, 1 where they agree as well as they claim to; where it is more, the covariance is as if each said that much
    less. NaN for one log, or for logs that say nothing of the same."""

    mean: FloatArray
    covariance: FloatArray
    disagreement: float


def fused(
    prior_mean: FloatArray, prior_covariance: FloatArray, posteriors: Sequence[tuple[FloatArray, FloatArray]]
) -> Fused:
    """posteriors: mean (n,) and covariance (n, n) of each log, under the prior.

    In the prior's standard deviations, in which the prior is a standard normal one.
    """
    root = np.asarray(np.linalg.cholesky(prior_covariance), dtype=np.float64)
    one_each = np.eye(len(prior_mean))
    said = [
        _likelihood(np.asarray(np.linalg.solve(root, mean - prior_mean), dtype=np.float64), _whitened(root, covariance))
        for mean, covariance in posteriors
    ]
    information = np.sum([one for one, _ in said], axis=0)
    covariance = np.linalg.inv(one_each + information)
    mean = covariance @ np.sum([vector for _, vector in said], axis=0)
    apart, freedom = 0.0, -float(np.trace(information @ covariance))
    for one, vector in said:
        values, axes = np.linalg.eigh(one)
        heard = values > _SAYS_SOMETHING
        apart += float(np.sum((axes[:, heard].T @ (vector - one @ mean)) ** 2 / values[heard]))
        freedom += int(heard.sum())
    disagreement = apart / freedom if len(said) > 1 and freedom > 0.5 else float("nan")
    if disagreement > 1.0:
        covariance = np.linalg.inv(one_each + information / disagreement)
    return Fused(prior_mean + root @ mean, propagate(root, covariance), disagreement)


def _whitened(root: FloatArray, covariance: FloatArray) -> FloatArray:
    once = np.linalg.solve(root, covariance)
    return np.asarray(np.linalg.solve(root, once.T))


def _likelihood(mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Information matrix and vector without the prior's, which is one."""
    posterior = np.linalg.inv(0.5 * (covariance + covariance.T))
    values, axes = np.linalg.eigh(posterior - np.eye(len(mean)))  # rounding must not make it say less than nothing
    return (axes * np.maximum(values, 0.0)) @ axes.T, posterior @ mean
