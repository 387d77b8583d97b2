"""The chain as a factor graph in GTSAM: the batch solution, its marginals and the odometry's calibration.

Native factors only: one Python factor makes the optimiser's time grow with the square of the number of poses. The
calibration enters by hand: the linearised graph gets four more columns, so each step solves for poses and calibration
together, and the marginals know that it is not known exactly.
"""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import gtsam
import numpy as np

from estimators.chain import Chain
from estimators.config import Calibration, Config, Graph
from estimators.motion import OdometryCalibration
from fieldloc import pose as se2
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.pose import FloatArray

_STACK_BYTES = 512 * 1024 * 1024  # elimination recurses: 90,000 poses overflow the usual 8 MB; only touched pages count
_MAX_STEPS = 10
_CONVERGED = 1e-5  # relative change of the graph's error
# a robot that stands still moves less than this; gtsam needs a covariance that can be inverted
_MOTION_FLOOR = np.diag([1e-6, 1e-6, 1e-6]) ** 2
_WEAK_SIGMAS = np.array([100.0, 100.0, 10.0])  # keeps a chain determined whose factors leave a direction free


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """poses: (n, 3) of the chain's nodes; covariances: (n, 3, 3) marginal, robot frame."""

    poses: FloatArray
    covariances: FloatArray
    calibration: OdometryCalibration


def solve(chain: Chain, config: Config) -> Solution:
    """The most probable poses given all factors, each with its marginal covariance."""
    return _with_big_stack(lambda: _Problem(chain, config.graph, config.calibration).solve())


class _Problem:
    """The poses have the keys 0 to n - 1, the free part of the calibration has n."""

    def __init__(self, chain: Chain, config: Graph, calibration: Calibration) -> None:
        self._chain = chain
        self._count = len(chain.stamps_ns)
        sigmas = calibration.sigmas()
        self._free = sigmas > 0.0
        self._prior_weights = 1.0 / sigmas[self._free]
        self._between = np.array([motion.before_from_after for motion in chain.motions]).reshape(-1, 3)
        self._by_calibration = np.array([motion.by_calibration for motion in chain.motions]).reshape(-1, 3, 6)
        covariances = np.array([motion.covariance for motion in chain.motions]).reshape(-1, 3, 3)
        roots = np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariances + _MOTION_FLOOR)), -1, -2)
        self._motion_noise = [gtsam.noiseModel.Gaussian.SqrtInformation(root, False) for root in roots]
        self._columns = -roots @ self._by_calibration[:, :, self._free]
        self._unary = _unary(chain, config)

    def solve(self) -> Solution:
        calibration = np.zeros(6)
        graph = self._graph(calibration)
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, _values(self._chain.guess))
        values = optimizer.optimize()
        error = optimizer.error()
        if not np.isfinite(error):
            raise ValueError("the graph's error is not finite: a factor holds a value that is not")
        for _ in range(_MAX_STEPS if self._free.any() else 0):
            step = self._linear(graph, values, calibration).optimize()
            calibration[self._free] += step.at(self._count)
            values = values.retract(_poses_only(step, self._count))
            graph = self._graph(calibration)
            prior = 0.5 * float(np.sum((calibration[self._free] * self._prior_weights) ** 2))
            before, error = error, graph.error(values) + prior
            if abs(before - error) <= _CONVERGED * error:
                break
        tree = self._linear(graph, values, calibration).eliminateMultifrontal()
        solved = [values.atPose2(k) for k in range(self._count)]
        return Solution(
            np.array([[pose.x(), pose.y(), pose.theta()] for pose in solved]),
            np.array([tree.marginalCovariance(k) for k in range(self._count)]),
            OdometryCalibration(*calibration.tolist()),
        )

    def _graph(self, calibration: FloatArray) -> gtsam.NonlinearFactorGraph:
        """The motions first, in the chain's order, then all else."""
        graph = gtsam.NonlinearFactorGraph()
        moved = se2.retract(self._between, self._by_calibration @ calibration)
        for k, (pose, noise) in enumerate(zip(moved.tolist(), self._motion_noise, strict=True)):
            graph.add(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(*pose), noise))
        graph.push_back(self._unary)
        return graph

    def _linear(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, calibration: FloatArray
    ) -> gtsam.GaussianFactorGraph:
        """Linearised at the values, with columns for the free calibration in the motions and a prior on it."""
        linear = graph.linearize(values)
        if not self._free.any():
            return linear
        out = gtsam.GaussianFactorGraph()
        unit = gtsam.noiseModel.Unit.Create(3)
        for k, column in enumerate(self._columns):
            whitened = linear.at(k).augmentedJacobian()
            out.add(
                gtsam.JacobianFactor(
                    k, whitened[:, :3], k + 1, whitened[:, 3:6], self._count, column, whitened[:, 6], unit
                )
            )
        for i in range(len(self._columns), linear.size()):
            out.add(linear.at(i))
        unit = gtsam.noiseModel.Unit.Create(len(self._prior_weights))
        towards_zero = -calibration[self._free] * self._prior_weights
        out.add(gtsam.JacobianFactor(self._count, np.diag(self._prior_weights), towards_zero, unit))
        return out


def _unary(chain: Chain, config: Graph) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    weak = gtsam.noiseModel.Diagonal.Sigmas(_WEAK_SIGMAS)
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*chain.guess[0]), weak))
    for node, factor in chain.factors:
        _add_native(graph, node, factor, chain.guess[node], config.cauchy)
    return graph


def _add_native(graph: gtsam.NonlinearFactorGraph, node: int, factor: Factor, guess: FloatArray, cauchy: float) -> None:
    """The factor in gtsam's own terms, which have its error up to sign."""
    kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(cauchy)

    def robust(base: gtsam.noiseModel.Base) -> gtsam.noiseModel.Base:
        return gtsam.noiseModel.Robust.Create(kernel, base)

    match factor:
        case PoseFactor():
            noise = robust(gtsam.noiseModel.Gaussian.Covariance(factor.covariance))
            graph.add(gtsam.PriorFactorPose2(node, gtsam.Pose2(*factor.pose), noise))
        case LandmarkFactor():
            noise = robust(gtsam.noiseModel.Gaussian.Covariance(factor.covariance))
            graph.add(gtsam.KnownLandmarkFactorPose2(node, factor.landmark, factor.seen, noise))
        case HeadingFactor():
            noise = robust(gtsam.noiseModel.Gaussian.Covariance(factor.covariance))
            graph.add(gtsam.PoseRotationPrior2D(node, gtsam.Rot2(factor.heading_rad), noise))
        case LineFactor():
            # a pose that is free along the line: anchored where the guess is, so that the free way is short
            along = factor.normal_rad + 0.5 * np.pi
            free = guess[0] * np.cos(along) + guess[1] * np.sin(along)
            anchor = se2.apply(np.array([0.0, 0.0, factor.normal_rad]), np.array([factor.offset_m, free]))
            jacobian = factor.jacobian(np.array([*anchor, factor.heading_rad]))
            whitener = np.linalg.inv(np.linalg.cholesky(factor.covariance))
            root = np.vstack([whitener @ jacobian, np.zeros(3)])
            noise = robust(gtsam.noiseModel.Gaussian.SqrtInformation(root, False))
            graph.add(gtsam.PriorFactorPose2(node, gtsam.Pose2(anchor[0], anchor[1], factor.heading_rad), noise))
        case _:
            raise TypeError(f"no native factor for {type(factor).__name__}")


def _values(poses: FloatArray) -> gtsam.Values:
    values = gtsam.Values()
    for k, pose in enumerate(poses):
        values.insert(k, gtsam.Pose2(*pose.tolist()))
    return values


def _poses_only(step: gtsam.VectorValues, count: int) -> gtsam.VectorValues:
    out = gtsam.VectorValues()
    for k in range(count):
        out.insert(k, step.at(k))
    return out


def _with_big_stack(work: Callable[[], Solution]) -> Solution:
    before = threading.stack_size(_STACK_BYTES)
    try:
        with ThreadPoolExecutor(max_workers=1) as pool:
            return pool.submit(work).result()
    finally:
        threading.stack_size(before)
