"""Which breaks of a way that was solved are those of a robot that was carried."""

from itertools import pairwise

import numpy as np

from estimators.chain import Recorded
from estimators.joint import Settled
from estimators.motion import STANDSTILL
from estimators.stretches import NEAR
from fieldloc import pose as se2
from fieldloc.pose import FloatArray

_DRIFT_SIGMAS = 3.0


def was_carried(recorded: Recorded, settled: Settled, node: int) -> bool:
    """Whether the robot was put down farther away than odometry slips and than sights err alike."""
    apart, _ = _jump(recorded, settled, *recorded.between(settled.choices, node))
    return bool((np.abs(apart) > NEAR).any())


def was_put_back(recorded: Recorded, settled: Settled) -> bool:
    """Whether between two breaks the robot came back to where it would have walked to anyway.

    Nobody carries a robot so: in between, sights erred alike (a label that was misread again and again, a look-alike).
    """
    for away, back in pairwise(settled.breaks):
        before, _ = recorded.between(settled.choices, away)
        _, after = recorded.between(settled.choices, back)
        apart, covariance = _jump(recorded, settled, before, after)
        if (np.abs(apart) < NEAR + _DRIFT_SIGMAS * np.sqrt(np.diagonal(covariance))).all():
            return True
    return False


def _jump(recorded: Recorded, settled: Settled, before: int, after: int) -> tuple[FloatArray, FloatArray]:
    """How far (3,) the pose at one node is from where odometry leads from another, and the odometry's covariance."""
    moved = STANDSTILL
    for motion in recorded.motions[before:after]:
        moved = moved.then(motion)
    moved = moved.calibrated(np.array(settled.solution.calibration))
    poses = settled.solution.poses
    return se2.local(se2.compose(poses[before], moved.before_from_after), poses[after]), moved.covariance
