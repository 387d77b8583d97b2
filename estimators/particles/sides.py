"""Copies of poses under the map's symmetries, the pose itself among them as copy 0."""

import numpy as np

from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray


class Copies:
    def __init__(self, symmetries: FloatArray) -> None:
        self._moves = np.concatenate([np.zeros((1, 3)), symmetries])

    def __len__(self) -> int:
        return len(self._moves)

    def of(self, poses: FloatArray) -> FloatArray:
        """(..., c, 3) of poses (..., 3)."""
        return se2.compose(self._moves, poses[..., None, :])

    def nearest(self, poses: FloatArray, to: FloatArray) -> IntArray:
        """(n,) which copy of each pose lies next to the pose `to`."""
        beside = se2.between(to, self.of(poses))
        return np.asarray(np.argmin(np.sum(beside[..., :2] ** 2, axis=-1) + beside[..., 2] ** 2, axis=-1))
