"""From the sensor to the log: what comes late, what comes all at once, what never comes."""

import numpy as np
from numpy.typing import NDArray

from logs.simulate.events import draw_intervals_ns
from logs.simulate.settings import DeliverySettings


class Delivery:
    """One for a game: when the robot's computer stalls, and when the logger keeps nothing, is the same for all topics.

    stalls_ns, gaps_ns: (n, 2) begin and end on the log's clock, none overlapping another of its kind.
    """

    def __init__(
        self, settings: DeliverySettings, begin_ns: int, duration_s: float, random: np.random.Generator
    ) -> None:
        s = settings
        self._settings = s
        for_stalls, for_gaps = random.spawn(2)
        stalls = draw_intervals_ns(s.stalls_per_min, s.stall_s, duration_s, for_stalls)
        gaps = draw_intervals_ns(s.gaps_per_min, s.gap_s, duration_s, for_gaps)
        self.stalls_ns, self.gaps_ns = begin_ns + _merged(stalls), begin_ns + _merged(gaps)

    def latencies_ns(self, count: int, random: np.random.Generator) -> NDArray[np.int64]:
        """(count,) how long each message of a topic takes when nothing stalls."""
        s = self._settings
        return np.asarray(1e9 * (s.latency_s + s.jitter_s * random.random(count)), dtype=np.int64)

    def arrivals_ns(self, ready_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """(m,) when messages are logged that could have been at ready_ns (m,): after a stall, and in order."""
        stall = _holding(self.stalls_ns, ready_ns)
        held = stall >= 0
        out = ready_ns.copy()
        out[held] = self.stalls_ns[stall[held], 1]
        return np.maximum.accumulate(out)

    def kept(self, log_times_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(m,) False in the gaps."""
        return _holding(self.gaps_ns, log_times_ns) < 0


def _merged(intervals_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """The same moments as intervals (k, 2) in order that do not touch."""
    out: list[list[int]] = []
    for begin, end in sorted(intervals_ns.tolist()):
        if out and begin <= out[-1][1]:
            out[-1][1] = max(out[-1][1], end)
        else:
            out.append([begin, end])
    return np.array(out, dtype=np.int64).reshape(-1, 2)


def _holding(intervals_ns: NDArray[np.int64], times_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """(m,) the interval that holds each time, begin <= time < end; -1: none."""
    index = np.searchsorted(intervals_ns[:, 0], times_ns, side="right") - 1
    inside = index >= 0
    inside[inside] = times_ns[inside] < intervals_ns[index[inside], 1]
    return np.where(inside, index, -1)
