"""The answer of locate."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One place and attitude of the camera that explains the picture.

    pose: (3,) x_m, y_m, heading_rad: the point of the ground straight below the camera, and where its optical axis
    points. covariance: (3, 3) of these in field axes. height_m, pitch_rad (looking down is positive), roll_rad (right
    side down is positive): with `full_covariance` (6, 6) of x, y, heading, height, pitch, roll.
    lines, posts: per one detected, the row of the map's lines as `Shape` has them, of its landmarks; -1 for none, -2
    for a line that is a piece of a circle's.
    circle: row of the map's circles or -1. log_evidence: log density of all detected, less that if none of it were the
    map's, integrated over all poses.
    """

    pose: FloatArray
    covariance: FloatArray
    probability: float
    height_m: float
    pitch_rad: float
    roll_rad: float
    full_covariance: FloatArray
    lines: NDArray[np.intp]
    posts: NDArray[np.intp]
    circle: int
    log_evidence: float

    @property
    def state(self) -> FloatArray:
        """(6,) as in `fieldloc.locate.states`."""
        return np.concatenate([self.pose, [self.height_m, self.pitch_rad, self.roll_rad]])


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """hypotheses: the likeliest first, empty for no pose. none: probability that it is none of them; all add up to
    one."""

    hypotheses: tuple[Hypothesis, ...]
    none: float
