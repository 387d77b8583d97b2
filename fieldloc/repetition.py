"""The same landmark seen again a moment later: its errors are much the same, so it is little news.

A landmark's apparent size is rounded to the same pixel, a tube stands a centimetre beside its place on the map, from
here as from a step further on. With errors of correlation rho between consecutive sights, n of them know as much as
n (1 - rho) / (1 + rho) independent ones: each gets that share, as a covariance that is so much wider.
"""

import math
from dataclasses import dataclass

import numpy as np

from fieldloc.pose import FloatArray

_MAX_RHO = 0.999  # a burst at one stamp still counts for something


@dataclass(frozen=True, slots=True)
class ErrorCorrelation:
    """Over what time errors stay alike: of a landmark's range, of its bearing, of all that one camera image says, of a
    compass; and over what time landmarks stay hidden.

    0 takes every observation for news. A compass beside steel or motors is wrong for ten seconds or so: those are to
    weigh as two readings, of which the right ones of the next half minute can still make good.
    """

    range_s: float = 3.0
    bearing_s: float = 1.5
    image_s: float = 0.2
    compass_s: float = 5.0
    hidden_s: float = 0.5


class Repetition:
    """Remembers when each thing was last seen. Things are numbers: map indices, or one for all images."""

    def __init__(self) -> None:
        self._last_ns: dict[int, int] = {}

    def see(self, thing: int, stamp_ns: int) -> None:
        """From now on it was last seen at this stamp."""
        self._last_ns[thing] = stamp_ns

    def age_s(self, thing: int, stamp_ns: int) -> float:
        """Seconds since it was last seen, infinity at first."""
        before_ns = self._last_ns.get(thing)
        return math.inf if before_ns is None else max(stamp_ns - before_ns, 0) * 1e-9

    def ages_s(self, count: int, stamp_ns: int) -> FloatArray:
        """(count,) of the things from 0 on."""
        last_ns = map(self._last_ns.get, range(count))
        return np.array([math.inf if one is None else max(stamp_ns - one, 0) * 1e-9 for one in last_ns])


def inflation(age_s: FloatArray, correlation_s: float) -> FloatArray:
    """By how much (...) to widen variances of errors that are alike over a time, seen again after the ages (...)."""
    if correlation_s <= 0.0:
        return np.ones_like(age_s)
    rho = np.minimum(np.exp(-age_s / correlation_s), _MAX_RHO)
    return np.asarray((1.0 + rho) / (1.0 - rho))
