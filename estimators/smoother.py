"""The batch smoother: an EKF goes ahead to find the start and the way, then one solution for the whole past."""

from estimators.base import Estimate, Innovation
from estimators.chain import ChainRecorder
from estimators.config import Config
from estimators.ekf import Ekf
from estimators.graph import Solution, solve
from estimators.motion import HeldVelocity
from fieldloc import pose as se2
from fieldloc.factors import Factor, PoseFactor
from fieldloc.measurements import Odometry


class Smoother:
    """Online it answers as the EKF does; `trajectory` looks back with all that is known by then."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._ahead = Ekf(config)
        self._motion = HeldVelocity(config.motion)
        self._recorder = ChainRecorder(config.graph.node_interval_s)
        self.solution: Solution | None = None
        """Of the last call of `trajectory`."""

    def start(self, estimate: Estimate) -> None:
        self._ahead.start(estimate)
        self._recorder = ChainRecorder(self._config.graph.node_interval_s)
        at_ns = self._record(estimate.stamp_ns)
        told = PoseFactor(at_ns, estimate.pose, se2.rotate_covariance(estimate.covariance, -estimate.pose[2]))
        self._recorder.add(told, at_ns, estimate.pose)

    def predict(self, odometry: Odometry) -> None:
        self._ahead.predict(odometry)
        self._record(odometry.stamp_ns)
        self._motion.hold(odometry)

    def advance(self, stamp_ns: int) -> None:
        self._ahead.advance(stamp_ns)
        self._record(stamp_ns)

    def update(self, factor: Factor) -> Innovation | None:
        innovation = self._ahead.update(factor)
        at_ns = self._record(factor.stamp_ns)
        now = self.estimate()
        self._recorder.add(factor, at_ns, None if now is None else now.pose)
        return innovation

    def estimate(self) -> Estimate | None:
        return self._ahead.estimate()

    def trajectory(self) -> tuple[Estimate, ...]:
        """An estimate per node of the chain; none while the EKF has found no start."""
        chain = self._recorder.chain(self._ahead.carried_ns)
        if chain is None:
            return ()
        self.solution = solve(chain, self._config)
        covariances = se2.rotate_covariance(self.solution.covariances, self.solution.poses[:, 2])
        return tuple(map(Estimate, chain.stamps_ns, self.solution.poses, covariances))

    def _record(self, stamp_ns: int) -> int:
        """Up to the stamp; the stamp that is reached, later than a stamp that runs backwards."""
        motion = self._motion.advance(stamp_ns)
        at_ns = stamp_ns if self._motion.stamp_ns is None else self._motion.stamp_ns
        now = self.estimate()
        self._recorder.advance(at_ns, motion, None if now is None else now.pose)
        return at_ns
