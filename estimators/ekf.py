"""Extended Kalman filter on filterpy: the readable baseline, one Gaussian, first order.

filterpy keeps the error state: a robot-frame tangent, the errors of the odometry's calibration, of the eyes' and of the
compass' offset, zero after every update, beside the pose and these themselves. So the heading needs no wrapping inside
the filter, and the covariance does not depend on where on the field the robot stands.
"""

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import block_diag

from estimators.base import Estimate, Innovation
from estimators.config import Config
from estimators.divergence import Restart
from estimators.legs import Legs
from estimators.motion import CALIBRATION, STANDSTILL, HeldVelocity
from estimators.views import LATE, OFFSET, SIZE, View, Views, of_factor, prior
from fieldloc import pose as se2
from fieldloc.covariance import propagate, squared_mahalanobis
from fieldloc.factors import Factor, HeadingFactor, PoseFactor
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray


class Ekf:
    """Starts at the first whole-pose factor unless `start` is called before."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._motion = HeldVelocity(config.motion, config.calibration.odometry_delay_s)
        self._restart = Restart(config.robust.restart_after)
        self._pose: FloatArray | None = None
        self.carried_ns: list[tuple[int, int]] = []
        """From when to when it was somewhere else unnoticed, for each restart."""
        self._extra, known = prior(config)
        """(EXTRA,) beside the pose: what is to be added to the heading to have the compass' comes last."""
        self._views = Views(config, self._motion)
        self._legs = Legs(config.motion)
        self._pending = STANDSTILL
        self._filter = ExtendedKalmanFilter(dim_x=SIZE, dim_z=3)
        self._filter.x = np.zeros(SIZE)
        self._filter.Q = np.zeros((SIZE, SIZE))
        self._filter.P = block_diag(np.eye(3), known)

    def start(self, estimate: Estimate) -> None:
        self.advance(estimate.stamp_ns)
        self._believe(estimate.pose, estimate.robot_covariance, self._views.now(self._extra))

    def predict(self, odometry: Odometry) -> None:
        self.advance(odometry.stamp_ns)
        self._motion.hold(odometry)
        self._filter.P[LATE, LATE] += self._views.heard()

    def advance(self, stamp_ns: int) -> None:
        before_ns = self._motion.stamp_ns
        motion = self._motion.advance(stamp_ns)
        if motion is None or before_ns is None or self._pose is None:
            return
        motion = motion.calibrated(self._extra[:CALIBRATION])
        self._pose = se2.compose(self._pose, motion.before_from_after)
        self._filter.F[:3, :3] = motion.back
        self._filter.F[:3, 3 : 3 + CALIBRATION] = motion.by_calibration
        self._filter.Q[:3, :3] = motion.covariance
        left, gained = self._config.compass.wander((stamp_ns - before_ns) * 1e-9)
        self._extra[-1] *= left
        self._filter.F[OFFSET, OFFSET], self._filter.Q[OFFSET, OFFSET] = left, gained
        self._filter.predict()
        self._restart.advance(motion)
        self._pending = self._pending.then(motion)

    def looked(self) -> None:
        self._motion.looked()

    def update(self, factor: Factor) -> Innovation | None:
        self.advance(factor.stamp_ns)
        view = of_factor(self._views, factor, self._extra, self._filter.P[3:, 3:])
        if self._pose is None:
            if isinstance(factor, PoseFactor):
                self._believe(factor.pose, factor.covariance, view)
            return None
        self._legs.move(self._pending, self._extra[:CALIBRATION])
        self._pending = STANDSTILL
        at = view.of(self._pose, self._extra)
        residual, by_state = factor.error(at), factor.jacobian(at) @ view.by_state
        left_open = propagate(factor.jacobian(at), view.chance)
        expected = by_state @ self._filter.P @ by_state.T + left_open + factor.covariance
        nis = float(squared_mahalanobis(residual, expected))
        weight = self._trust(factor, residual, expected, nis)
        innovation = Innovation(factor.stamp_ns, residual, expected, nis, weight)
        if (elsewhere := self._restart.consider(factor, disagrees=weight < 1.0)) is not None:
            self.carried_ns.append((self._restart.since_ns, elsewhere.stamp_ns))
            self._believe(elsewhere.pose, elsewhere.covariance, view)
            return innovation
        noise = left_open + factor.covariance / weight
        self._filter.update(-residual, HJacobian=lambda _: by_state, Hx=lambda _: np.zeros(len(residual)), R=noise)
        self._absorb()
        self._motion.scales = self._legs.look(self._pose, self._filter.P, self._extra[:CALIBRATION])
        return innovation

    def estimate(self) -> Estimate | None:
        return self._seen(self._views.now(self._extra))

    def seen_from(self) -> Estimate | None:
        """Where the eyes were when they saw what they show now."""
        return self._seen(self._views.sight(self._extra, self._filter.P[3:, 3:]))

    @property
    def legs(self) -> Legs:
        """What has been learned of the odometry's noise."""
        return self._legs

    @property
    def learned(self) -> tuple[FloatArray, FloatArray]:
        """Mean (EXTRA,) and covariance (EXTRA, EXTRA) of what is kept beside the pose (`estimators.views`)."""
        return self._extra, self._filter.P[3:, 3:]

    def _seen(self, view: View) -> Estimate | None:
        if self._pose is None or self._motion.stamp_ns is None:
            return None
        pose = view.of(self._pose, self._extra)
        covariance = self._motion.doubted(view.covariance(self._filter.P))
        return Estimate(self._motion.stamp_ns, pose, se2.rotate_covariance(covariance, pose[2]))

    def _trust(self, factor: Factor, residual: FloatArray, expected: FloatArray, nis: float) -> float:
        """1, or less the more the factor disagrees. A compass that is disturbed for long shows it by each reading: how
        little it says for repeating itself is not to hide it."""
        if isinstance(factor, HeadingFactor) and factor.wider > 1.0:
            nis = float(squared_mahalanobis(residual, expected - factor.covariance * (1.0 - 1.0 / factor.wider)))
        return self._config.robust.trust(nis, len(residual))

    def _believe(self, pose: FloatArray, robot_covariance: FloatArray, view: View) -> None:
        """Forget the pose, not what is known of odometry, eyes and compass."""
        self._pose = view.back(pose, self._extra)
        self._filter.P = view.of_state(robot_covariance, self._filter.P[3:, 3:])
        self._restart.forget()
        self._legs.begin(self._pose, self._filter.P, self._extra[:CALIBRATION])
        self._pending = STANDSTILL

    def _absorb(self) -> None:
        """Take the error state into the pose and what is beside it, and the covariance to the new pose's tangent."""
        assert self._pose is not None
        step = self._filter.x
        self._pose = se2.retract(self._pose, step[:3])
        self._extra = self._extra + step[3:]
        turned = se2.right_jacobian(step[:3])
        self._filter.P[:3] = turned @ self._filter.P[:3]
        self._filter.P[:, :3] = self._filter.P[:, :3] @ turned.T
        self._filter.x = np.zeros(SIZE)
