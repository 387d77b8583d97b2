"""What particles are weighed by: a mixture as it is, a plain factor with an outlier's share."""

import math
from dataclasses import dataclass

import numpy as np

from estimators.config import Config
from estimators.particles.answer import best_of
from estimators.particles.cloud import Cloud, Moments
from estimators.particles.sides import Copies
from estimators.particles.weighing import MIN_ALIVE, SMALLEST_PART, LogLikelihood, Parts
from fieldloc.covariance import propagate
from fieldloc.factors import Factor
from fieldloc.mixture import MixtureFactor
from fieldloc.pose import FloatArray

_FLOOR = -60.0  # exp of it is nothing beside the outlier's share


def mixture_likelihood(mixture: MixtureFactor, copies: Copies) -> LogLikelihood:
    def log_likelihood(cloud: Cloud, of: Moments, left: float) -> tuple[Parts, float]:
        poses = cloud.poses
        if mixture.by_compass:
            poses = poses.copy()
            poses[:, 2] += cloud.offsets_rad
        if mixture.symmetric or len(copies) == 1:
            terms = mixture.log_likelihood(poses)[:, None]
        else:
            terms = mixture.log_likelihood(copies.of(poses))
        return (lambda part: part * terms), left

    return log_likelihood


@dataclass(frozen=True, slots=True, eq=False)
class FactorLikelihood:
    """Normal, or of an outlier whose density is that of the innovation at the edge of what the cloud expects: it
    depends on no units and lets no single wrong factor sweep away a cloud that all others agree with.

    weight: less than one for what is taken for an outlier already: it counts for so much less.
    """

    factor: Factor
    weight: float
    config: Config
    copies: Copies

    def __call__(self, cloud: Cloud, of: Moments, left: float) -> tuple[Parts, float]:
        mean, covariance, _ = best_of(cloud, of, self.copies)
        at = cloud.poses[:, None] if len(self.copies) == 1 else self.copies.of(cloud.poses)
        error = self.factor.error(at)
        spread = propagate(self.factor.jacobian(mean), covariance)
        return (lambda part: np.logaddexp(*self._terms(error, spread, part))), self._bearable(spread, left)

    def inlier(self, cloud: Cloud, of: Moments) -> float:
        """How far the cloud takes it for an inlier."""
        mean, covariance, _ = best_of(cloud, of, self.copies)
        inlier, outlier = self._terms(self.factor.error(mean), propagate(self.factor.jacobian(mean), covariance), 1.0)
        return float(1.0 / (1.0 + np.exp(outlier - inlier)))

    def _bearable(self, spread: FloatArray, left: float) -> float:
        """How much of its information keeps a share of the particles alive: where all are far off it cannot be seen by
        their weights."""
        ratios = np.linalg.eigvals(np.linalg.solve(self.factor.covariance / self.weight, spread)).real
        while np.prod(1.0 + left * ratios) > MIN_ALIVE**-2 and left > SMALLEST_PART:
            left *= 0.5
        return left

    def _terms(self, error: FloatArray, spread: FloatArray, part: float) -> tuple[FloatArray, float]:
        """Logs of both, over the density of a right one. A part of it is one of a wider covariance."""
        widened = self.factor.covariance / (self.weight * part)
        misfit = np.einsum("...i,ij,...j->...", error, np.linalg.inv(widened), error)
        share = self.config.particles.outlier_share if self.weight == 1.0 else 0.0
        log_inlier = np.maximum(-0.5 * misfit, _FLOOR) + math.log1p(-share)
        if share <= 0.0:
            return log_inlier, -math.inf
        log_det = float(np.linalg.slogdet(widened)[1] - np.linalg.slogdet(spread + widened)[1])
        edge = self.config.robust.nis_per_dof * len(widened)
        return log_inlier, math.log(share) + 0.5 * log_det - 0.5 * edge
