"""The chance that the robot is nowhere near the cloud, and where else it is then."""

import math

import numpy as np
from numpy.typing import NDArray

from estimators.config import Particles
from estimators.particles.cloud import Cloud
from estimators.particles.resampling import systematic
from estimators.particles.sides import Copies
from fieldloc import pose as se2
from fieldloc.mixture import MixtureFactor, PoseSolutions
from fieldloc.pose import FloatArray
from fieldloc.regions import Region

_EXPLAINED = 20.0  # times likelier than by chance: no need to look elsewhere
_DOUBT = 0.01  # with more of it left, all solutions are asked for anyway
_EACH_SOLUTION = 30  # particles
_SOMEWHERE = Region("somewhere", np.array([[-5.0, -5.0, 5.0, 5.0]]), np.array([[0.0, np.pi]]))


class Elsewhere:
    """A robot that is lost is somewhere in its region, with all headings and places alike: a hypothesis without
    particles, until an observation has whole poses to propose (sensor resetting, Lenser & Veloso 2000, with as many
    particles as Bayes gives them weight).

    A kidnapped robot may be on either side of the field, whatever region it started in.
    """

    def __init__(self, config: Particles, region: Region | None) -> None:
        self._config = config
        self._region = _SOMEWHERE if region is None else region
        self._bounded = region is not None
        self.copies = Copies(self._region.symmetries)
        self.carried = False
        self.lost = 1.0
        self._slow = self._fast = 1.0

    def found(self, carried: bool = True) -> None:
        """There is a cloud that holds all there is to know; from now on only a kidnapping can lose the robot."""
        self.lost, self.carried = 0.0, carried
        self._slow = self._fast = 1.0

    def wait(self, duration_s: float) -> None:
        self.lost += (1.0 - self.lost) * -math.expm1(-self._config.kidnaps_per_min / 60.0 * duration_s)

    def prior(self) -> float:
        """How likely the robot is lost before the next observation, in the light of how well the last ones went."""
        return max(self.lost, (1.0 - self.lost) * max(0.0, 1.0 - self._fast / max(self._slow, 1e-12)) * 0.1)

    def heed(self, explained: float) -> None:
        """explained: share of what was just seen that the cloud accounts for."""
        self._slow += self._config.alpha_slow * (explained - self._slow)
        self._fast += self._config.alpha_fast * (explained - self._fast)

    def wanted(self, mixture: MixtureFactor, log_evidence: float) -> bool:
        """Whether what is seen is so unlikely from the cloud that it is to be asked where else the robot could be."""
        return self.lost > _DOUBT or log_evidence < mixture.log_outlier + math.log(_EXPLAINED)

    def log_likelihood(self, mixture: MixtureFactor) -> float:
        return float(np.logaddexp(mixture.log_integral - self.log_volume, mixture.log_outlier))

    @property
    def log_volume(self) -> float:
        """Of where a lost robot can be, m^2 rad."""
        if not self.carried:
            return self._region.log_volume
        boxes, headings = self._region.boxes, self._region.headings
        inside = np.array([*boxes[0].reshape(2, 2).mean(axis=0), headings[0, 0]])
        return -float(self.log_densities(inside)[0])

    def log_densities(self, poses: FloatArray) -> FloatArray:
        """(..., c) of poses (..., 3) and their copies."""
        if not self._bounded:
            return np.full((*poses.shape[:-1], 1), -self._region.log_volume)
        out = self._region.log_density(self.copies.of(poses))
        if self.carried:
            either = np.logaddexp.reduce(out, axis=-1) - math.log(len(self.copies))
            out = np.repeat(either[..., None], len(self.copies), axis=-1)
        return np.asarray(out)

    def born(
        self, found: PoseSolutions, symmetric: bool, count: int, random: np.random.Generator
    ) -> tuple[Cloud, float] | None:
        """Particles for a robot that is at one of the solutions, weights adding up to one; log of how likely what was
        seen is for one that is lost. None where nothing is left in the region."""
        if not len(found.poses):
            return None
        densities = self.log_densities(found.poses)
        if not symmetric:
            densities = np.where(np.arange(densities.shape[1]) == 0, densities, -np.inf)
        # a solution's copy is among the solutions of a symmetric mixture: each belief is written down once
        log_weights = found.log_weights + np.logaddexp.reduce(densities, axis=-1)
        if symmetric and len(self.copies) > 1:
            log_weights = np.where(self._firsts(found.poses), log_weights, -np.inf)
        total = float(np.logaddexp.reduce(log_weights))
        if not np.isfinite(total):
            return None
        weights = np.exp(log_weights - total)
        alive = weights > self._config.negligible
        rows = np.flatnonzero(alive)
        count = max(count, min(_EACH_SOLUTION * len(rows), self._config.max_count))
        picked = rows[systematic(weights[rows] / weights[rows].sum(), count, random)]
        labels = np.searchsorted(rows, picked).astype(np.intp)
        noise = np.einsum(
            "nij,nj->ni", np.linalg.cholesky(found.covariances[picked]), random.standard_normal((count, 3))
        )
        sides = np.exp(densities - np.logaddexp.reduce(densities, axis=-1)[:, None])[picked]
        poses = se2.retract(found.poses[picked], noise)
        return Cloud(poses, np.zeros(count), np.full(count, 1.0 / count), sides, labels), total

    def _firsts(self, poses: FloatArray) -> NDArray[np.bool_]:
        """(k,) whether no earlier solution is a copy of this one."""
        beside = se2.between(poses[:, None, None], self.copies.of(poses)[None])
        same = (np.abs(beside[..., :2]).max(axis=-1) < 1e-3) & (np.abs(beside[..., 2]) < 1e-3)
        twin = same[:, :, 1:].any(axis=-1)
        return np.asarray(~np.tril(twin, -1).any(axis=1))
