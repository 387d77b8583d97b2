"""A heading from a magnetometer, or from an IMU that knows its own.

A magnetometer's field is turned into the robot's axes, which also takes out how the sensor leans as far as the
transforms know it. Iron on the robot is not corrected for.
"""

from collections.abc import Iterator
from math import atan2, hypot

import numpy as np

from fieldloc import pose as se2
from fieldloc.measurements import Compass
from logs.foreign.parts import ImuPart, MagneticPart, Part
from logs.foreign.rotations import heading, motion, multiply, rotate
from logs.foreign.surroundings import Surroundings, Unusable

_WEAKEST = 1e-9  # tesla; the earth's field is 2e-5 along the ground
_NORTH = "the mapping does not say where north is on the field: [compass] north_deg"
_ZERO = "the mapping does not say what the IMU's zero heading is on the field: [compass] imu_heading_deg"


class CompassAdapter:
    def __init__(self, surroundings: Surroundings) -> None:
        self._around = surroundings
        self._settings = surroundings.mapping.compass

    def take(self, topic: str, stamp_ns: int, part: Part) -> Iterator[Compass]:
        match part:
            case MagneticPart():
                heading_rad = self._magnetic(part, stamp_ns)
            case ImuPart():
                heading_rad = self._imu(part, stamp_ns)
            case _:
                return
        yield Compass(stamp_ns, float(se2.wrap(heading_rad)), self._settings.sigma_rad)

    def finish(self) -> Iterator[Compass]:
        return iter(())

    def _magnetic(self, part: MagneticPart, stamp_ns: int) -> float:
        if self._settings.north_rad is None:
            raise Unusable(_NORTH)
        if not np.isfinite(part.field).all():
            raise Unusable("the magnetic field is not a number")
        x, y, z = part.field.tolist()
        forward, left, _ = rotate(self._around.turned_into_robot(part.frame, stamp_ns), (x, y, z))
        if hypot(forward, left) < _WEAKEST:
            raise Unusable("the magnetic field has no direction along the ground")
        return self._settings.north_rad - atan2(left, forward)

    def _imu(self, part: ImuPart, stamp_ns: int) -> float:
        if self._settings.imu_heading_rad is None:
            raise Unusable(_ZERO)
        world_from_imu = None if part.rotation is None else motion(np.zeros(3), part.rotation)
        if world_from_imu is None:
            raise Unusable("the IMU states no orientation")
        x, y, z, w = self._around.turned_into_robot(part.frame, stamp_ns)
        robot = multiply(world_from_imu.rotation, (-x, -y, -z, w))
        return self._settings.imu_heading_rad + heading(robot)
