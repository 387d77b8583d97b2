"""What a robot's eyes get wrong in the same way all the time: where they are, how they are turned, how late."""

from typing import NamedTuple

import numpy as np

from fieldloc import pose as se2
from fieldloc.pose import FloatArray


class SensorCalibration(NamedTuple):
    """The eyes are `forward_m` and `left_m` beside where they are said to be, in the robot's frame; bearings are larger
    by `bearing_offset_rad`; what is stamped now was seen `delay_s` before. All zero is perfect.

    So what is seen is about the pose `seen_from`, not about that of the robot.
    """

    forward_m: float = 0.0
    left_m: float = 0.0
    bearing_offset_rad: float = 0.0
    delay_s: float = 0.0


SENSOR = len(SensorCalibration._fields)


def lever(velocity: FloatArray) -> FloatArray:
    """(..., 3, 4): change of the robot-frame tangent of the pose that was seen from with the calibration.

    velocity: (..., 3) of the robot at the stamp, robot frame, m/s and rad/s.
    """
    out = np.zeros((*velocity.shape, SENSOR))
    out[..., 0, 0] = out[..., 1, 1] = 1.0
    out[..., 2, 2] = -1.0
    out[..., 3] = -velocity
    return out


def seen_from(poses: FloatArray, sensor: FloatArray, velocity: FloatArray) -> FloatArray:
    """Poses (..., 3) that something was seen from by robots at `poses` (..., 3) with a calibration `sensor` (4,)."""
    return se2.retract(poses, lever(velocity) @ sensor)


LEVER_BY_VELOCITY = lever(np.eye(3)) - lever(np.zeros(3))
"""(3, 3, 4): change of the lever with each number of the velocity, in which it is linear."""
