"""Notices that an estimate is wrong or the robot was carried: whole poses that agree with each other, not with it."""

import numpy as np

from estimators.motion import Increment
from fieldloc import pose as se2
from fieldloc.factors import Factor, PoseFactor
from fieldloc.pose import FloatArray

_AGREE_NIS = 16.0  # chi-square, 3 degrees of freedom: exceeded once in a thousand by chance


class Restart:
    """Feed it every motion and every factor; it hands back the pose to restart from when one is due."""

    def __init__(self, after: int) -> None:
        self._after = after
        self._elsewhere: PoseFactor | None = None
        self._count = 0
        self.since_ns = 0
        """The stamp of the first of the poses that last disagreed alike."""

    def forget(self) -> None:
        """Begin anew, as after a start."""
        self._elsewhere, self._count = None, 0

    def advance(self, motion: Increment) -> None:
        """Carry the pose that disagreed along with the robot."""
        if (other := self._elsewhere) is not None:
            self._elsewhere = PoseFactor(
                other.stamp_ns,
                se2.compose(other.pose, motion.before_from_after),
                Increment.carry(other.covariance, motion.before_from_after) + motion.covariance,
            )

    def consider(self, factor: Factor, disagrees: bool) -> PoseFactor | None:
        """The factor's pose if it is the last of enough in a row that disagree with the estimate alike, else None."""
        if not isinstance(factor, PoseFactor):
            return None
        if not disagrees:
            self.forget()
            return None
        alike = self._elsewhere is not None and _agree(self._elsewhere, factor)
        if not alike:
            self._count, self.since_ns = 0, factor.stamp_ns
        self._count += 1
        self._elsewhere = factor
        if self._count < self._after:
            return None
        self.forget()
        return factor


def _agree(one: PoseFactor, other: PoseFactor) -> bool:
    residual: FloatArray = other.error(one.pose)
    return bool(residual @ np.linalg.solve(one.covariance + other.covariance, residual) < _AGREE_NIS)
