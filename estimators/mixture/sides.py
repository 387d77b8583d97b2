"""The copies of a pose under the map's symmetries, the pose itself first."""

from dataclasses import dataclass

import numpy as np

from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_TURN_M = 1.0  # how far a turn of one radian is, beside metres


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """copies: (c, 3) the identity and the symmetries. after: (c, c) which copy copies[i] after copies[j] is."""

    copies: FloatArray
    after: IntArray

    @staticmethod
    def of(symmetries: FloatArray) -> "Sides":
        copies = np.concatenate([np.zeros((1, 3)), symmetries])
        both = se2.compose(copies[:, None], copies)
        return Sides(copies, np.argmin(distance(both[:, :, None], copies), axis=-1))

    def __len__(self) -> int:
        return len(self.copies)

    def unfold(self, poses: FloatArray) -> FloatArray:
        """(h, c, 3) of poses (h, 3)."""
        if len(self.copies) == 1:
            return poses[:, None]
        return se2.compose(self.copies, poses[:, None])

    def of_copy(self, copy: IntArray, poses: FloatArray) -> FloatArray:
        """(n, 3) that copy (n,) of each of the poses (n, 3)."""
        return se2.compose(self.copies[copy], poses) if copy.any() else poses

    def of_one(self, copy: int, pose: FloatArray) -> FloatArray:
        """(3,) that copy of a pose (3,)."""
        return se2.compose(self.copies[copy], pose) if copy else pose

    def nearest(self, poses: FloatArray, pose: FloatArray) -> IntArray:
        """(...) which copy of the pose (3,) each of poses (..., 3) is nearest to."""
        return np.asarray(np.argmin(distance(poses[..., None, :], se2.compose(self.copies, pose)), axis=-1))


def distance(one: FloatArray, other: FloatArray) -> FloatArray:
    """(...) in metres, turns counted as such."""
    apart = one - other
    turn = 2.0 * _TURN_M * np.sin(0.5 * apart[..., 2])
    return np.asarray(np.sqrt(apart[..., 0] ** 2 + apart[..., 1] ** 2 + turn**2))
