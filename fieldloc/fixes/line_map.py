"""The straight lines of a map as a grid: two perpendicular directions, and where the lines of each stand.

And that grid as robots see it whose own axes are turned by quarter turns against it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray, apply, rotation

_PARALLEL_RAD = 1e-3
_SAME_M = 1e-3
_NOWHERE = 1e9  # fills the tables where a turn has fewer lines of one family than of the other


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


@dataclass(frozen=True, slots=True, eq=False)
class TurnedGrid:
    """The grid in axes turned by `turns` (t,) quarter turns against it: family 0 has constant y there, family 1 x.

    offsets_m: (t, 2, m) that constant, by turn and family. middles_m, halves_m: (t, 2, m) of the extents in the other
    coordinate. rows: (t, 2, m) of the LineGrid. Beyond a family's lines stand ones that nothing matches.
    low_m, high_m: (t, 2) bounds of the lines' x and y.
    heading_rad: of the grid; cosines, sines: (t,) of its heading plus the turn. count: of the LineGrid's rows.
    twins: (r + 1,) which row each becomes when the field is turned by a half turn about `centre_in_field_m` (2,), the
    last being that of none, -1; None where the lines are not the same then. With twins there are two turns only: the
    other two are their copies.
    """

    turns: NDArray[np.intp]
    offsets_m: FloatArray
    middles_m: FloatArray
    halves_m: FloatArray
    rows: NDArray[np.intp]
    low_m: FloatArray
    high_m: FloatArray
    heading_rad: float
    cosines: FloatArray
    sines: FloatArray
    count: int
    centre_in_field_m: FloatArray
    twins: NDArray[np.intp] | None


@lru_cache(maxsize=16)
def turned_grid(field_map: FieldMap) -> TurnedGrid:
    grid = line_grid(field_map)
    ends = _ends(grid)
    low, high = (ends.min(axis=(0, 1)), ends.max(axis=(0, 1))) if len(ends) else (np.zeros(2), np.zeros(2))
    centre = 0.5 * (low + high)
    twins = _rows_of(2.0 * centre - ends, ends)
    turns = np.arange(4 if twins is None else 2)
    most = int(np.bincount(grid.axes, minlength=2).max())
    shape = (len(turns), 2, most)
    offsets, middles, halves = (np.full(shape, fill) for fill in (_NOWHERE, 0.0, -_NOWHERE))
    rows = np.full(shape, -1, dtype=np.intp)
    lows, highs = np.zeros((len(turns), 2)), np.zeros((len(turns), 2))
    for turn in turns:
        back = np.array([0.0, 0.0, -0.5 * np.pi * turn])
        turned = apply(back, ends)
        corners = apply(back, np.stack([low, high]))
        lows[turn], highs[turn] = corners.min(axis=0), corners.max(axis=0)
        for family in (0, 1):
            chosen = np.flatnonzero((1 - grid.axes + turn) % 2 == family)
            part = (turn, family, slice(len(chosen)))
            along = turned[chosen][..., family]
            offsets[part] = turned[chosen][..., 1 - family].mean(axis=1)
            middles[part], halves[part] = along.mean(axis=1), 0.5 * np.ptp(along, axis=1)
            rows[part] = chosen
    heading = 0.5 * np.pi * turns + grid.heading_rad
    return TurnedGrid(
        turns,
        offsets,
        middles,
        halves,
        rows,
        lows,
        highs,
        grid.heading_rad,
        np.cos(heading),
        np.sin(heading),
        len(ends),
        rotation(grid.heading_rad) @ centre,
        None if twins is None else np.append(twins, -1),
    )


def _ends(grid: LineGrid) -> FloatArray:
    """(m, 2, 2) end points in grid axes."""
    across = np.repeat(grid.offsets_m[:, None], 2, axis=1)
    first = (grid.axes == 0)[:, None]
    return np.stack([np.where(first, across, grid.extents_m), np.where(first, grid.extents_m, across)], axis=-1)


def _rows_of(lines: FloatArray, ends: FloatArray) -> NDArray[np.intp] | None:
    """(m,) which of `ends` each of the lines (m, 2, 2) is, from either end; None if one is not there."""
    if not len(ends):
        return None
    direct = np.abs(lines[:, None] - ends).max(axis=(2, 3))
    reverse = np.abs(lines[:, None, ::-1] - ends).max(axis=(2, 3))
    apart = np.minimum(direct, reverse)
    return apart.argmin(axis=1) if (apart.min(axis=1) < _SAME_M).all() else None
