"""The map as arrays, the way a camera meets it: straight lines joined, along which of the two directions each runs."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fieldloc.field import FieldMap
from fieldloc.fixes.line_map import line_grid
from fieldloc.pose import FloatArray
from fieldloc.regions import anywhere
from fieldloc.symmetry import merge_segments

_ALONG = np.cos(np.radians(0.2))


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """starts, directions: (m, 2) of the lines, unit directions; lengths: (m,). starts_along: (m,) the starts'
    coordinate along the directions. families: (m,) 0 for lines along the
    grid's x, 1 along its y, -1 askew; offsets: (m,) the other coordinate in grid axes. grid_rad: the grid's heading.
    posts: (q, 2), radii: (q,), heights: (q,), square: whether their section is. partners: (q,) the post that a crossbar
    joins it to, itself where none does. circles: (c, 3). marks: (n, 2). box: (4,) where a robot can be.
    """

    starts: FloatArray
    directions: FloatArray
    lengths: FloatArray
    starts_along: FloatArray
    families: NDArray[np.intp]
    offsets: FloatArray
    grid_rad: float
    line_width_m: float
    posts: FloatArray
    radii: FloatArray
    heights: FloatArray
    partners: NDArray[np.intp]
    square: bool
    circles: FloatArray
    marks: FloatArray
    symmetries: FloatArray
    box: FloatArray

    @property
    def area_m2(self) -> float:
        return float(np.prod(self.box[2:] - self.box[:2]))


@lru_cache(maxsize=16)
def shape_of(field: FieldMap) -> Shape:
    lines = merge_segments(field.lines)
    along = lines[:, 1] - lines[:, 0]
    lengths = np.hypot(along[:, 0], along[:, 1])
    directions = along / np.maximum(lengths, 1e-12)[:, None]
    grid_rad = line_grid(field).heading_rad
    x_axis = np.array([np.cos(grid_rad), np.sin(grid_rad)])
    y_axis = np.array([-x_axis[1], x_axis[0]])
    by_axis = np.abs(np.stack([directions @ x_axis, directions @ y_axis], axis=-1))
    families = np.where(by_axis[:, 0] > _ALONG, 0, np.where(by_axis[:, 1] > _ALONG, 1, -1)).astype(np.intp)
    middle = lines.mean(axis=1)
    offsets = np.where(families == 0, middle @ y_axis, middle @ x_axis)
    partners = np.arange(len(field.landmarks))
    for ends in field.crossbars:
        a, b = (field.index_of(label) for label in ends)
        if a is not None and b is not None:
            partners[a], partners[b] = b, a
    return Shape(
        lines[:, 0],
        directions,
        lengths,
        np.sum(lines[:, 0] * directions, axis=1),
        families,
        offsets,
        grid_rad,
        field.line_width_m,
        field.positions,
        np.array([0.5 * mark.diameter_m for mark in field.landmarks]),
        np.array([mark.height_m for mark in field.landmarks]),
        partners,
        field.post_section == "square",
        field.circles,
        field.marks,
        field.symmetries,
        anywhere(field).boxes[0],
    )
