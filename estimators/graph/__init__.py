"""The chain as a factor graph in GTSAM: the batch solution, its marginals and the odometry's calibration.

Native factors only: one Python factor makes the optimiser's time grow with the square of the number of poses. What
gtsam has no factor for enters the linearised graph by hand, in the steps that follow the optimiser's: the calibration
as columns more, so that each step solves for poses and calibration together and the marginals know that it is not known
exactly; lines of one direction, which the optimiser knows only as poses that are free along the line; and the compass
with its offset.
"""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import gtsam
import numpy as np

from estimators.chain import Chain
from estimators.config import Config
from estimators.graph.compass_offsets import CompassOffsets
from estimators.motion import OdometryCalibration
from fieldloc import pose as se2
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.pose import FloatArray

_STACK_BYTES = 512 * 1024 * 1024  # elimination recurses: 90,000 poses overflow the usual 8 MB; only touched pages count
_MAX_STEPS = 10
_CONVERGED = 1e-5  # relative change of the graph's error
MOTION_FLOOR = np.diag([1e-4, 1e-4, 1e-4]) ** 2
"""(3, 3) added to each motion's covariance. A robot that stands still for a moment moves less; gtsam takes a system
with much smaller ones for indeterminate."""
_WEAK_SIGMAS = np.array([100.0, 100.0, 10.0])  # keeps a chain determined whose factors leave a direction free


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """poses: (n, 3) of the chain's nodes; covariances: (n, 3, 3) marginal, robot frame."""

    poses: FloatArray
    covariances: FloatArray
    calibration: OdometryCalibration
    compass_rad: FloatArray
    compass_variance_rad2: FloatArray
    """Both (k,): the compass' offset over time, a value each `compass_offsets.knot_s` from the chain's start on; none
    without a compass."""
    log_determinant: float
    """Of the information about poses, calibration and offsets together, robust weights and weak priors included."""


def solve(chain: Chain, config: Config, near: Solution | None = None) -> Solution:
    """The most probable poses given all factors, each with its marginal covariance.

    near: an earlier solution of almost the same chain, whose poses are the chain's guess: it saves the search.
    """
    return _with_big_stack(lambda: _Problem(chain, config, near).solve())


class _Problem:
    """The poses have the keys 0 to n - 1, the free part of the calibration n, the compass' offsets the rest."""

    def __init__(self, chain: Chain, config: Config, near: Solution | None) -> None:
        self._chain, self._near = chain, near
        self._count = len(chain.stamps_ns)
        sigmas = config.calibration.sigmas()
        self._free = sigmas > 0.0
        self._prior_weights = 1.0 / sigmas[self._free]
        self._between = np.array([motion.before_from_after for motion in chain.motions]).reshape(-1, 3)
        self._by_calibration = np.array([motion.by_calibration for motion in chain.motions]).reshape(-1, 3, 6)
        covariances = np.array([motion.covariance for motion in chain.motions]).reshape(-1, 3, 3) + MOTION_FLOOR
        self._roots = np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariances)), -1, -2)
        self._motion_noise = [gtsam.noiseModel.Gaussian.SqrtInformation(root, False) for root in self._roots]
        self._cauchy = config.graph.cauchy
        self._compass = CompassOffsets(chain, config.compass, self._count + 1)
        self._lines = [(node, factor) for node, factor in chain.factors if isinstance(factor, LineFactor)]
        self._unary = _unary(chain, config.graph.cauchy)

    def solve(self) -> Solution:
        calibration, offsets = np.zeros(6), np.zeros(self._compass.count)
        if self._near is None:
            graph = self._graph(calibration)
            values = self._searched(graph)
        else:
            calibration[:] = self._near.calibration
            offsets[:] = self._near.compass_rad if len(offsets) == len(self._near.compass_rad) else 0.0
            graph, values = self._graph(calibration), _values(self._chain.guess)
        steps = self._near is not None or self._free.any() or self._lines or len(offsets)
        error = self._error(graph, values, calibration, offsets)
        for _ in range(_MAX_STEPS if steps else 0):
            step = self._linear(graph, values, calibration, offsets).optimize()
            if self._free.any():
                calibration[self._free] += step.at(self._count)
            offsets += self._compass.step(step)
            values = values.retract(_poses_only(step, self._count))
            graph = self._graph(calibration)
            before, error = error, self._error(graph, values, calibration, offsets)
            if abs(before - error) <= _CONVERGED * error:
                break
        if not np.isfinite(error):
            raise ValueError("the graph's error is not finite: a factor holds a value that is not")
        tree = self._linear(graph, values, calibration, offsets).eliminateMultifrontal()
        return Solution(
            np.array([_pose(values, k) for k in range(self._count)]),
            np.array([tree.marginalCovariance(k) for k in range(self._count)]),
            OdometryCalibration(*calibration.tolist()),
            offsets,
            self._compass.variances(tree),
            2.0 * tree.logDeterminant(),
        )

    def _searched(self, graph: gtsam.NonlinearFactorGraph) -> gtsam.Values:
        """The optimiser's answer from the chain's guess, with stand-ins for what it has no factors for."""
        whole = gtsam.NonlinearFactorGraph(graph)
        for node, line in self._lines:
            whole.add(_anchored(node, line, self._chain.guess[node], self._cauchy))
        self._compass.stand_in(whole, self._cauchy)
        optimizer = gtsam.LevenbergMarquardtOptimizer(whole, _values(self._chain.guess))
        values = optimizer.optimize()
        if not np.isfinite(optimizer.error()):
            raise ValueError("the graph's error is not finite: a factor holds a value that is not")
        return values

    def _graph(self, calibration: FloatArray) -> gtsam.NonlinearFactorGraph:
        """The motions first, in the chain's order, then all else that gtsam has a factor for."""
        graph = gtsam.NonlinearFactorGraph()
        moved = se2.retract(self._between, self._by_calibration @ calibration)
        for k, (pose, noise) in enumerate(zip(moved.tolist(), self._motion_noise, strict=True)):
            graph.add(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(*pose), noise))
        graph.push_back(self._unary)
        return graph

    def _error(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, calibration: FloatArray, offsets: FloatArray
    ) -> float:
        prior = 0.5 * float(np.sum((calibration[self._free] * self._prior_weights) ** 2))
        squares = np.array([np.sum(_whitened(line, _pose(values, node))[0] ** 2) for node, line in self._lines])
        lines = 0.5 * self._cauchy**2 * float(np.sum(np.log1p(squares / self._cauchy**2)))
        return float(graph.error(values)) + prior + lines + self._compass.error(values, offsets, self._cauchy)

    def _linear(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, calibration: FloatArray, offsets: FloatArray
    ) -> gtsam.GaussianFactorGraph:
        """Linearised at the values, with lines, compass, columns for the free calibration in the motions, its prior."""
        linear = graph.linearize(values)
        motions = len(self._between)
        out = gtsam.GaussianFactorGraph()
        if self._free.any():
            whitened = np.array([linear.at(k).augmentedJacobian() for k in range(motions)]).reshape(-1, 3, 7)
            unit = gtsam.noiseModel.Unit.Create(3)
            for k, (row, column) in enumerate(zip(whitened, self._columns(whitened, calibration), strict=True)):
                out.add(gtsam.JacobianFactor(k, row[:, :3], k + 1, row[:, 3:6], self._count, column, row[:, 6], unit))
            towards_zero = -calibration[self._free] * self._prior_weights
            unit = gtsam.noiseModel.Unit.Create(len(self._prior_weights))
            out.add(gtsam.JacobianFactor(self._count, np.diag(self._prior_weights), towards_zero, unit))
        for i in range(motions if self._free.any() else 0, linear.size()):
            out.add(linear.at(i))
        unit = gtsam.noiseModel.Unit.Create(2)
        for node, line in self._lines:
            residual, jacobian = _whitened(line, _pose(values, node))
            weight = 1.0 / np.sqrt(1.0 + residual @ residual / self._cauchy**2)
            out.add(gtsam.JacobianFactor(node, weight * jacobian, -weight * residual, unit))
        self._compass.add_to(out, values, offsets, self._cauchy)
        return out

    def _columns(self, whitened: FloatArray, calibration: FloatArray) -> FloatArray:
        """(n - 1, 3, free) derivative of the motions' whitened errors by the calibration.

        whitened: (n - 1, 3, 7) of the motions, its last column their errors, negative.
        """
        error = np.asarray(np.linalg.solve(self._roots, -whitened[:, :, 6:]))[..., 0]
        moved = se2.right_jacobian(self._by_calibration @ calibration) @ self._by_calibration[:, :, self._free]
        # the prediction is on the error's left side
        return np.asarray(-self._roots @ se2.right_jacobian_inverse(-error) @ moved)


def _unary(chain: Chain, cauchy: float) -> gtsam.NonlinearFactorGraph:
    """All factors but lines and compass, in gtsam's own terms, which have their errors up to sign."""
    graph = gtsam.NonlinearFactorGraph()
    weak = gtsam.noiseModel.Diagonal.Sigmas(_WEAK_SIGMAS)
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*chain.guess[0]), weak))
    for node, factor in chain.factors:
        match factor:
            case PoseFactor():
                noise = _robust(gtsam.noiseModel.Gaussian.Covariance(factor.covariance), cauchy)
                graph.add(gtsam.PriorFactorPose2(node, gtsam.Pose2(*factor.pose), noise))
            case LandmarkFactor():
                noise = _robust(gtsam.noiseModel.Gaussian.Covariance(factor.covariance), cauchy)
                graph.add(gtsam.KnownLandmarkFactorPose2(node, factor.landmark, factor.seen, noise))
            case HeadingFactor(by_compass=True) | LineFactor():
                pass
            case HeadingFactor():
                noise = _robust(gtsam.noiseModel.Gaussian.Covariance(factor.covariance), cauchy)
                graph.add(gtsam.PoseRotationPrior2D(node, gtsam.Rot2(factor.heading_rad), noise))
            case _:
                raise TypeError(f"no native factor for {type(factor).__name__}")
    return graph


def _anchored(node: int, line: LineFactor, guess: FloatArray, cauchy: float) -> gtsam.NonlinearFactor:
    """A pose that is free along the line, anchored where the guess is: nearly the line as long as that way is short."""
    along = line.normal_rad + 0.5 * np.pi
    free = guess[0] * np.cos(along) + guess[1] * np.sin(along)
    anchor = se2.apply(np.array([0.0, 0.0, line.normal_rad]), np.array([line.offset_m, free]))
    pose = np.array([*anchor, line.heading_rad])
    root = np.vstack([_whitened(line, pose)[1], np.zeros(3)])
    noise = _robust(gtsam.noiseModel.Gaussian.SqrtInformation(root, False), cauchy)
    return gtsam.PriorFactorPose2(node, gtsam.Pose2(*pose.tolist()), noise)


def _whitened(factor: Factor, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The factor's error (m,) and Jacobian (m, 3) at a pose, in its own sigmas."""
    whitener = np.linalg.inv(np.linalg.cholesky(factor.covariance))
    return whitener @ factor.error(pose), whitener @ factor.jacobian(pose)


def _robust(base: gtsam.noiseModel.Base, cauchy: float) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(cauchy), base)


def _pose(values: gtsam.Values, key: int) -> FloatArray:
    pose = values.atPose2(key)
    return np.array([pose.x(), pose.y(), pose.theta()])


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
