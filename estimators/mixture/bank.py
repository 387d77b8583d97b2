"""The hypotheses of a Gaussian sum as arrays, moved and corrected all at once.

Each is a Gaussian over thirteen numbers (`estimators.views`): the robot-frame tangent at its pose, what odometry and
eyes get wrong, the robot's delay and the compass' offset. The map may look the same from several poses: then a
hypothesis stands for all of these copies, which are equally precise, and has a weight for each. That is the symmetry
folded: no copy can be lost while nothing tells it from the others.
"""

from dataclasses import dataclass, replace

import numpy as np

from estimators.mixture.log_sums import of_each
from estimators.motion import CALIBRATION, STANDSTILL, Increment
from estimators.views import EXTRA, OFFSET, SIZE, View
from fieldloc import pose as se2
from fieldloc.mixture import Expansion, IntArray
from fieldloc.one_pose import composed, retracted, spread
from fieldloc.pose import FloatArray

_IDENTITY = np.eye(SIZE)


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """h hypotheses, each with a weight for each of c copies.

    poses: (h, 3) of copy 0; copy i is at compose(copies[i], pose). extra: (h, EXTRA) calibrations and compass offset.
    covariances: (h, SIZE, SIZE). log_weights: (h, c). parents: (h,) row in the bank before the last observation, -1 for
    one that began with it; choices: (h,) which of that observation's solutions it took, -1 for none. found: (h,)
    whether it began as a robot that was carried and has not been the best since.
    """

    poses: FloatArray
    extra: FloatArray
    covariances: FloatArray
    log_weights: FloatArray
    parents: IntArray
    choices: IntArray
    found: IntArray

    @staticmethod
    def empty(copies: int) -> "Bank":
        none = np.zeros(0, dtype=np.intp)
        return Bank(
            np.zeros((0, 3)), np.zeros((0, EXTRA)), np.zeros((0, SIZE, SIZE)), np.zeros((0, copies)), none, none, none
        )

    def __len__(self) -> int:
        return len(self.poses)

    def take(self, rows: IntArray) -> "Bank":
        return Bank(
            self.poses[rows],
            self.extra[rows],
            self.covariances[rows],
            self.log_weights[rows],
            self.parents[rows],
            self.choices[rows],
            self.found[rows],
        )

    def weighing(self, log_weights: FloatArray) -> "Bank":
        """The same with other weights (h, c)."""
        return Bank(self.poses, self.extra, self.covariances, log_weights, self.parents, self.choices, self.found)

    def joined(self, other: "Bank") -> "Bank":
        if not len(other):
            return self
        if not len(self):
            return other
        return Bank(
            np.concatenate([self.poses, other.poses]),
            np.concatenate([self.extra, other.extra]),
            np.concatenate([self.covariances, other.covariances]),
            np.concatenate([self.log_weights, other.log_weights]),
            np.concatenate([self.parents, other.parents]),
            np.concatenate([self.choices, other.choices]),
            np.concatenate([self.found, other.found]),
        )

    @property
    def totals(self) -> FloatArray:
        """(h,) log-weights of all copies together."""
        return of_each(self.log_weights)

    def moved(self, motion: Increment, calibration: FloatArray, offset_left: float, offset_gain: float) -> "Bank":
        """After a motion, which is that of an odometry with the calibration (c,); others differ from it linearly.

        offset_left, offset_gain: share of the compass' offset that stays, variance that it gains.
        """
        extra = self.extra.copy()
        if len(self) == 1:
            poses = composed(self.poses[0], motion.before_from_after)[None]
        else:
            poses = se2.compose(self.poses, motion.before_from_after)
        others = extra[:, :CALIBRATION] - calibration
        if others.any():
            poses = se2.retract(poses, others @ motion.by_calibration.T)
        extra[:, -1] *= offset_left
        step = _IDENTITY.copy()
        step[:3, :3] = motion.back
        step[:3, 3 : 3 + CALIBRATION] = motion.by_calibration
        step[OFFSET, OFFSET] = offset_left
        covariances = step @ self.covariances @ step.T
        covariances[:, :3, :3] += motion.covariance
        covariances[:, OFFSET, OFFSET] += offset_gain
        return Bank(poses, extra, covariances, self.log_weights, self.parents, self.choices, self.found)

    def moved_one(self, row: int, motion: Increment, view: View) -> tuple[FloatArray, FloatArray]:
        """Pose (3,) and covariance (3, 3), as the view has them, of one whose odometry the motion is, after it."""
        step, chance, pose = view.by_state, view.chance, self.poses[row]
        if motion is not STANDSTILL:
            step = step.copy()
            step[:, :3] = motion.back
            step[:, 3 : 3 + CALIBRATION] += motion.by_calibration
            chance = motion.covariance + chance
            pose = composed(pose, motion.before_from_after)
        moved = step @ self.covariances[row] @ step.T + chance
        return retracted(pose, view.beside(self.extra[row])), moved

    def seen(self, view: View) -> "Bank":
        """With the poses and their covariances as the view has them."""
        covariances = self.covariances.copy()
        covariances[:, :3, :3] = view.covariance(self.covariances)
        return replace(self, poses=view.of(self.poses, self.extra), covariances=covariances)

    def corrected(self, rows: IntArray, seen: Expansion, log_weights: FloatArray, view: View) -> "Bank":
        """Children (c,): of `rows`, each with the quadratic of the expansion taken in, which is about the poses of the
        view."""
        covariances = self.covariances[rows]
        by_pose = covariances @ view.by_state.T
        # what shrinks the covariance of three numbers is taken to all SIZE of them (matrix inversion lemma)
        shrink = seen.shrink
        step = (by_pose @ (shrink.swapaxes(-1, -2) @ seen.gradient[:, :, None]))[:, :, 0]
        covariances = covariances - by_pose @ (seen.information @ shrink) @ by_pose.swapaxes(-1, -2)
        alone = len(rows) == 1
        turned = spread(*step[0, :3].tolist()) if alone else se2.right_jacobian(step[:, :3])
        covariances[:, :3] = turned @ covariances[:, :3]
        covariances[:, :, :3] = covariances[:, :, :3] @ turned.swapaxes(-1, -2)
        return Bank(
            retracted(self.poses[rows[0]], step[0, :3])[None] if alone else se2.retract(self.poses[rows], step[:, :3]),
            self.extra[rows] + step[:, 3:],
            0.5 * (covariances + covariances.swapaxes(-1, -2)),
            log_weights,
            rows,
            seen.ids,
            self.found[rows],
        )


def gaussian(pose: FloatArray, covariance: FloatArray, extra: FloatArray, copies: int) -> Bank:
    """One hypothesis (3,), (SIZE, SIZE), on copy 0 for sure. extra: (EXTRA,)."""
    log_weights = np.full((1, copies), -np.inf)
    log_weights[0, 0] = 0.0
    none = np.array([-1])
    return Bank(pose[None].copy(), extra[None].copy(), covariance[None], log_weights, none, none, np.array([0]))
