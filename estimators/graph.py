"""The chain as a factor graph in GTSAM: the batch solution, its marginals and the odometry's calibration.

Native factors only: one Python factor makes the optimiser's time grow with the square of the number of poses. The
calibration enters by hand: the linearised graph gets four more columns, so each step solves for poses and calibration
together, and the marginals know that it is not known exactly.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np

from estimators.chain import Chain
from estimators.config import Graph
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


def solve(chain: Chain, config: Graph) -> Solution:
    """The most probable poses given all factors, each with its marginal covariance."""
    return _with_big_stack(lambda: _solve(chain, config))


def _solve(chain: Chain, config: Graph) -> Solution:
    calibration = np.zeros(4)
    prior_sigmas = np.array(
        [config.scale_sigma, config.turn_scale_sigma, config.veer_sigma_rad_per_m, config.crab_sigma_rad]
    )
    free = np.flatnonzero(prior_sigmas > 0.0)
    unary = _unary(chain, config)
    graph = _graph(chain, unary, calibration)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, _values(chain.guess))
    values = optimizer.optimize()
    error = optimizer.error()
    if not np.isfinite(error):
        raise ValueError("the graph's error is not finite: a factor holds a value that is not")
    for _ in range(_MAX_STEPS if len(free) else 0):
        linear = _linear(chain, graph, values, calibration, prior_sigmas, free)
        step = linear.optimize()
        calibration[free] += step.at(len(chain.stamps_ns))
        graph = _graph(chain, unary, calibration)
        values = values.retract(_poses_only(step, len(chain.stamps_ns)))
        before, error = error, graph.error(values) + 0.5 * float(np.sum((calibration[free] / prior_sigmas[free]) ** 2))
        if abs(before - error) <= _CONVERGED * error:
            break
    tree = _linear(chain, graph, values, calibration, prior_sigmas, free).eliminateMultifrontal()
    nodes = range(len(chain.stamps_ns))
    solved = [values.atPose2(k) for k in nodes]
    return Solution(
        np.array([[pose.x(), pose.y(), pose.theta()] for pose in solved]),
        np.array([tree.marginalCovariance(k) for k in nodes]),
        OdometryCalibration(*calibration.tolist()),
    )


def _graph(chain: Chain, unary: gtsam.NonlinearFactorGraph, calibration: FloatArray) -> gtsam.NonlinearFactorGraph:
    """The motions first, in the chain's order, then all else."""
    graph = gtsam.NonlinearFactorGraph()
    shift = np.array([motion.by_calibration @ calibration for motion in chain.motions]).reshape(-1, 3)
    between = np.array([motion.before_from_after for motion in chain.motions]).reshape(-1, 3)
    for k, moved in enumerate(se2.retract(between, shift)):
        noise = gtsam.noiseModel.Gaussian.Covariance(chain.motions[k].covariance + _MOTION_FLOOR)
        graph.add(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(*moved), noise))
    graph.push_back(unary)
    return graph


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
            noise = robust(gtsam.noiseModel.Gaussian.SqrtInformation(np.vstack([whitener @ jacobian, np.zeros(3)]), False))
            graph.add(gtsam.PriorFactorPose2(node, gtsam.Pose2(*anchor, factor.heading_rad), noise))
        case _:
            raise TypeError(f"no native factor for {type(factor).__name__}")


def _linear(
    chain: Chain,
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    calibration: FloatArray,
    prior_sigmas: FloatArray,
    free: FloatArray,
) -> gtsam.GaussianFactorGraph:
    """Linearised at the values, the motions with columns for the free calibration, whose key is the number of nodes."""
    linear = graph.linearize(values)
    if not len(free):
        return linear
    key = len(chain.stamps_ns)
    unit = gtsam.noiseModel.Unit.Create(3)
    out = gtsam.GaussianFactorGraph()
    for k, motion in enumerate(chain.motions):
        whitened = linear.at(k).augmentedJacobian()
        root = graph.at(k).noiseModel().R()
        column = -root @ motion.by_calibration[:, free]
        out.add(gtsam.JacobianFactor(k, whitened[:, :3], k + 1, whitened[:, 3:6], key, column, whitened[:, 6], unit))
    for i in range(len(chain.motions), linear.size()):
        out.add(linear.at(i))
    weights = 1.0 / prior_sigmas[free]
    unit = gtsam.noiseModel.Unit.Create(len(free))
    out.add(gtsam.JacobianFactor(key, np.diag(weights), -calibration[free] * weights, unit))
    return out


def _values(poses: FloatArray) -> gtsam.Values:
    values = gtsam.Values()
    for k, pose in enumerate(poses):
        values.insert(k, gtsam.Pose2(*pose))
    return values


def _poses_only(step: gtsam.VectorValues, count: int) -> gtsam.VectorValues:
    out = gtsam.VectorValues()
    for k in range(count):
        out.insert(k, step.at(k))
    return out


def _with_big_stack(work: Callable[[], Solution]) -> Solution:
    results: list[Solution] = []
    errors: list[Exception] = []

    def run() -> None:
        try:
            results.append(work())
        except Exception as error:
            errors.append(error)

    before = threading.stack_size(_STACK_BYTES)
    try:
        thread = threading.Thread(target=run)
        thread.start()
    finally:
        threading.stack_size(before)
    thread.join()
    if errors:
        raise errors[0]
    return results[0]
