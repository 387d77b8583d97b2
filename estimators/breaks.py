"""The breaks of a way that was solved: which are those of a robot that was carried, and how well it is known when."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from estimators.chain import Recorded
from estimators.joint import Settled
from estimators.motion import STANDSTILL
from estimators.stretches import NEAR
from fieldloc import pose as se2
from fieldloc.pose import FloatArray

_DRIFT_SIGMAS = 3.0
SURELY = float(np.log(100.0))
"""What a break or a slip must be likelier by than its rate: evidence at solutions is off by some of that."""


def was_carried(recorded: Recorded, settled: Settled, node: int) -> bool:
    """Whether the robot was put down farther away than odometry slips and than sights err alike."""
    apart, _ = jump(recorded, settled, *recorded.between(settled.choices, node))
    return bool((np.abs(apart) > NEAR).any())


def was_put_back(recorded: Recorded, settled: Settled) -> bool:
    """Whether between two breaks the robot came back to where it would have walked to anyway.

    Nobody carries a robot so: in between, sights erred alike (a label that was misread again and again, a look-alike).
    """
    for away, back in pairwise(settled.breaks):
        before, _ = recorded.between(settled.choices, away)
        _, after = recorded.between(settled.choices, back)
        apart, covariance = jump(recorded, settled, before, after)
        if (np.abs(apart) < NEAR + _DRIFT_SIGMAS * np.sqrt(np.diagonal(covariance))).all():
            return True
    return False


def jump(recorded: Recorded, settled: Settled, before: int, after: int) -> tuple[FloatArray, FloatArray]:
    """How far (3,) the pose at one node is from where odometry leads from another, and the odometry's covariance."""
    moved = STANDSTILL
    for motion in recorded.motions[before:after]:
        moved = moved.then(motion)
    moved = moved.calibrated(np.array(settled.solution.calibration))
    poses = settled.solution.poses
    return se2.local(se2.compose(poses[before], moved.before_from_after), poses[after]), moved.covariance


def unsure_when(recorded: Recorded, settled: Settled) -> Settled:
    """With covariances, between the sights about each break, that know that it may have come at any moment there.

    A robot loses sight as it is taken or falls, or on its way it does not look: as likely it was at once as at any
    moment until it sees again. Where the other side of the break would have it be, so far the pose may be off, half of
    that towards there and half of it anywhere: nobody is carried in a straight line.
    """
    if not settled.breaks:
        return settled
    solution = settled.solution
    poses, covariances, calibration = solution.poses, solution.covariances.copy(), np.array(solution.calibration)
    for node in settled.breaks:
        before, after = recorded.between(settled.choices, node)
        passed = np.array(recorded.stamps_ns[before : after + 1]) - recorded.stamps_ns[before]
        gone = 0.5 + 0.5 * passed / max(int(passed[-1]), 1)
        way = [motion.calibrated(calibration).before_from_after for motion in recorded.motions[before:after]]
        earlier, later = poses[before : after + 1].copy(), poses[before : after + 1].copy()
        for k in range(node - before, after - before + 1):
            earlier[k] = se2.compose(earlier[k - 1], way[k - 1])
        for k in range(node - before - 1, -1, -1):
            later[k] = se2.compose(later[k + 1], se2.inverse(way[k]))
        moved = np.arange(before, after + 1) >= node
        apart = np.where(moved[:, None], se2.local(later, earlier), se2.local(earlier, later))
        off = apart[:, :, None] * apart[:, None, :] + each_way(apart)
        other = np.where(moved, 1.0 - gone, gone)
        covariances[before + 1 : after] += 0.5 * (other[:, None, None] * off)[1:-1]
    return replace(settled, solution=replace(solution, covariances=covariances))


def each_way(apart: FloatArray) -> FloatArray:
    """(n, 3, 3) covariances of a pose that is so far (n, 3) off in an unknown direction."""
    out = np.zeros((len(apart), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = 0.5 * np.sum(apart[:, :2] ** 2, axis=1)
    out[:, 2, 2] = apart[:, 2] ** 2
    return out
