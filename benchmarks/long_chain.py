"""A chain of any length as estimators.chain records them, drawn from its own model."""

import numpy as np

from estimators.chain import Chain
from estimators.config import MotionNoise
from estimators.motion import HeldVelocity, Increment
from estimators.solution import MOTION_FLOOR
from fieldloc import pose as se2
from fieldloc.factors import Factor, LandmarkFactor, PoseFactor
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

_STEP_NS = 100_000_000
_VELOCITIES = np.array([[0.6, 0.0, 0.1], [0.3, 0.0, 0.9], [0.1, 0.3, -0.4], [0.5, 0.0, -0.6]])
_POSTS = np.array([[2.0, 1.0], [-1.0, 2.0], [0.5, -2.0]])
_FIX = np.diag([0.05, 0.05, 0.03]) ** 2
_POST = np.diag([0.1, 0.1]) ** 2
_GUESS_SIGMAS = np.array([0.1, 0.1, 0.05])


def long_chain(count: int, seed: int = 0) -> tuple[Chain, FloatArray]:
    """A node each 0.1 s with odometry, a whole pose and two landmarks beside the robot; the true poses (count, 3)."""
    random = np.random.default_rng(seed)
    motions = _motions(count - 1)
    covariances = np.array([motion.covariance for motion in motions]).reshape(-1, 3, 3) + MOTION_FLOOR
    drawn = np.linalg.cholesky(covariances) @ random.standard_normal((count - 1, 3, 1))
    steps = se2.retract(np.array([motion.before_from_after for motion in motions]).reshape(-1, 3), drawn[..., 0])
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(se2.compose(poses[-1], step))
    truth = np.array(poses)
    fixes = se2.retract(truth, random.standard_normal((count, 3)) * np.sqrt(np.diag(_FIX)))
    factors: list[tuple[int, Factor]] = []
    for k, pose in enumerate(truth):
        factors.append((k, PoseFactor(k * _STEP_NS, fixes[k], _FIX.copy(), by_sight=True)))
        for post in (k % 3, (k + 1) % 3):
            landmark = pose[:2] + _POSTS[post]
            seen = se2.apply(se2.inverse(pose), landmark) + 0.1 * random.standard_normal(2)
            factors.append((k, LandmarkFactor(k * _STEP_NS, landmark, seen, _POST.copy(), by_sight=True)))
    guess = se2.retract(truth, _GUESS_SIGMAS * random.standard_normal((count, 3)))
    return Chain(tuple(range(0, count * _STEP_NS, _STEP_NS)), tuple(motions), tuple(factors), guess), truth


def _motions(count: int) -> list[Increment]:
    held, out = HeldVelocity(MotionNoise()), []
    held.advance(0)
    for k in range(count):
        held.hold(Odometry(k * _STEP_NS, _VELOCITIES[k // 20 % len(_VELOCITIES)]))
        motion = held.advance((k + 1) * _STEP_NS)
        assert motion is not None
        out.append(motion)
    return out
