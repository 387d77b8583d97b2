"""What truly happened to the robot in a game, sample by sample: the one truth that every simulated sensor looks at."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.pose import FloatArray

SAMPLE_NS = 10_000_000
"""Between two samples of a course: 100 Hz."""
ROBOT_RADIUS_M = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """The player's and the other robots' motion, n samples at 100 Hz.

    stamps_ns: (n,) strictly increasing.
    poses: (n, 3) field_from_robot. They jump where someone carried the robot, when it is put down.
    velocities: (n, 3) forward m/s, left m/s, turning rad/s, held from each sample to the next:
    poses[k + 1] == compose(poses[k], exp(velocities[k] * seconds)) but for the jumps, before which they are 0.
    gait_phase_rad: (n,) grows by pi with each step and stays where it is while the robot does not step.
    walking, upright: (n,) it steps; it is on its feet (not from the beginning of a fall to the end of the get-up).
    seeing: (n,) its images are of use: neither carried nor fallen.
    others: (n, k, 2) where the other robots stand, each ROBOT_RADIUS_M wide around it; NaN while off the field.
    """

    stamps_ns: NDArray[np.int64]
    poses: FloatArray
    velocities: FloatArray
    gait_phase_rad: FloatArray
    walking: NDArray[np.bool_]
    upright: NDArray[np.bool_]
    seeing: NDArray[np.bool_]
    others: FloatArray

    def index_at(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """The sample in force at each stamp (...): the last one not after it, the first one before the course."""
        return np.clip(np.searchsorted(self.stamps_ns, stamps_ns, side="right") - 1, 0, len(self.stamps_ns) - 1)

    def poses_at(self, stamps_ns: NDArray[np.int64]) -> FloatArray:
        """The exact poses (..., 3) at any stamps (...); before and after the course those at its ends."""
        at = self.index_at(stamps_ns)
        since_s = np.clip(stamps_ns - self.stamps_ns[at], 0, SAMPLE_NS) * 1e-9
        since_s = np.where(at == len(self.stamps_ns) - 1, 0.0, since_s)
        return se2.compose(self.poses[at], se2.exp(self.velocities[at] * since_s[..., None]))
