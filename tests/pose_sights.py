"""Ambiguous sights without a camera: whole poses, one of them seen from where the robot is, the others made up."""

from dataclasses import dataclass

import numpy as np
from walks import PLAIN, ns, velocities, walk

from estimators.base import Ambiguity, Estimate
from estimators.config import Config
from estimators.mixture import MixtureFilter
from fieldloc import pose as se2
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray
from fieldloc.regions import Region
from fieldloc.solution_mixture import SolutionMixture
from fieldloc.stacks import PoseStack

HALF_TURN = np.array([[0.0, 0.0, np.pi]])
HALF_X_M, HALF_Y_M = 5.0, 4.0
BOX = np.array([[-HALF_X_M, -HALF_Y_M, HALF_X_M, HALF_Y_M]])
ANY_HEADING = np.array([[0.0, np.pi]])
FIELD = Region("field", BOX, ANY_HEADING, HALF_TURN)
LOPSIDED = Region("field", BOX, ANY_HEADING)
OWN_HALF = Region("own-half", np.array([[-HALF_X_M, -HALF_Y_M, 0.0, HALF_Y_M]]), ANY_HEADING, HALF_TURN)
VOLUME = 4.0 * HALF_X_M * HALF_Y_M * 2.0 * np.pi
SIGMAS = np.array([0.1, 0.1, 0.05])
WRONG = 0.05
P3 = np.diag([0.2, 0.2, 0.05]) ** 2
START = np.array([1.0, -0.5, 0.3])


def of_poses(
    stamp_ns: int, poses: FloatArray, log_weights: FloatArray, log_outlier: float, symmetric: bool = False
) -> SolutionMixture:
    stack = PoseStack(poses, np.tile(np.diag(SIGMAS**2), (len(poses), 1, 1)))
    area_m2 = VOLUME / (2.0 * np.pi)
    return SolutionMixture(stamp_ns, ((stack, log_weights),), log_outlier, symmetric, area_m2)


def sight(
    stamp_ns: int,
    pose: FloatArray,
    random: np.random.Generator,
    decoys: int = 2,
    symmetric: bool = True,
    wrong: float = WRONG,
) -> SolutionMixture:
    """decoys + 1 poses, the first to the last alike; with their twins if the field is symmetric. One in twenty times
    (`wrong`) all are decoys. Its densities are those by which it was drawn."""
    count = decoys + 1
    poses = random.uniform(-1.0, 1.0, (count, 3)) * [HALF_X_M, HALF_Y_M, np.pi]
    if random.random() >= wrong:
        poses[random.integers(count)] = se2.retract(pose, SIGMAS * random.standard_normal(3))
    if symmetric:
        # drawn up to the half turn: which of both it was is not seen
        poses = np.concatenate([poses, se2.compose(HALF_TURN[0], poses)])
    room = np.log(VOLUME / 2.0) if symmetric else np.log(VOLUME)
    log_weights = np.full(len(poses), np.log((1.0 - WRONG) / count) - decoys * room)
    return of_poses(stamp_ns, poses, log_weights, np.log(WRONG) - count * room, symmetric)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    stamp_s: float
    truth: FloatArray
    estimate: Estimate
    ambiguity: Ambiguity

    def error(self, other_side: bool = False) -> FloatArray:
        """(3,) of the estimate or of its twin."""
        pose = se2.compose(HALF_TURN[0], self.estimate.pose) if other_side else self.estimate.pose
        out = pose - self.truth
        out[2] = se2.wrap(out[2])
        return np.asarray(out)

    @property
    def nees(self) -> float:
        """Of the estimate or its twin, whichever is better."""
        turned = (self.estimate.covariance, se2.rotate_covariance(self.estimate.covariance, np.pi))
        errors = (self.error(), self.error(other_side=True))
        return float(min(e @ np.linalg.solve(c, e) for e, c in zip(errors, turned, strict=True)))


def stroll(
    seed: int,
    seconds: float,
    region: Region = FIELD,
    config: Config = PLAIN,
    every: int = 5,
    decoys: int = 2,
    carried_at_s: float | None = None,
) -> tuple[MixtureFilter, list[Seen]]:
    """A walk at 10 Hz with a sight at every fifth step."""
    random = np.random.default_rng(seed)
    commands = velocities(round(10 * seconds))
    symmetric = len(region.symmetries) > 0
    box = region.boxes[0] * 0.8
    start = np.append(random.uniform(box[:2], box[2:]), random.uniform(-np.pi, np.pi))
    truth = walk(start[None], commands, 0.1, random)[:, 0]
    if carried_at_s is not None:
        at = round(10 * carried_at_s)
        elsewhere = random.uniform(-0.8, 0.8, 3) * [HALF_X_M, HALF_Y_M, np.pi]
        truth[at:] = se2.compose(elsewhere, se2.compose(se2.inverse(truth[at]), truth[at:]))
    estimator = MixtureFilter(config)
    estimator.start_in(region, 0)
    out = []
    for k, velocity in enumerate(commands):
        estimator.predict(Odometry(ns(0.1 * k), velocity))
        if k % every == 0:
            estimator.observe(sight(ns(0.1 * k), truth[k], random, decoys, symmetric))
            estimate, ambiguity = estimator.estimate(), estimator.ambiguity()
            if estimate is not None and ambiguity is not None:
                out.append(Seen(0.1 * k, truth[k], estimate, ambiguity))
    return estimator, out


def now(estimator: MixtureFilter) -> Ambiguity:
    ambiguity = estimator.ambiguity()
    assert ambiguity is not None
    return ambiguity


def started(config: Config = PLAIN, remember: bool = False, stamp_ns: int = 0) -> MixtureFilter:
    estimator = MixtureFilter(config, remember=remember)
    estimator.start(Estimate(stamp_ns, START, se2.rotate_covariance(P3, START[2])))
    return estimator


def as_table(ambiguity: Ambiguity) -> FloatArray:
    """(n, 4) weight and pose, in an order that depends on nothing else."""
    table = np.array([[h.weight, *h.pose] for h in ambiguity.hypotheses])
    return table[np.lexsort(np.round(table.T, 5))]
