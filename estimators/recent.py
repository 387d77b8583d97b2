"""The velocities that were held a moment ago: what is late is about those."""

from collections import deque
from typing import NamedTuple

import numpy as np

from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

_LONGEST_NS = 1_000_000_000  # delays are shorter


class _Held(NamedTuple):
    """way: (3,) that all velocities before it made, each times how long it was held in seconds."""

    stamp_ns: int
    velocity: FloatArray
    way: FloatArray

    def way_until(self, stamp_ns: int) -> FloatArray:
        return self.way + self.velocity * ((stamp_ns - self.stamp_ns) * 1e-9)


class Recent:
    """Feed it odometry in the order of stamps; ask it of a stamp that is not before the last one."""

    def __init__(self) -> None:
        self._held: deque[_Held] = deque()

    def hold(self, odometry: Odometry) -> None:
        stamp_ns = odometry.stamp_ns
        way = self._held[-1].way_until(stamp_ns) if self._held else np.zeros(3)
        self._held.append(_Held(stamp_ns, odometry.velocity, way))
        while len(self._held) > 1 and self._held[1].stamp_ns < stamp_ns - _LONGEST_NS:
            self._held.popleft()

    def at(self, now_ns: int, before_s: float) -> FloatArray:
        """(3,) that was held so long before now, a second at most."""
        return self._of(_ago(now_ns, before_s)).velocity if self._held else np.zeros(3)

    def mean(self, now_ns: int, before_s: float) -> FloatArray:
        """(3,) from then to now; the present one if that is no time."""
        if not self._held:
            return np.zeros(3)
        start_ns = max(_ago(now_ns, before_s), self._held[0].stamp_ns)
        if start_ns >= now_ns:
            return self.at(now_ns, 0.0)
        way = self._held[-1].way_until(now_ns) - self._of(start_ns).way_until(start_ns)
        return way / ((now_ns - start_ns) * 1e-9)

    def _of(self, stamp_ns: int) -> _Held:
        """What was held then; the first one before there was any."""
        return next((held for held in reversed(self._held) if held.stamp_ns <= stamp_ns), self._held[0])


def _ago(now_ns: int, before_s: float) -> int:
    return now_ns - min(int(before_s * 1e9), _LONGEST_NS)
