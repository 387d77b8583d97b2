"""When images cease to come that always came: the robot may have fallen, or somebody has taken it."""

from collections import deque

import numpy as np

_RECENT = 100  # images
_ENOUGH = 30  # of them, to know how regularly they come
_LONGER = 5.0  # times as long as the longest of the recent waits for one
_LEAST_S = 1.0

FALLEN = np.diag([0.3, 0.3, 0.5]) ** 2
"""Covariance (3, 3), robot frame, of where a robot is that fell and got up: its own length away, and turned."""


class Silence:
    """By the stamps of all images, whatever is seen in them."""

    def __init__(self) -> None:
        self._waits_ns: deque[int] = deque(maxlen=_RECENT)
        self._last_ns: int | None = None
        self._until_ns: int | None = None  # from then on it is one

    def end(self, stamp_ns: int) -> None:
        """With an image."""
        if self._last_ns is not None and stamp_ns > self._last_ns:
            self._waits_ns.append(stamp_ns - self._last_ns)
        self._last_ns = stamp_ns
        if len(self._waits_ns) >= _ENOUGH:
            self._until_ns = stamp_ns + int(max(_LONGER * max(self._waits_ns), _LEAST_S * 1e9))

    def lasts(self, stamp_ns: int) -> bool:
        return self._until_ns is not None and stamp_ns >= self._until_ns
