"""The chain as a factor graph in GTSAM: the batch solution, its marginals, and what is the same over all of the chain.

The optimiser finds the poses by native factors alone, as one Python factor makes its time grow with the square of the
number of poses. Then come steps in which all is linearised together (estimators.linearised), with the calibrations of
odometry and sensor as one variable more, and the compass' offset: so that each step solves for poses and calibrations
together and the marginals know that these are not known exactly. Lines of one direction are poses that are free along
the line to the optimiser.
"""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import gtsam
import numpy as np

from estimators.chain import Chain
from estimators.config import Config
from estimators.graph.compass_offsets import CompassOffsets
from estimators.graph.elimination import elimination_order
from estimators.linearised import Linearised
from estimators.motion import CALIBRATION, OdometryCalibration
from estimators.sensor import SensorCalibration
from estimators.solution import GLOBALS, MOTION_FLOOR, WEAK_SIGMAS, Solution
from fieldloc import pose as se2
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.pose import FloatArray

_STACK_BYTES = 512 * 1024 * 1024  # elimination recurses: 90,000 poses overflow the usual 8 MB; only touched pages count
_MAX_STEPS = 10
_CONVERGED = 1e-4  # change of the graph's error: along no direction more than a hundredth of a standard deviation or so


def solve(chain: Chain, config: Config, near: Solution | None = None) -> Solution:
    """The most probable poses given all factors, each with its marginal covariance.

    near: an earlier solution of almost the same chain, whose poses are the chain's guess: it saves the search.
    """
    return _with_big_stack(lambda: _Problem(chain, config, near).solve())


class _Problem:
    """The poses have the keys 0 to n - 1, what is the same over the chain n, the compass' offsets the rest."""

    def __init__(self, chain: Chain, config: Config, near: Solution | None) -> None:
        self._chain, self._near = chain, near
        self._count = len(chain.stamps_ns)
        self._cauchy = config.graph.cauchy
        self._linearised = Linearised(chain, config)
        self._compass = CompassOffsets(chain, config.compass, self._count + 1)
        self._order = elimination_order(self._compass.knots_of_nodes, self._compass.count, self._count)
        if self._linearised.free.any():
            self._order.push_back(self._count)

    def solve(self) -> Solution:
        common, offsets = self._linearised.means.copy(), np.zeros(self._compass.count)
        free = self._linearised.free
        if self._near is None:
            poses = self._searched()
        else:
            poses = self._chain.guess
            common = np.where(free, [*self._near.calibration, *self._near.sensor], common)
            offsets[:] = self._near.compass_rad if len(offsets) == len(self._near.compass_rad) else 0.0
        error = self._error(poses, common, offsets)
        for _ in range(_MAX_STEPS):
            step = self._linear(poses, common, offsets).optimize(self._order)
            if free.any():
                common[free] += step.at(self._count)
            offsets += self._compass.step(step)
            poses = se2.retract(poses, np.array([step.at(k) for k in range(self._count)]))
            before, error = error, self._error(poses, common, offsets)
            if abs(before - error) <= _CONVERGED:
                break
        if not np.isfinite(error):
            raise ValueError("the graph's error is not finite: a factor holds a value that is not")
        tree = self._linear(poses, common, offsets).eliminateMultifrontal(self._order)
        covariance = np.zeros((GLOBALS, GLOBALS))
        if free.any():
            covariance[np.ix_(free, free)] = tree.marginalCovariance(self._count)
        return Solution(
            poses,
            np.array([tree.marginalCovariance(k) for k in range(self._count)]),
            OdometryCalibration(*common[:CALIBRATION].tolist()),
            SensorCalibration(*common[CALIBRATION:].tolist()),
            covariance,
            offsets,
            self._compass.variances(tree),
            2.0 * tree.logDeterminant(),
        )

    def _searched(self) -> FloatArray:
        """The optimiser's answer from the chain's guess, with stand-ins for what it has no factors for."""
        whole = _native(self._chain, self._cauchy)
        self._compass.stand_in(whole, self._cauchy)
        optimizer = gtsam.LevenbergMarquardtOptimizer(whole, _values(self._chain.guess))
        values = optimizer.optimize()
        if not np.isfinite(optimizer.error()):
            raise ValueError("the graph's error is not finite: a factor holds a value that is not")
        return np.array([_pose(values, k) for k in range(self._count)])

    def _error(self, poses: FloatArray, common: FloatArray, offsets: FloatArray) -> float:
        return self._linearised.error(poses, common) + self._compass.error(poses, offsets, self._cauchy)

    def _linear(self, poses: FloatArray, common: FloatArray, offsets: FloatArray) -> gtsam.GaussianFactorGraph:
        out = gtsam.GaussianFactorGraph()
        which = self._linearised.free
        free = bool(which.any())
        units = {m: gtsam.noiseModel.Unit.Create(m) for m in (1, 2, 3)}
        rows = self._linearised.motions(poses, common)
        for k, (before, after, by_globals, towards) in enumerate(zip(*rows, strict=True)):
            if free:
                out.add(gtsam.JacobianFactor(k, before, k + 1, after, self._count, by_globals, towards, units[3]))
            else:
                out.add(gtsam.JacobianFactor(k, before, k + 1, after, towards, units[3]))
        for group in self._linearised.factors(poses, common):
            unit = units[group.towards.shape[1]]
            sensor = np.any(group.by_globals, axis=(1, 2)).tolist()
            for node, by_pose, by_globals, towards, with_sensor in zip(
                group.nodes.tolist(), *group[1:], sensor, strict=True
            ):
                if with_sensor:
                    out.add(gtsam.JacobianFactor(node, by_pose, self._count, by_globals, towards, unit))
                else:
                    out.add(gtsam.JacobianFactor(node, by_pose, towards, unit))
        if free:
            weights = 1.0 / self._linearised.sigmas[which]
            unit = gtsam.noiseModel.Unit.Create(len(weights))
            out.add(
                gtsam.JacobianFactor(
                    self._count, np.diag(weights), (self._linearised.means - common)[which] * weights, unit
                )
            )
        self._compass.add_to(out, poses, offsets, self._cauchy)
        return out


def _native(chain: Chain, cauchy: float) -> gtsam.NonlinearFactorGraph:
    """Motions and all factors but the compass', in gtsam's own terms; what was seen, as if it were the robot's own."""
    graph = gtsam.NonlinearFactorGraph()
    noise: gtsam.noiseModel.Base
    for k, motion in enumerate(chain.motions):
        noise = gtsam.noiseModel.Gaussian.Covariance(motion.covariance + MOTION_FLOOR)
        graph.add(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(*motion.before_from_after.tolist()), noise))
    weak = gtsam.noiseModel.Diagonal.Sigmas(WEAK_SIGMAS)
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*chain.guess[0]), weak))
    for node, factor in chain.factors:
        noise = _robust(gtsam.noiseModel.Gaussian.Covariance(factor.covariance), cauchy)
        match factor:
            case PoseFactor():
                graph.add(gtsam.PriorFactorPose2(node, gtsam.Pose2(*factor.pose), noise))
            case LandmarkFactor():
                graph.add(gtsam.KnownLandmarkFactorPose2(node, factor.landmark, factor.seen, noise))
            case HeadingFactor(by_compass=True):
                pass
            case HeadingFactor():
                graph.add(gtsam.PoseRotationPrior2D(node, gtsam.Rot2(factor.heading_rad), noise))
            case LineFactor():
                graph.add(_anchored(node, factor, chain.guess[node], cauchy))
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


def _with_big_stack(work: Callable[[], Solution]) -> Solution:
    before = threading.stack_size(_STACK_BYTES)
    try:
        with ThreadPoolExecutor(max_workers=1) as pool:
            return pool.submit(work).result()
    finally:
        threading.stack_size(before)
