"""How noisy a robot's odometry is, learned from where its way led.

A leg is a stretch of way at whose end the robot knows its pose much better than the odometry alone could tell. Of a
filter that knows its noise, the correction d over a leg has covariance C = carried - known: that of the pose carried
from the leg's start by the odometry, less that at its end (corrections are independent of what is known after them).

    log p(d) = -1/2 (log |C| + d' C^-1 d),   C = C0 + s1 C1 + s2 C2 + s3 C3 + ...

with C1 of the noise along the way, C2 and C3 of that of the heading, as it turns and as it goes, and the same of what
an odometry states of itself (`estimators.motion.PARTS`): drivers are wrong with it by factors, too. Fisher scoring, leg
by leg, gives the logarithms of the factors (maximum likelihood on innovations, but over legs: short ones would say how
alike consecutive sights err, and what slips slowly shows only in long ones). d is weighed as of a Student-t
distribution: no outlier has more than a say.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.config import MotionNoise
from estimators.motion import PARTS, STANDSTILL, Increment
from fieldloc import pose as se2
from fieldloc.covariance import squared_mahalanobis
from fieldloc.pose import FloatArray

_BETTER = 2.5**-6  # ratio of determinants: sigmas 2.5 times as large on the average
_TAILS = 6.0  # degrees of freedom
_NORMAL = 1.074  # of (tails + 5) / (tails + q), times q / 3, the mean for a normal d, with which it is no bias
_MOST_STEP = 0.7
_MOST = 4.0


def as_noisy(motions: Sequence[Increment], scales: FloatArray) -> tuple[Increment, ...]:
    """The motions of an odometry that is noisier by these factors (PARTS,) than is thought or stated."""
    parts = np.array([motion.parts for motion in motions]).reshape(-1, PARTS, 3, 3)
    more = np.tensordot(parts, scales - 1.0, ((1,), (0,)))
    return tuple(
        replace(motion, covariance=motion.covariance + added, parts=scales[:, None, None] * part)
        if part.any()
        else motion
        for motion, added, part in zip(motions, more, parts, strict=True)
    )


class Legs:
    def __init__(self, noise: MotionNoise) -> None:
        self._sigma = noise.log_scale_sigma
        self._logs = np.zeros(PARTS)
        self._information = np.eye(PARTS) / max(self._sigma, 1e-6) ** 2
        self._scales = self._mean()
        self._start: FloatArray | None = None

    @property
    def scales(self) -> FloatArray:
        """(PARTS,) by how much the variances are larger than was thought."""
        return self._scales

    @property
    def learned(self) -> tuple[FloatArray, FloatArray]:
        """Logarithms of the scales (PARTS,), and their information (PARTS, PARTS), what was thought before in it."""
        return self._logs, self._information

    def begin(self, pose: FloatArray, covariance: FloatArray, calibration: FloatArray) -> None:
        """covariance: (3 + n, 3 + n) or larger of the pose's tangent (3,) and the calibration (n,)."""
        size = 3 + len(calibration)
        self._start, self._covariance, self._calibration = pose, covariance[:size, :size], calibration
        self._way = replace(STANDSTILL, by_calibration=np.zeros((3, len(calibration))))

    def move(self, motion: Increment, calibration: FloatArray) -> None:
        """motion: with the calibration (n,) in it."""
        if self._start is not None and motion is not STANDSTILL:
            self._way = self._way.then(motion.calibrated(self._calibration - calibration))

    def look(self, pose: FloatArray, covariance: FloatArray, calibration: FloatArray) -> FloatArray:
        """The scales in the light of a corrected pose; arguments as of `begin`."""
        if self._sigma == 0.0:
            return self._scales
        if self._start is None:
            self.begin(pose, covariance, calibration)
        elif self._way.parts.any():
            self._end(pose, covariance, calibration)
        return self._scales

    def _end(self, pose: FloatArray, covariance: FloatArray, calibration: FloatArray) -> None:
        assert self._start is not None
        way = self._way
        step = np.concatenate([way.back, way.by_calibration], axis=1)
        carried = step @ self._covariance @ step.T + way.covariance
        known = covariance[:3, :3]
        if np.linalg.det(known) > _BETTER * np.linalg.det(carried):
            return
        there = se2.compose(self._start, way.before_from_after)
        expected = carried - se2.rotate_covariance(known, pose[2] - there[2])
        if np.linalg.eigvalsh(expected)[0] > 0.0:
            self._learn(se2.local(there, pose), expected, way.parts)
        self.begin(pose, covariance, calibration)

    def _learn(self, correction: FloatArray, expected: FloatArray, parts: FloatArray) -> None:
        by_part = np.linalg.solve(expected, parts)
        weighed = np.linalg.solve(expected, correction)
        weight = (_TAILS + 5.0) / (_TAILS + float(squared_mahalanobis(correction, expected))) / _NORMAL
        score = 0.5 * (weight * (parts @ weighed) @ weighed - np.trace(by_part, axis1=1, axis2=2))
        self._information = self._information + 0.5 * np.einsum("aij,bji->ab", by_part, by_part)
        step = np.linalg.solve(self._information, score)
        self._logs = np.clip(self._logs + np.clip(step, -_MOST_STEP, _MOST_STEP), -_MOST, _MOST)
        self._scales = self._mean()

    def _mean(self) -> FloatArray:
        """Of the scales, whose logarithms are known to be normal about what is thought of them."""
        if self._sigma == 0.0:
            return np.ones(PARTS)
        return np.exp(self._logs + 0.5 * np.diag(np.linalg.inv(self._information)))
