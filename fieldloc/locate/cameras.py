"""Cameras at k states, and what of their looks at things does not depend on what the things are.

How far something seen is off what should be seen, and how that changes, are rows (..., 8) in `line_errors`,
`post_errors` and `circle_errors`: the change with the six numbers of `states`, with a focal length that is longer by a
share (all that is seen should then be so much farther out), and the error itself, in pixels. Jacobians are those at
no error: what the lens and the rays' own turning add is of second order.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fieldloc.locate.shape import Shape
from fieldloc.locate.sight import Sight
from fieldloc.locate.states import centres, rotations, turn_axes
from fieldloc.pose import FloatArray

IntArray = NDArray[np.intp]
TINY = 1e-9
FAR_PX = 1e4  # what is off by more has no meaning as a number of pixels
COLUMNS, FOCAL, ERROR = 8, 6, 7  # of rows


@dataclass(frozen=True, eq=False)
class Cameras:
    """k states with what follows from them: field_from_camera (k, 3, 3), axes (k, 3, 3), centres (k, 3)."""

    states: FloatArray
    sight: Sight
    shape: Shape
    rotation: FloatArray
    axes: FloatArray
    centre: FloatArray

    @staticmethod
    def at(states: FloatArray, sight: Sight, shape: Shape) -> "Cameras":
        rotation = rotations(states)
        return Cameras(states, sight, shape, rotation, turn_axes(states, rotation), centres(states))

    def turned(self, vectors: FloatArray) -> FloatArray:
        """Vectors of the camera (n, ..., 3) in the field: (k, n, ..., 3)."""
        flat = vectors.reshape(-1, 3) @ self.rotation.transpose(0, 2, 1)
        return flat.reshape(len(self.states), *vectors.shape)

    @cached_property
    def line_ends(self) -> FloatArray:
        """(k, l, 2, 2, 3) `Sight.line_both` in the field: rays, and their change with a pixel across."""
        return self.turned(self.sight.line_both)

    def put(self, rows: FloatArray, by_centre: FloatArray, by_turn: FloatArray) -> None:
        """In rows (k, ..., 8): the change with the centre (k, ..., 3), with a turn about an axis a as a . by_turn."""
        rows[..., :2], rows[..., 3] = by_centre[..., :2], by_centre[..., 2]
        turns = (by_turn.reshape(len(self.states), -1, 3) @ self.axes.transpose(0, 2, 1)).reshape(by_turn.shape)
        rows[..., 2], rows[..., 4:6] = turns[..., 0], turns[..., 1:]


def clipped(error_px: FloatArray) -> FloatArray:
    return np.minimum(np.maximum(error_px, -FAR_PX), FAR_PX)


def not_zero(value: FloatArray) -> FloatArray:
    return np.where(np.abs(value) < TINY, TINY, value)
