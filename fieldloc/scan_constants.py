"""What is the same for all scans of a sensor on a map: the map by its labels, where the sensor sits."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fieldloc import pose as se2
from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray
from fieldloc.scan_moments import upper

_NO_ERROR = 1e-3  # of a variance


class Frames(NamedTuple):
    """(3, 3) from a robot's tangent to its sensor's, and back."""

    to_sensor: FloatArray
    to_robot: FloatArray


@lru_cache(maxsize=16)
def frames_of(x_m: float, y_m: float, turned_rad: float) -> Frames | None:
    """Of a sensor that is mounted there; None where it is the robot's origin."""
    mount = np.array([x_m, y_m, turned_rad])
    return Frames(se2.adjoint(se2.inverse(mount)), se2.adjoint(mount)) if mount.any() else None


class OnMap(NamedTuple):
    """row_of: a landmark by its label. diagonal_m: of the whole map. survey_m2: largest variance of a place."""

    row_of: dict[str, int]
    diagonal_m: float
    survey_m2: float

    def matters(self, covariance: FloatArray, ranges_m: FloatArray) -> bool:
        """Whether its errors are something beside those of a scan, of covariances (n, 2, 2) and ranges (n,): if not, it
        is as good as exact, which saves a third of the work."""
        if self.survey_m2 == 0.0:
            return False
        rr, rb, bb = upper(covariance)
        r2 = ranges_m * ranges_m
        # half the smaller variance at least of where one was seen
        smallest = (rr * bb - rb * rb) * r2 / (rr + r2 * bb)
        return bool(self.survey_m2 > _NO_ERROR * smallest.min())


@lru_cache(maxsize=16)
def on_map_of(field: FieldMap) -> OnMap:
    """Of a map that is compared by identity."""
    x_min, y_min, x_max, y_max = field.bounds
    survey_m2 = float(np.trace(field.positions_covariance, axis1=-2, axis2=-1).max(initial=0.0))
    row_of = {label: i for i, label in enumerate(field.labels)}
    return OnMap(row_of, math.hypot(x_max - x_min, y_max - y_min), survey_m2)
