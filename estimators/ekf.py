"""Extended Kalman filter on filterpy: the readable baseline, one Gaussian, first order.

filterpy keeps the error state: a robot-frame tangent and the error of the odometry's calibration, zero after every
update, beside pose and calibration themselves. So the heading needs no wrapping inside the filter, and the covariance
does not depend on where on the field the robot stands.
"""

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import block_diag

from estimators.base import Estimate, Innovation
from estimators.config import Config
from estimators.divergence import Restart
from estimators.motion import HeldVelocity, OdometryCalibration
from fieldloc import pose as se2
from fieldloc.covariance import squared_mahalanobis
from fieldloc.factors import Factor, PoseFactor, innovation_covariance
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

_CALIBRATION = len(OdometryCalibration._fields)


class Ekf:
    """Starts at the first whole-pose factor unless `start` is called before."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._motion = HeldVelocity(config.motion)
        self._restart = Restart(config.robust.restart_after)
        self._pose: FloatArray | None = None
        self.carried_ns: list[tuple[int, int]] = []
        """From when to when it was somewhere else unnoticed, for each restart."""
        self._calibration = np.zeros(_CALIBRATION)
        self._filter = ExtendedKalmanFilter(dim_x=3 + _CALIBRATION, dim_z=3)
        self._filter.x = np.zeros(3 + _CALIBRATION)
        self._filter.Q = np.zeros((3 + _CALIBRATION, 3 + _CALIBRATION))
        self._filter.P = block_diag(np.eye(3), np.diag(config.calibration.sigmas() ** 2))

    def start(self, estimate: Estimate) -> None:
        self.advance(estimate.stamp_ns)
        self._believe(estimate.pose, se2.rotate_covariance(estimate.covariance, -estimate.pose[2]))

    def predict(self, odometry: Odometry) -> None:
        self.advance(odometry.stamp_ns)
        self._motion.hold(odometry)

    def advance(self, stamp_ns: int) -> None:
        motion = self._motion.advance(stamp_ns)
        if motion is None or self._pose is None:
            return
        motion = motion.calibrated(self._calibration)
        self._pose = se2.compose(self._pose, motion.before_from_after)
        self._filter.F[:3, :3] = se2.adjoint(se2.inverse(motion.before_from_after))
        self._filter.F[:3, 3:] = motion.by_calibration
        self._filter.Q[:3, :3] = motion.covariance
        self._filter.predict()
        self._restart.advance(motion)

    def update(self, factor: Factor) -> Innovation | None:
        self.advance(factor.stamp_ns)
        if self._pose is None:
            if isinstance(factor, PoseFactor):
                self._believe(factor.pose, factor.covariance)
            return None
        residual = factor.error(self._pose)
        jacobian, expected = innovation_covariance(factor, self._pose, self._filter.P[:3, :3])
        nis = float(squared_mahalanobis(residual, expected))
        weight = min(1.0, self._config.robust.nis_per_dof * len(residual) / max(nis, 1e-300))
        innovation = Innovation(factor.stamp_ns, residual, expected, nis, weight)
        if (elsewhere := self._restart.consider(factor, disagrees=weight < 1.0)) is not None:
            self.carried_ns.append((self._restart.since_ns, elsewhere.stamp_ns))
            self._believe(elsewhere.pose, elsewhere.covariance)
            return innovation
        by_state = np.pad(jacobian, [(0, 0), (0, _CALIBRATION)])
        self._filter.update(
            -residual, HJacobian=lambda _: by_state, Hx=lambda _: np.zeros(len(residual)), R=factor.covariance / weight
        )
        self._absorb()
        return innovation

    def estimate(self) -> Estimate | None:
        if self._pose is None or self._motion.stamp_ns is None:
            return None
        return Estimate(self._motion.stamp_ns, self._pose, se2.rotate_covariance(self._filter.P[:3, :3], self._pose[2]))

    def _believe(self, pose: FloatArray, robot_covariance: FloatArray) -> None:
        """Forget the pose, not what is known of the odometry."""
        self._pose = pose
        self._filter.P = block_diag(robot_covariance, self._filter.P[3:, 3:])
        self._restart.forget()

    def _absorb(self) -> None:
        """Take the error state into pose and calibration, and the covariance to the new pose's tangent."""
        assert self._pose is not None
        step = self._filter.x
        self._pose = se2.retract(self._pose, step[:3])
        self._calibration = self._calibration + step[3:]
        reset = block_diag(se2.right_jacobian(step[:3]), np.eye(_CALIBRATION))
        self._filter.P = reset @ self._filter.P @ reset.T
        self._filter.x = np.zeros(3 + _CALIBRATION)
