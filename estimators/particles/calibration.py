"""What odometry and eyes get wrong, marginalised: a Gaussian that leans on where in the cloud the robot is.

A particle that is ahead of the others belongs to an odometry that reads short. So given the place d in the cloud, a
robot-frame tangent at its mean, the calibration is normal: mean + slope d, covariance `rest`. An observation is about
the pose only and says nothing more of the calibration once the pose is known: weighing particles moves the mean of d,
and with it the calibration's, and nothing else has to be done (Rao-Blackwellised, as in Schön, Gustafsson & Nordlund
2005, but given the present pose instead of the whole path: what is learned does not die out by resampling). Where the
cloud is a Gaussian this is the Kalman filter over pose and calibration.

What the eyes get wrong is of the same kind, as the particles are where the robot was seen from: with other eyes it
moved another way from sight to sight.
"""

from typing import NamedTuple

import numpy as np

from estimators.motion import Increment
from fieldloc import pose as se2
from fieldloc.pose import FloatArray


class Spreading(NamedTuple):
    """How a cloud spreads on its way. by_place: (3, 3) how much further a particle gets for being at d; noise: (3, 3)
    of what is left to chance; after: (3, 3) covariance of the cloud at the end."""

    by_place: FloatArray
    noise: FloatArray
    after: FloatArray


class CalibrationBelief:
    def __init__(self, mean: FloatArray, covariance: FloatArray) -> None:
        self.mean = mean
        self._slope = np.zeros((len(mean), 3))
        self._rest = covariance.copy()

    def widen(self, place: int, variance: float) -> None:
        """One of them is less known than was thought."""
        self._rest[place, place] += variance

    def covariance(self, cloud: FloatArray) -> FloatArray:
        """(n, n) in all, for a cloud of covariance (3, 3), robot frame."""
        return np.asarray(self._slope @ cloud @ self._slope.T + self._rest)

    def joint(self, cloud: FloatArray) -> FloatArray:
        """(3 + n, 3 + n) of the place and the calibration."""
        cross = self._slope @ cloud
        return np.block([[cloud, cross.T], [cross, self.covariance(cloud)]])

    def spreading(self, motion: Increment, cloud: FloatArray) -> Spreading:
        """motion: with the mean calibration in it already."""
        by_place = motion.by_calibration @ self._slope
        noise = motion.by_calibration @ self._rest @ motion.by_calibration.T + motion.covariance
        way = se2.adjoint(se2.inverse(motion.before_from_after)) + by_place
        return Spreading(by_place, noise, way @ cloud @ way.T + noise)

    def move(self, motion: Increment, cloud: FloatArray) -> Spreading:
        """The same, and lean on the places after the motion from now on."""
        out = self.spreading(motion, cloud)
        known = self.covariance(cloud)
        way = se2.adjoint(se2.inverse(motion.before_from_after))
        cross = self._slope @ cloud @ way.T + known @ motion.by_calibration.T
        scale = np.sqrt(np.maximum(np.diag(out.after), 1e-12))
        after = out.after / np.outer(scale, scale) + 1e-9 * np.eye(3)
        self._slope = np.linalg.solve(after, (cross / scale).T).T / scale
        rest = known - self._slope @ cross.T
        self._rest = 0.5 * (rest + rest.T)
        return out

    def shift(self, by: FloatArray) -> None:
        """The cloud's mean has moved by a tangent (3,): the places are counted from there."""
        self.mean = self.mean + self._slope @ by
        self._slope = self._slope @ se2.rotation3(by[2])

    def forget_place(self, cloud: FloatArray) -> None:
        """Keep what is known, no longer lean on the place in a cloud of covariance (3, 3): it is another cloud now."""
        self._rest, self._slope = self.covariance(cloud), np.zeros_like(self._slope)
