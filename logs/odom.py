"""Where the odometry alone says the robot is."""

from collections.abc import Iterable

import numpy as np

from estimators.config import MotionNoise
from fieldloc import pose as se2
from fieldloc.measurements import Measurement, Odometry
from fieldloc.pose import FloatArray
from logs.trajectory import IntArray

_MAX_HOLD_S = MotionNoise().max_hold_s


def odom_from_robot(
    measurements: Iterable[Measurement], stamps_ns: IntArray, max_hold_s: float = _MAX_HOLD_S
) -> FloatArray:
    """Poses (n, 3) at stamps (n,), the robot at the origin until the first odometry.

    Velocities are held as `estimators.motion.HeldVelocity` holds them, each for at most max_hold_s; but all at once.
    measurements: in the order of their stamps.
    """
    odometry = [measurement for measurement in measurements if isinstance(measurement, Odometry)]
    if not odometry or not len(stamps_ns):
        return np.zeros((len(stamps_ns), 3))
    begins_ns = np.array([one.stamp_ns for one in odometry], dtype=np.int64)
    velocities = np.array([one.velocity for one in odometry])
    hold_ns = int(max_hold_s * 1e9)
    held_ns = np.minimum(np.diff(begins_ns, append=begins_ns[-1] + hold_ns), hold_ns)
    steps = se2.exp(velocities * (held_ns * 1e-9)[:, None])
    # headings add up, so each step's direction is known at once, and the positions add up too
    headings = np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    moved = np.einsum("nij,nj->ni", se2.rotation(headings[:-1]), steps[:, :2])
    starts = np.column_stack([np.concatenate([np.zeros((1, 2)), np.cumsum(moved, axis=0)])[:-1], headings[:-1]])
    index = np.searchsorted(begins_ns, stamps_ns, side="right") - 1
    since_ns = np.clip(stamps_ns - begins_ns[np.maximum(index, 0)], 0, hold_ns)
    since_ns[index < 0] = 0
    within = se2.exp(velocities[np.maximum(index, 0)] * (since_ns * 1e-9)[:, None])
    return se2.compose(starts[np.maximum(index, 0)], within)
