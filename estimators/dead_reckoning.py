"""Odometry alone, from a known or the first observed pose: what every other estimator must beat."""

from estimators.base import Estimate, Innovation
from estimators.config import Config
from estimators.motion import HeldVelocity, Increment
from fieldloc import pose as se2
from fieldloc.covariance import squared_mahalanobis
from fieldloc.factors import Factor, PoseFactor, innovation_covariance
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray


class DeadReckoning:
    """Starts at the first whole-pose factor unless `start` is called before; no factor moves it after that."""

    def __init__(self, config: Config) -> None:
        self._motion = HeldVelocity(config.motion)
        self._belief: tuple[FloatArray, FloatArray] | None = None

    def start(self, estimate: Estimate) -> None:
        self.advance(estimate.stamp_ns)
        self._belief = estimate.pose, estimate.robot_covariance

    def predict(self, odometry: Odometry) -> None:
        self.advance(odometry.stamp_ns)
        self._motion.hold(odometry)

    def advance(self, stamp_ns: int) -> None:
        motion = self._motion.advance(stamp_ns)
        if motion is not None and self._belief is not None:
            pose, covariance = self._belief
            carried = Increment.carry(covariance, motion.before_from_after) + motion.covariance
            self._belief = se2.compose(pose, motion.before_from_after), carried

    def update(self, factor: Factor) -> Innovation | None:
        self.advance(factor.stamp_ns)
        if self._belief is None:
            if isinstance(factor, PoseFactor):
                self._belief = factor.pose, factor.covariance
            return None
        residual = factor.error(self._belief[0])
        _, expected = innovation_covariance(factor, *self._belief)
        return Innovation(factor.stamp_ns, residual, expected, float(squared_mahalanobis(residual, expected)), 0.0)

    def estimate(self) -> Estimate | None:
        if self._belief is None or self._motion.stamp_ns is None:
            return None
        pose, covariance = self._belief
        return Estimate(self._motion.stamp_ns, pose, se2.rotate_covariance(covariance, pose[2]))
