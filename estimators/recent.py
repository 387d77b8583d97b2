"""The velocities that were held a moment ago: what is late is about those."""

from collections import deque

import numpy as np

from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

_LONGEST_NS = 1_000_000_000  # delays are shorter


class Recent:
    """Feed it odometry in the order of stamps; ask it of a stamp that is not before the last one."""

    def __init__(self) -> None:
        self._held: deque[Odometry] = deque()

    def hold(self, odometry: Odometry) -> None:
        self._held.append(odometry)
        while len(self._held) > 1 and self._held[1].stamp_ns < odometry.stamp_ns - _LONGEST_NS:
            self._held.popleft()

    def at(self, now_ns: int, before_s: float) -> FloatArray:
        """(3,) that was held so long before now, a second at most."""
        then_ns = _ago(now_ns, before_s)
        for odometry in reversed(self._held):
            if odometry.stamp_ns <= then_ns:
                return odometry.velocity
        return self._held[0].velocity if self._held else np.zeros(3)

    def mean(self, now_ns: int, before_s: float) -> FloatArray:
        """(3,) from then to now; the present one if that is no time."""
        start_ns, end_ns, way = _ago(now_ns, before_s), now_ns, np.zeros(3)
        for odometry in reversed(self._held):
            since_ns = max(odometry.stamp_ns, start_ns)
            if since_ns < end_ns:
                way, end_ns = way + odometry.velocity * (end_ns - since_ns), since_ns
            if odometry.stamp_ns <= start_ns:
                break
        return way / (now_ns - end_ns) if end_ns < now_ns else self.at(now_ns, 0.0)


def _ago(now_ns: int, before_s: float) -> int:
    return now_ns - min(int(before_s * 1e9), _LONGEST_NS)
