"""The straight lines of a map as a grid: two perpendicular directions, and where the lines of each stand."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray, apply

_PARALLEL_RAD = 1e-3
_SAME_M = 1e-3


@dataclass(frozen=True, slots=True)
class LineGrid:
    """Map lines in axes turned by `heading_rad` against the field, so that each has one constant coordinate.

    axes: (m,) 0 where x is constant, 1 where y is. offsets_m: (m,) that constant. extents_m: (m, 2) lower and upper end
    in the other coordinate. Pieces of one straight line that touch are one line. Lines askew to the grid are not in it.
    """

    heading_rad: float
    axes: NDArray[np.intp]
    offsets_m: FloatArray
    extents_m: FloatArray


@lru_cache(maxsize=16)
def line_grid(field_map: FieldMap) -> LineGrid:
    """The grid to which the greatest length of the map's lines belongs."""
    lines = field_map.lines
    if not len(lines):
        return LineGrid(0.0, np.zeros(0, dtype=np.intp), np.zeros(0), np.zeros((0, 2)))
    along = lines[:, 1] - lines[:, 0]
    length = np.linalg.norm(along, axis=-1)
    fourfold = 4.0 * np.arctan2(along[:, 1], along[:, 0])  # equal modulo 2 pi for all lines of one grid
    parallel = np.cos(fourfold[:, None] - fourfold) > np.cos(4.0 * _PARALLEL_RAD)
    chosen = parallel[np.argmax(parallel @ length)]
    heading = float(np.angle(np.sum(length[chosen] * np.exp(1j * fourfold[chosen])))) / 4.0
    turned = apply(np.array([0.0, 0.0, -heading]), lines[chosen])
    axes = np.argmin(np.abs(turned[:, 1] - turned[:, 0]), axis=-1)
    rows = [
        (int(axis), float(ends[:, axis].mean()), *np.sort(ends[:, 1 - axis]).tolist())
        for axis, ends in zip(axes, turned, strict=True)
    ]
    rows.sort(key=lambda row: (row[0], round(row[1] / _SAME_M), row[2]))
    merged: list[tuple[int, float, float, float]] = []
    for axis, offset, low, high in rows:
        if merged and merged[-1][0] == axis and abs(offset - merged[-1][1]) < _SAME_M and low - merged[-1][3] < _SAME_M:
            merged[-1] = (*merged[-1][:3], max(high, merged[-1][3]))
        else:
            merged.append((axis, offset, low, high))
    table = np.array(merged)
    return LineGrid(heading, table[:, 0].astype(np.intp), table[:, 1], table[:, 2:])
