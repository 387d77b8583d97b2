"""Extended Kalman filter on filterpy: the readable baseline, one Gaussian, first order.

filterpy keeps the error state: a robot-frame tangent, the error of the odometry's calibration and that of the compass'
offset, zero after every update, beside pose, calibration and offset themselves. So the heading needs no wrapping inside
the filter, and the covariance does not depend on where on the field the robot stands.
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
from fieldloc.factors import Factor, HeadingFactor, PoseFactor
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

_CALIBRATION = len(OdometryCalibration._fields)
_OFFSET = 3 + _CALIBRATION
_SIZE = _OFFSET + 1


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
        self._offset_rad = 0.0
        """What is to be added to the heading to have the compass'."""
        self._filter = ExtendedKalmanFilter(dim_x=_SIZE, dim_z=3)
        self._filter.x = np.zeros(_SIZE)
        self._filter.Q = np.zeros((_SIZE, _SIZE))
        offset = config.compass.offset_sigma_rad**2
        self._filter.P = block_diag(np.eye(3), np.diag(config.calibration.sigmas() ** 2), offset)

    def start(self, estimate: Estimate) -> None:
        self.advance(estimate.stamp_ns)
        self._believe(estimate.pose, estimate.robot_covariance)

    def predict(self, odometry: Odometry) -> None:
        self.advance(odometry.stamp_ns)
        self._motion.hold(odometry)

    def advance(self, stamp_ns: int) -> None:
        before_ns = self._motion.stamp_ns
        motion = self._motion.advance(stamp_ns)
        if motion is None or before_ns is None or self._pose is None:
            return
        motion = motion.calibrated(self._calibration)
        self._pose = se2.compose(self._pose, motion.before_from_after)
        self._filter.F[:3, :3] = se2.adjoint(se2.inverse(motion.before_from_after))
        self._filter.F[:3, 3:_OFFSET] = motion.by_calibration
        self._filter.Q[:3, :3] = motion.covariance
        left, gained = self._config.compass.wander((stamp_ns - before_ns) * 1e-9)
        self._offset_rad *= left
        self._filter.F[_OFFSET, _OFFSET], self._filter.Q[_OFFSET, _OFFSET] = left, gained
        self._filter.predict()
        self._restart.advance(motion)

    def update(self, factor: Factor) -> Innovation | None:
        self.advance(factor.stamp_ns)
        if self._pose is None:
            if isinstance(factor, PoseFactor):
                self._believe(factor.pose, factor.covariance)
            return None
        residual, by_state = self._met(factor)
        expected = by_state @ self._filter.P @ by_state.T + factor.covariance
        nis = float(squared_mahalanobis(residual, expected))
        weight = self._trust(factor, residual, expected, nis)
        innovation = Innovation(factor.stamp_ns, residual, expected, nis, weight)
        if (elsewhere := self._restart.consider(factor, disagrees=weight < 1.0)) is not None:
            self.carried_ns.append((self._restart.since_ns, elsewhere.stamp_ns))
            self._believe(elsewhere.pose, elsewhere.covariance)
            return innovation
        self._filter.update(
            -residual, HJacobian=lambda _: by_state, Hx=lambda _: np.zeros(len(residual)), R=factor.covariance / weight
        )
        self._absorb()
        return innovation

    def estimate(self) -> Estimate | None:
        if self._pose is None or self._motion.stamp_ns is None:
            return None
        return Estimate(self._motion.stamp_ns, self._pose, se2.rotate_covariance(self._filter.P[:3, :3], self._pose[2]))

    def _met(self, factor: Factor) -> tuple[FloatArray, FloatArray]:
        """The factor's error (m,) as things are thought to be, and its derivative (m, _SIZE) by the error state."""
        assert self._pose is not None
        by_state = np.pad(factor.jacobian(self._pose), [(0, 0), (0, _SIZE - 3)])
        if not (isinstance(factor, HeadingFactor) and factor.by_compass):
            return factor.error(self._pose), by_state
        by_state[:, _OFFSET] = by_state[:, 2]
        return factor.error(self._pose + [0.0, 0.0, self._offset_rad]), by_state

    def _trust(self, factor: Factor, residual: FloatArray, expected: FloatArray, nis: float) -> float:
        """1, or less the more the factor disagrees. A compass that is disturbed for long shows it by each reading: how
        little it says for repeating itself is not to hide it."""
        if isinstance(factor, HeadingFactor) and factor.wider > 1.0:
            nis = float(squared_mahalanobis(residual, expected - factor.covariance * (1.0 - 1.0 / factor.wider)))
        return self._config.robust.trust(nis, len(residual))

    def _believe(self, pose: FloatArray, robot_covariance: FloatArray) -> None:
        """Forget the pose, not what is known of odometry and compass."""
        self._pose = pose
        self._filter.P = block_diag(robot_covariance, self._filter.P[3:, 3:])
        self._restart.forget()

    def _absorb(self) -> None:
        """Take the error state into pose, calibration and offset, and the covariance to the new pose's tangent."""
        assert self._pose is not None
        step = self._filter.x
        self._pose = se2.retract(self._pose, step[:3])
        self._calibration = self._calibration + step[3:_OFFSET]
        self._offset_rad += float(step[_OFFSET])
        reset = block_diag(se2.right_jacobian(step[:3]), np.eye(_SIZE - 3))
        self._filter.P = reset @ self._filter.P @ reset.T
        self._filter.x = np.zeros(_SIZE)
