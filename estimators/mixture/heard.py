"""What the compass said last, for hypotheses that were not there to hear it.

Its readings are much the same for seconds, so each of them counts for little with who has heard those before. A robot
that is found has not: where the compass pointed just then is part of where it can be.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimators.config import Compass
from fieldloc.heading_mixture import HeadingMixture
from fieldloc.pose import FloatArray

_LATELY_NS = 1_000_000_000
_CARRIED_SINCE = 0.5  # of robots that are found elsewhere, how many were carried after the reading and not before it


@dataclass(frozen=True, slots=True)
class Heard:
    """reading: the last one, None before the first. since_rad: by how much the robot has turned since then."""

    reading: HeadingMixture | None = None
    since_rad: float = 0.0

    def turned(self, by_rad: float) -> "Heard":
        return self if self.reading is None else replace(self, since_rad=self.since_rad + by_rad)

    def lately(self, stamp_ns: int) -> bool:
        return self.reading is not None and 0 <= stamp_ns - self.reading.stamp_ns < _LATELY_NS

    def log_share(
        self, headings_rad: FloatArray, compass: Compass, stamp_ns: int, carried: NDArray[np.bool_]
    ) -> FloatArray:
        """(...) logarithm of how much likelier headings (...) are by it than all on the average; its offset is not
        known to who is found. 0 where it has not spoken lately. carried: of shape (...) too or to be broadcast, who was
        somewhere else before."""
        if self.reading is None or not self.lately(stamp_ns):
            return np.zeros_like(headings_rad)
        sigma_rad = float(np.hypot(self.reading.sigma_rad, compass.offset_sigma_rad))
        alone = replace(self.reading, sigma_rad=sigma_rad, wider=1.0)
        poses = np.zeros((*headings_rad.shape, 3))
        poses[..., 2] = headings_rad - self.since_rad
        share = alone.log_likelihood(poses) + np.log(2.0 * np.pi)
        return np.asarray(np.where(carried, np.log((1.0 - _CARRIED_SINCE) * np.exp(share) + _CARRIED_SINCE), share))
