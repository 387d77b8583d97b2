"""The time that is played: it runs, stands, jumps, at any speed. Safe to use from several threads."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

_SLOWEST, _FASTEST = 0.01, 1000.0


@dataclass(frozen=True, slots=True)
class Playback:
    """Time at a moment.

    jumps: how often it has jumped so far; whoever plays begins anew when it has. begin_ns: where the last jump led, at
    first the start: time may have gone on since, but nothing from there on is to be left out.
    """

    position_ns: int
    rate: float
    playing: bool
    ended: bool
    jumps: int
    begin_ns: int


class Clock:
    """From start_ns to end_ns, at first standing at at_ns. rate: seconds played a second.

    Nothing moves the time past what `hold` says is not yet shown.
    """

    def __init__(
        self, start_ns: int, end_ns: int, at_ns: int, rate: float, monotonic_s: Callable[[], float] = time.monotonic
    ) -> None:
        self.start_ns, self.end_ns = start_ns, end_ns
        self._monotonic_s = monotonic_s
        self._changed = threading.Condition()
        self._anchor_ns = self._begin_ns = self._within(at_ns)
        self._anchor_s = monotonic_s()
        self._rate = _sane(rate)
        self._playing = self._ended = False
        self._jumps = self._nudges = 0

    @property
    def now(self) -> Playback:
        with self._changed:
            return self._now()

    def set(self, playing: bool, rate: float | None = None, seek_ns: int | None = None) -> Playback:
        """What a person at the controls wants. Playing on at the end begins from the start."""
        with self._changed:
            if seek_ns is None and playing and self._ended:
                seek_ns = self.start_ns
            self._anchor_ns, self._anchor_s = self._position_ns(), self._monotonic_s()
            if seek_ns is not None:
                self._anchor_ns = self._begin_ns = self._within(seek_ns)
                self._jumps += 1
                self._ended = False
            if rate is not None:
                self._rate = _sane(rate)
            self._playing = playing
            self._changed.notify_all()
            return self._now()

    def end(self, jumps: int) -> bool:
        """All is shown; False where time has jumped since."""
        with self._changed:
            if self._jumps == jumps:
                self._anchor_ns, self._playing, self._ended = self.end_ns, False, True
            return self._jumps == jumps

    def hold(self, at_ns: int, jumps: int) -> None:
        """Go on from here: what lies behind could not be shown in time."""
        with self._changed:
            if self._jumps == jumps and at_ns < self._position_ns():
                self._anchor_ns, self._anchor_s = self._within(at_ns), self._monotonic_s()

    def nudge(self) -> None:
        """Let whoever waits look around."""
        with self._changed:
            self._nudges += 1
            self._changed.notify_all()

    def wait(self, until_ns: int, at_most_s: float) -> None:
        """Until then, or until something changes, or for at_most_s."""
        with self._changed:
            left_s = at_most_s
            if self._playing:
                left_s = min(left_s, (until_ns - self._position_ns()) * 1e-9 / self._rate)
            if left_s > 0 and not self._nudges:
                self._changed.wait(left_s)
            self._nudges = 0

    def _now(self) -> Playback:
        position_ns = self._position_ns()
        return Playback(position_ns, self._rate, self._playing, self._ended, self._jumps, self._begin_ns)

    def _position_ns(self) -> int:
        if not self._playing:
            return self._anchor_ns
        return self._within(self._anchor_ns + int((self._monotonic_s() - self._anchor_s) * self._rate * 1e9))

    def _within(self, stamp_ns: int) -> int:
        return min(max(stamp_ns, self.start_ns), self.end_ns)


def _sane(rate: float) -> float:
    """Viewers ask for anything, also for zero."""
    return min(max(rate, _SLOWEST), _FASTEST) if rate > 0 else 1.0
