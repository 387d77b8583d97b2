"""Where a robot may be when a pose is not known: a half, a touch-line, the whole field.

| name | where | facing |
|---|---|---|
| anywhere | on the map and a metre around it | anywhere |
| own-half, opponent-half | that half of it; own is where x is negative | anywhere |
| own-touch-line | along either touch-line in the own half, as robots enter a RoboCup game | the field |
| touch-line | along either touch-line | the field |
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray, wrap

_AROUND_M = 1.0  # a robot can stand outside of the lines
_EDGE_M = (
    0.15  # how blurred its edges are: who stands 0.7 m short of the half way line is not to be taken for beyond it
)
_INSIDE_M = 0.5  # of a touch-line, a robot beside it may have come that far
_FACING_RAD = np.radians(45.0)


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


def region(name: str, field_map: FieldMap) -> Region:
    """FieldlocError where there is none of that name, or the map has no such place."""
    if name not in _MAKERS:
        raise FieldlocError(f"region {name}: not known; give one of {', '.join(REGIONS)}")
    return _MAKERS[name](field_map)


def anywhere(field_map: FieldMap) -> Region:
    """On the map and a metre around it."""
    x_min, y_min, x_max, y_max = field_map.bounds
    box = np.array([[x_min - _AROUND_M, y_min - _AROUND_M, x_max + _AROUND_M, y_max + _AROUND_M]])
    return Region("anywhere", box, np.array([[0.0, np.pi]]), field_map.symmetries)


def draw(where: Region, count: int, random: np.random.Generator) -> FloatArray:
    """(count, 3) poses, any one in the region as likely as any other; its blurred edges are left out."""
    low, high = where.boxes[:, :2], where.boxes[:, 2:]
    volume = np.prod(high - low, axis=1) * where.headings[:, 1]
    of = random.choice(len(volume), count, p=volume / volume.sum())
    at = low[of] + (high - low)[of] * random.random((count, 2))
    middle, half = where.headings[of].T
    return np.column_stack([at, wrap(middle + half * random.uniform(-1.0, 1.0, count))])


def _half(name: str, side: float, field_map: FieldMap) -> Region:
    """side: -1 the own one, 1 the opponent's."""
    _check_lines(name, field_map)
    ((x_min, y_min, x_max, y_max),) = anywhere(field_map).boxes
    box = (x_min, y_min, 0.0, y_max) if side < 0 else (0.0, y_min, x_max, y_max)
    return Region(name, np.array([box]), np.array([[0.0, np.pi]]), field_map.symmetries)


def _touch_lines(name: str, x_max: float, field_map: FieldMap) -> Region:
    """As far as x_max, which is cut at the map's end."""
    _check_lines(name, field_map)
    x, y = field_map.lines[..., 0], field_map.lines[..., 1]
    begin, end = float(x.min()), min(x_max, float(x.max()))
    low, high = float(y.min()), float(y.max())
    boxes = [[begin, high - _INSIDE_M, end, high + _AROUND_M], [begin, low - _AROUND_M, end, low + _INSIDE_M]]
    headings = [[-0.5 * np.pi, _FACING_RAD], [0.5 * np.pi, _FACING_RAD]]
    return Region(name, np.array(boxes), np.array(headings), field_map.symmetries)


def _check_lines(name: str, field_map: FieldMap) -> None:
    if not len(field_map.lines):
        raise FieldlocError(
            f"region {name}: the map {field_map.name} has no lines, so no halves and no touch-lines; "
            "give a pose X,Y,HEADING_DEG, or anywhere"
        )


_MAKERS: Mapping[str, Callable[[FieldMap], Region]] = MappingProxyType(
    {
        "anywhere": anywhere,
        "own-half": lambda field_map: _half("own-half", -1.0, field_map),
        "opponent-half": lambda field_map: _half("opponent-half", 1.0, field_map),
        "own-touch-line": lambda field_map: _touch_lines("own-touch-line", 0.0, field_map),
        "touch-line": lambda field_map: _touch_lines("touch-line", np.inf, field_map),
    }
)
REGIONS = tuple(_MAKERS)
