"""How often what is in a scan is not what it seems to be, and where: as the scans of a log themselves show."""

import math
from dataclasses import dataclass

import numpy as np

from fieldloc.pose import FloatArray, wrap

_BEFORE = 20.0  # scans that what is thought before is worth: the fewest that can show one in twenty
_OUTSIDE = 0.01  # of all that was seen is left outside of each border, as a few may be anywhere
_LEAST = 1e-3  # m and rad


@dataclass(frozen=True, slots=True, eq=False)
class Sector:
    """Where a sensor sees things, right or wrong. middle_rad: of all bearings. low, high: (2,) range and bearing from
    the middle. beyond: probability that the next one is outside."""

    middle_rad: float
    low: FloatArray
    high: FloatArray
    beyond: float

    @staticmethod
    def of(range_bearing: FloatArray) -> "Sector":
        """Of all seen so far (n, 2). The next one is farther out than n on one side with probability 1 / (n + 1)."""
        bearing = range_bearing[:, 1]
        middle_rad = float(np.arctan2(np.sin(bearing).mean(), np.cos(bearing).mean()))
        seen = np.stack([range_bearing[:, 0], wrap(bearing - middle_rad)], axis=-1)
        low, high = np.quantile(seen, [_OUTSIDE, 1.0 - _OUTSIDE], axis=0)
        low[0] = 0.0  # what is nearer than all landmarks were is seen too
        return Sector(middle_rad, low, high, min(3.0 * max(_OUTSIDE, 1.0 / (len(seen) + 1)), 1.0))

    def log_density(self, range_bearing: FloatArray, log_anywhere: float) -> FloatArray:
        """(n,) of things that are none of the map's: alike inside, and outside as rare as they are anywhere."""
        seen = range_bearing.copy()
        seen[:, 1] = wrap(seen[:, 1] - self.middle_rad)
        inside = ((seen >= self.low) & (seen <= self.high)).all(axis=1)
        far, wide = (max(width, _LEAST) for width in (self.high - self.low).tolist())
        rare = self.beyond * math.exp(log_anywhere)
        return np.where(inside, math.log(rare + (1.0 - self.beyond) / (far * wide)), math.log(rare))


class WrongShare:
    """Counts the scans in which no landmark was where it should be from where the robot was."""

    def __init__(self) -> None:
        self._wrong = self._all = 0

    def count(self, wrong: bool) -> None:
        self._wrong, self._all = self._wrong + wrong, self._all + 1

    def share(self, before: float) -> float:
        """As counted so far, and never less than thought before: what went well says little of the next one."""
        return max(before, (before * _BEFORE + self._wrong) / (_BEFORE + self._all))
