"""Particle filter with filterpy's resampling: a cloud of poses weighed by the factors that all estimators take."""

import numpy as np
from filterpy.monte_carlo import systematic_resample
from numpy.typing import NDArray

from estimators.base import Estimate, Innovation
from estimators.config import Config
from estimators.divergence import Restart
from estimators.motion import STANDSTILL, HeldVelocity, Increment
from fieldloc import pose as se2
from fieldloc.covariance import propagate, squared_mahalanobis
from fieldloc.factors import Factor, PoseFactor, innovation_covariance
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

_LOG_RATIO_FLOOR = -60.0  # exp of it is nothing beside the outlier share

# shares of the particles that still have weight (effective sample size):
_RESAMPLE_BELOW = 0.5
_MIN_ALIVE = 0.1  # a factor that would leave fewer comes in parts
_SMALLEST_PART = 1e-9
_MOST_PARTS = 50
_JITTER = 0.3  # of the cloud's own spread, at each resampling


class ParticleFilter:
    """Starts at the first whole-pose factor unless `start` is called before.

    Motion is gathered and drawn for the particles only when a factor comes: in between the estimate is carried along.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._motion = HeldVelocity(config.motion)
        self._restart = Restart(config.robust.restart_after)
        self._random = np.random.default_rng(config.particles.seed)
        self._pending: Increment = STANDSTILL
        self._poses = np.zeros((0, 3))
        self._weights = np.zeros(0)
        self._mean = np.zeros(3)
        self._covariance = np.zeros((3, 3))  # robot frame

    def start(self, estimate: Estimate) -> None:
        self.advance(estimate.stamp_ns)
        self._scatter(estimate.pose, se2.rotate_covariance(estimate.covariance, -estimate.pose[2]))

    def predict(self, odometry: Odometry) -> None:
        self.advance(odometry.stamp_ns)
        self._motion.hold(odometry)

    def advance(self, stamp_ns: int) -> None:
        motion = self._motion.advance(stamp_ns)
        if motion is not None and len(self._poses):
            self._pending = self._pending.then(motion)
            self._restart.advance(motion)

    def update(self, factor: Factor) -> Innovation | None:
        self.advance(factor.stamp_ns)
        if not len(self._poses):
            if isinstance(factor, PoseFactor):
                self._scatter(factor.pose, factor.covariance)
            return None
        self._move()
        residual = factor.error(self._mean)
        _, expected = innovation_covariance(factor, self._mean, self._covariance)
        nis = float(squared_mahalanobis(residual, expected))
        weight = min(1.0, self._config.robust.nis_per_dof * len(residual) / max(nis, 1e-300))
        if (elsewhere := self._restart.consider(factor, disagrees=weight < 1.0)) is not None:
            self._scatter(elsewhere.pose, elsewhere.covariance)
            return Innovation(factor.stamp_ns, residual, expected, nis, 0.0)
        if weight < 1.0:
            self._weigh(factor, factor.covariance / weight, outlier_share=0.0)  # it is taken for an outlier already
        else:
            weight = self._weigh(factor, factor.covariance, self._config.particles.outlier_share)
        return Innovation(factor.stamp_ns, residual, expected, nis, weight)

    def estimate(self) -> Estimate | None:
        """Weighted mean and covariance of the cloud."""
        if not len(self._poses) or self._motion.stamp_ns is None:
            return None
        pose = se2.compose(self._mean, self._pending.before_from_after)
        carried = Increment.carry(self._covariance, self._pending.before_from_after) + self._pending.covariance
        return Estimate(self._motion.stamp_ns, pose, se2.rotate_covariance(carried, pose[2]))

    def _scatter(self, pose: FloatArray, robot_covariance: FloatArray) -> None:
        count = self._config.particles.count
        self._poses = se2.retract(pose, self._draw(robot_covariance, count))
        self._weights = np.full(count, 1.0 / count)
        self._pending = STANDSTILL
        self._restart.forget()
        self._summarise()

    def _weigh(self, factor: Factor, covariance: FloatArray, outlier_share: float) -> float:
        """Weigh the particles by the factor's error of that covariance; how far it was taken for an inlier.

        A factor so sharp that it would leave hardly a particle alive comes in parts, each of a wider covariance, and
        the cloud closes in on it (progressive correction, Oudjane & Musso 2000).
        """
        left, share = 1.0, 1.0
        for _ in range(_MOST_PARTS):
            error, spread = factor.error(self._poses), propagate(factor.jacobian(self._mean), self._covariance)
            part, alive = 2.0 * _bearable(spread, covariance, left), 0.0
            while alive < _MIN_ALIVE and part > _SMALLEST_PART:
                part *= 0.5
                widened = covariance / part
                likelihood, inlier = self._likelihood(error, widened, spread + widened, outlier_share)
                weights = self._weights * likelihood / (self._weights @ likelihood)
                alive = _alive(weights)
            self._weights = weights
            share = min(share, float(self._weights @ inlier))
            left -= part
            if alive < _RESAMPLE_BELOW:
                self._resample()
            self._summarise()
            if left <= 0.0 or share <= 0.5:
                break
        return share

    def _resample(self) -> None:
        """Copies are pulled to the mean and scattered by as much: a robot that stands still would be left with one
        particle else. Mean and covariance stay as they were (Liu & West 2001, sec. 10.3.2)."""
        self._summarise()
        count = len(self._poses)
        around = se2.local(self._mean, self._poses[_drawn(self._weights, self._random)])
        around = np.sqrt(1.0 - _JITTER**2) * around + _JITTER * self._draw(self._covariance, count)
        self._poses = se2.retract(self._mean, around)
        self._weights = np.full(count, 1.0 / count)

    def _move(self) -> None:
        noise = self._draw(self._pending.covariance, len(self._poses))
        self._poses = se2.retract(se2.compose(self._poses, self._pending.before_from_after), noise)
        self._pending = STANDSTILL
        self._summarise()

    def _draw(self, covariance: FloatArray, count: int) -> FloatArray:
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(self._random.standard_normal((count, 3)) @ root.T)

    def _likelihood(
        self, error: FloatArray, covariance: FloatArray, expected: FloatArray, outlier_share: float
    ) -> tuple[FloatArray, FloatArray]:
        """Of the errors (n, m) of the particles, and the share of it that is not the outliers'.

        An outlier's density is that of the innovation at the edge of what the cloud expects: it depends on no units and
        lets no single wrong factor sweep away a cloud that all others agree with.
        """
        log_ratio = -0.5 * np.einsum("ni,ij,nj->n", error, np.linalg.inv(covariance), error)
        edge = self._config.robust.nis_per_dof * error.shape[-1]
        log_det = np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(expected)[1]
        inlier = (1.0 - outlier_share) * np.exp(np.maximum(log_ratio, _LOG_RATIO_FLOOR))
        outlier = outlier_share * np.exp(-0.5 * edge + 0.5 * log_det)
        return inlier + outlier, inlier / (inlier + outlier)

    def _summarise(self) -> None:
        """Mean and covariance of the cloud, in the tangent at its most recent mean."""
        direction = self._weights @ np.exp(1j * self._poses[:, 2])
        x, y = self._weights @ self._poses[:, :2]
        self._mean = np.array([x, y, np.angle(direction)])
        spread = self._poses - self._mean
        spread[:, 2] = se2.wrap(spread[:, 2])
        field = (spread * self._weights[:, None]).T @ spread
        self._covariance = se2.rotate_covariance(field, -self._mean[2])


def _bearable(spread: FloatArray, covariance: FloatArray, left: float) -> float:
    """How much of a factor's information, at most what is left of it, keeps a share of the particles alive.

    spread: (m, m) of the cloud in the factor's error; covariance: (m, m) of the factor.
    """
    ratios = np.linalg.eigvals(np.linalg.solve(covariance, spread)).real
    part = left
    while np.prod(1.0 + part * ratios) > _MIN_ALIVE**-2 and part > _SMALLEST_PART:
        part *= 0.5
    return part


def _alive(weights: FloatArray) -> float:
    return 1.0 / (len(weights) * float(weights @ weights))


def _drawn(weights: FloatArray, random: np.random.Generator) -> NDArray[np.int32]:
    """filterpy draws from numpy's global generator: for this call it is seeded by ours, then gets its state back."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(int(random.integers(2**32)))  # noqa: NPY002
    try:
        return np.asarray(systematic_resample(weights))
    finally:
        np.random.set_state(before)  # noqa: NPY002
