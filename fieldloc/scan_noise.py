"""How large the errors of a scan's landmarks really are, beside what the log states, and how much of them is shared.

Who states 5 % of a range may mean 3 %; and where a camera is tilted or turned a little, all ranges of an image are too
long together, all bearings too large. Each landmark then has an error of its own beside what all of one scan share.
"""

import math
from dataclasses import dataclass

import numpy as np

from fieldloc.pose import FloatArray


@dataclass(frozen=True, slots=True)
class ScanNoise:
    """Variances as shares of the stated ones: of each landmark's own error, and of what all of one scan share.

    What is shared turns all bearings by one angle, and makes all ranges too long by as many of their stated standard
    deviations.
    """

    own_range: float = 1.0
    own_bearing: float = 1.0
    shared_range: float = 0.0
    shared_bearing: float = 0.0

    def of(self, covariance: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Covariances (n, 2, 2) of range and bearing as stated become each landmark's own, and standard deviations
        (n, 2) of what is shared, None for nothing."""
        both = math.sqrt(self.own_range * self.own_bearing)
        own = covariance * np.array([[self.own_range, both], [both, self.own_bearing]])
        if self.shared_range <= 0.0 and self.shared_bearing <= 0.0:
            return own, None
        return own, np.sqrt(_variances(covariance) * np.array([self.shared_range, self.shared_bearing]))


AS_STATED = ScanNoise()


@dataclass(frozen=True, slots=True)
class NoisePrior:
    """What is thought of a sensor's scans before it has shown how good it is.

    own, shared: ScanNoise's shares, of ranges and bearings alike; own_log_sigma, shared_log_sigma: standard deviations
    of their logarithms, with which they are learned. 0 takes the log at its word. What landmarks' own errors leave of
    the variance that was thought of is taken for shared: of bearings always, as nothing within a scan can show by how
    much all of it is turned; of ranges until scans show how much it is, which few do.
    """

    own: float = 1.0
    shared: float = 0.1
    own_log_sigma: float = 1.0
    shared_log_sigma: float = 1.5


UNLEARNED = NoisePrior(shared=0.0, own_log_sigma=0.0, shared_log_sigma=0.0)


def shared_directions(covariance: FloatArray) -> FloatArray:
    """(n, 2) standard deviations in range and bearing that a shared error has if it is as large as the stated ones."""
    return np.sqrt(_variances(covariance))


def _variances(covariance: FloatArray) -> FloatArray:
    """(n, 2) of a shared error that is as large as the stated ones: all bearings turn alike."""
    out = np.empty((len(covariance), 2))
    out[:, 0] = covariance[:, 0, 0]
    out[:, 1] = covariance[:, 1, 1].sum() / max(len(covariance), 1)
    return out
