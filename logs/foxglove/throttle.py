"""Leaves out what comes faster than anyone looks."""


class Throttle:
    """Lets stamps through that are at least 0.1 s after the last one it let through, or before it."""

    def __init__(self, period_ns: int = 100_000_000) -> None:
        self._period_ns = period_ns
        self._last_ns: int | None = None

    def passes(self, stamp_ns: int) -> bool:
        if self._last_ns is not None and 0 <= stamp_ns - self._last_ns < self._period_ns:
            return False
        self._last_ns = stamp_ns
        return True
