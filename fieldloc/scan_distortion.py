"""What a sensor's ranges and bearings get wrong in the same way all the time, learned from its scans.

A camera that ranges things by their size measures how far ahead they are, along its axis, not how far away: to the
side, its ranges are too short by the bearing's cosine. A focal length that is wrong makes all ranges and all bearings
wrong by a factor each. None of it needs the robot's pose to be seen: landmarks of one scan are as far apart as the map
says.
"""

from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np

from fieldloc.covariance import propagate
from fieldloc.pose import FloatArray

_WIDEST_RAD = float(np.deg2rad(75.0))  # nothing measures depths beyond


class ScanDistortion(NamedTuple):
    """Ranges are longer by `log_scale`, as logarithm; they are `depth` parts depths, 1 for a camera's, 0 for a laser's;
    longer by `askew` times the bearing's sine: a camera's axis is not where bearings are zero; bearings are larger by
    `bearing_scale` of themselves. All zero is perfect."""

    log_scale: float = 0.0
    depth: float = 0.0
    askew: float = 0.0
    bearing_scale: float = 0.0

    def removed(self, range_bearing: FloatArray) -> FloatArray:
        """(n, 2) as a perfect sensor would have it."""
        if not any(self):
            return range_bearing
        out = range_bearing.copy()
        out[:, 1] /= 1.0 + self.bearing_scale
        out[:, 0] *= np.exp(-self._longer(out[:, 1]))
        return out

    def added(self, range_bearing: FloatArray) -> FloatArray:
        """(n, 2) as this sensor has what a perfect one has so: the inverse."""
        r, b = range_bearing.T
        return np.stack([r * np.exp(self._longer(b)), b * (1.0 + self.bearing_scale)], axis=-1)

    def _longer(self, bearing_rad: FloatArray) -> FloatArray:
        return np.asarray(self.log_scale + self.depth * log_depth(bearing_rad) + self.askew * np.sin(bearing_rad))


PERFECT = ScanDistortion()


@dataclass(frozen=True, slots=True)
class DistortionPrior:
    """What is known of a sensor's distortion before a log, and how well, as standard deviations.

    It is learned from scans of several landmarks; a sigma of 0 takes it as known.
    """

    log_scale_sigma: float = 0.05
    depth_sigma: float = 0.5
    askew_sigma: float = 0.03
    bearing_scale_sigma: float = 0.03
    log_scale: float = 0.0
    depth: float = 0.0
    askew: float = 0.0
    bearing_scale: float = 0.0

    def means(self) -> FloatArray:
        """(4,) in the order of ScanDistortion."""
        return np.array(astuple(self)[4:])

    def sigmas(self) -> FloatArray:
        """(4,) in the order of ScanDistortion."""
        return np.array(astuple(self)[:4])


KNOWN = DistortionPrior(0.0, 0.0, 0.0, 0.0)


class DistortionLearner:
    """Of one sensor: recursive least squares."""

    def __init__(self, prior: DistortionPrior) -> None:
        self._mean = prior.means()
        self._covariance = np.diag(prior.sigmas() ** 2)
        self._moved, self._seen = np.zeros((2, 4)), 0

    @property
    def distortion(self) -> ScanDistortion:
        """As thought now."""
        return ScanDistortion(*self._mean.tolist())

    @property
    def sigmas(self) -> FloatArray:
        """(4,) standard deviations of it."""
        return np.asarray(np.sqrt(np.diagonal(self._covariance)))

    @property
    def place_covariance(self) -> FloatArray:
        """(2, 2) of where the sensor seems to be beside where it is, in its frame, by what is not known of its
        distortion: ranges that are too long are like a sensor too far back where all is seen ahead."""
        return propagate(self._moved / max(self._seen, 1), self._covariance)

    def uncertainty(self, range_bearing: FloatArray) -> FloatArray:
        """(2n, 2n) covariance of ranges and bearings (n, 2) by what is not known of it."""
        by_mean = _by_mean(range_bearing)
        return propagate(by_mean, self._covariance)

    def learn(self, range_bearing: FloatArray, error: FloatArray, precision: FloatArray) -> None:
        """range_bearing: (n, 2) with the present distortion removed; error (n, 2) by which the map says that it should
        be more; precision (2n, 2n) of that for all other reasons."""
        by_mean = _by_mean(range_bearing)
        information = by_mean.T @ precision @ by_mean
        left = np.linalg.solve(np.eye(4) + self._covariance @ information, self._covariance)
        self._mean = self._mean - left @ (by_mean.T @ precision @ error.ravel())
        self._covariance = 0.5 * (left + left.T)
        r, b = range_bearing.T
        along, across = by_mean[::2], by_mean[1::2] * r[:, None]
        self._moved += [np.cos(b) @ along - np.sin(b) @ across, np.sin(b) @ along + np.cos(b) @ across]
        self._seen += len(r)


def log_depth(bearing_rad: FloatArray) -> FloatArray:
    """Logarithm of a depth over its distance (n,), at these bearings."""
    return np.asarray(np.log(np.cos(np.minimum(np.abs(bearing_rad), _WIDEST_RAD))))


def _by_mean(range_bearing: FloatArray) -> FloatArray:
    """(2n, 4): change of ranges and bearings with a distortion."""
    r, b = range_bearing.T
    out = np.zeros((2 * len(r), 4))
    out[::2, 0], out[::2, 1], out[::2, 2], out[1::2, 3] = r, r * log_depth(b), r * np.sin(b), b
    return out
