"""Where a robot may be when a pose is not known: a half, a touch-line, the whole field."""

from dataclasses import dataclass, field

import numpy as np

from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray, wrap

_AROUND_M = 1.0  # a robot can stand outside of the lines
_EDGE_M = 0.3  # how blurred a region's edges are


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Rectangles in the field, each with a range of headings; the robot is in any of them alike.

    boxes: (b, 4) x_min, y_min, x_max, y_max. headings: (b, 2) middle and half width in radians, pi for any heading.
    symmetries: (s, 3) the poses that map the field onto itself, as FieldMap.symmetries.
    """

    name: str
    boxes: FloatArray
    headings: FloatArray
    symmetries: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def log_volume(self) -> float:
        """Of all boxes together, m^2 rad."""
        size = self.boxes[:, 2:] - self.boxes[:, :2]
        return float(np.log(np.sum(size[:, 0] * size[:, 1] * 2.0 * self.headings[:, 1])))

    def log_density(self, poses: FloatArray) -> FloatArray:
        """(...) of poses (..., 3); beyond an edge it falls as a normal density does, as no edge is exact."""
        x, y = poses[..., None, 0], poses[..., None, 1]
        left, low, right, high = self.boxes.T
        off_x, off_y = np.maximum(np.maximum(left - x, x - right), 0.0), np.maximum(np.maximum(low - y, y - high), 0.0)
        off_turn = np.maximum(np.abs(wrap(poses[..., None, 2] - self.headings[:, 0])) - self.headings[:, 1], 0.0)
        misfit = (off_x**2 + off_y**2) / _EDGE_M**2 + (off_turn / _EDGE_M) ** 2
        return np.asarray(-0.5 * misfit.min(axis=-1) - self.log_volume)


def anywhere(field_map: FieldMap) -> Region:
    """On the map and a metre around it."""
    x_min, y_min, x_max, y_max = field_map.bounds
    box = np.array([[x_min - _AROUND_M, y_min - _AROUND_M, x_max + _AROUND_M, y_max + _AROUND_M]])
    return Region("anywhere", box, np.array([[0.0, np.pi]]), field_map.symmetries)
