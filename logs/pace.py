"""How often something came, of any number of stamps, in little memory."""

from array import array

import numpy as np
from numpy.typing import NDArray

_HELD = 1 << 16


class Pace:
    """Stamps in about their order, one by one. Exact unless one comes after 32,768 others that are later than it."""

    __slots__ = ("_count", "_first", "_gap", "_held", "_last")

    def __init__(self) -> None:
        self._count = 0
        self._held = array("Q")
        self._first: int | None = None
        self._last: int | None = None  # of those no longer held
        self._gap = 0

    def add(self, stamp_ns: int) -> None:
        """stamp_ns: from 0 to 2^64 - 1, as MCAP has them."""
        self._count += 1
        self._held.append(stamp_ns)
        if len(self._held) == _HELD:
            ordered = np.sort(np.frombuffer(self._held, dtype=np.uint64))
            self._let_go(ordered[: _HELD // 2])
            self._held = array("Q", ordered[_HELD // 2 :].tobytes())

    def measured(self) -> tuple[int, int, float | None, float | None] | None:
        """First and last stamp, messages a second, longest gap in seconds; the latter None of too few, all of none."""
        if self._held:
            self._let_go(np.sort(np.frombuffer(self._held, dtype=np.uint64)))
            self._held = array("Q")
        if self._first is None or self._last is None:
            return None
        rate_hz = (self._count - 1) * 1e9 / (self._last - self._first) if self._last > self._first else None
        return self._first, self._last, rate_hz, self._gap * 1e-9 if self._count > 1 else None

    def _let_go(self, ordered: NDArray[np.uint64]) -> None:
        first, last = int(ordered[0]), int(ordered[-1])
        gaps = [int(np.diff(ordered).max())] if len(ordered) > 1 else []
        if self._last is not None:
            gaps.append(first - self._last)
        self._gap = max([self._gap, *gaps])
        self._first = first if self._first is None else min(self._first, first)
        self._last = last if self._last is None else max(self._last, last)
