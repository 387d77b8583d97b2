"""An independent check of how a log was read: no choices, all solutions at once as factors under a robust kernel.

Every whole pose that a mixture allows pulls at its node, and the kernel lets go of those that fit nothing else. That
has a minimum for each place where the robot can have been, so it is solved from each solution of the first mixtures
that have any; the best minimum is the answer. Decoys bend it a little and nothing in it knows of breaks or of what is
likely: it is a check, not an estimate (see docs/smoothing.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from estimators.chain import Recorded
from estimators.solution import MOTION_FLOOR
from fieldloc import pose as se2
from fieldloc.mixture import PoseSolutions
from fieldloc.pose import FloatArray

_KERNEL = 2.0  # of Geman and McClure's kernel, in sigmas


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """poses: (n, 3) that a start led to; cost: what the kernels have left of the misfit."""

    poses: FloatArray
    cost: float


def multi_start(recorded: Recorded, most_starts: int = 32, most_mixtures: int = 200) -> tuple[Start, ...]:
    """The best first; empty where no mixture holds a whole pose.

    Dead-reckoned from each start. Mixtures are spread evenly over the log where there are more than `most_mixtures`.
    """
    found = [(node, mixture.solutions()) for node, mixture in recorded.mixtures]
    found = [(node, solutions) for node, solutions in found if len(solutions.ids)]
    if not found:
        return ()
    used = np.unique(np.linspace(0, len(found) - 1, most_mixtures).round().astype(int))
    graph = _graph(recorded, [found[i] for i in used])
    starts: list[tuple[int, FloatArray]] = []
    for node, solutions in found:
        starts += [(node, pose) for pose in solutions.poses]
        if len(starts) >= most_starts:
            break
    ends = [_solved(graph, _dead_reckoned(recorded, node, pose)) for node, pose in starts[:most_starts]]
    return tuple(sorted(ends, key=lambda end: end.cost))


def _graph(recorded: Recorded, found: Sequence[tuple[int, PoseSolutions]]) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    kernel = gtsam.noiseModel.mEstimator.GemanMcClure.Create(_KERNEL)
    for k, motion in enumerate(recorded.motions):
        noise = gtsam.noiseModel.Gaussian.Covariance(motion.covariance + MOTION_FLOOR)
        graph.add(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(*motion.before_from_after.tolist()), noise))
    for node, solutions in found:
        for pose, covariance in zip(solutions.poses.tolist(), solutions.covariances, strict=True):
            robust = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Gaussian.Covariance(covariance))
            graph.add(gtsam.PriorFactorPose2(node, gtsam.Pose2(*pose), robust))
    return graph


def _dead_reckoned(recorded: Recorded, node: int, pose: FloatArray) -> FloatArray:
    poses = np.zeros((len(recorded.stamps_ns), 3))
    poses[node] = pose
    for k in range(node, len(poses) - 1):
        poses[k + 1] = se2.compose(poses[k], recorded.motions[k].before_from_after)
    for k in range(node, 0, -1):
        poses[k - 1] = se2.compose(poses[k], se2.inverse(recorded.motions[k - 1].before_from_after))
    return poses


def _solved(graph: gtsam.NonlinearFactorGraph, poses: FloatArray) -> Start:
    values = gtsam.Values()
    for k, pose in enumerate(poses.tolist()):
        values.insert(k, gtsam.Pose2(*pose))
    # a prior that is next to nothing, for a start whose sights all let go
    graph = gtsam.NonlinearFactorGraph(graph)
    weak = gtsam.noiseModel.Diagonal.Sigmas(np.array([100.0, 100.0, 10.0]))
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*poses[0].tolist()), weak))
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values)
    values = optimizer.optimize()
    ends = [values.atPose2(k) for k in range(len(poses))]
    return Start(np.array([[pose.x(), pose.y(), pose.theta()] for pose in ends]), float(optimizer.error()))
