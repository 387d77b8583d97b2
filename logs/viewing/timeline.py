"""Events in the order of time, each made once, when someone first wants to see it, and then kept."""

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from estimators.base import Ambiguity, Estimate
from estimators.base import Event as Happened
from fieldloc.measurements import ImageFeatures, LandmarkScan, Truth
from fieldloc.pose import FloatArray

Shown = Estimate | Truth | LandmarkScan | ImageFeatures | Ambiguity | Happened

_NEWS_NS = 1_000_000_000  # what is older tells nothing of now


class Event(NamedTuple):
    """Something to show. field_from_robot: (3,) where the robot is thought to be, None: nobody knows.

    odom_from_robot: (3,) where the odometry alone says an estimate is.
    """

    log_time_ns: int
    record: Shown
    field_from_robot: FloatArray | None
    odom_from_robot: FloatArray | None = None


class Timeline:
    """events: in the order of log time. An estimator that makes them runs no further than someone looks."""

    def __init__(self, events: Iterable[Event]) -> None:
        self._coming = iter(events)
        self._past: list[Event] = []

    def after(self, start_ns: int) -> Iterator[Event]:
        """From a time on; what was made before is not made again."""
        index = self._index(start_ns)
        while index < len(self._past) or self._pull():
            yield self._past[index]
            index += 1

    def before(self, time_ns: int, kinds: Iterable[type[Shown]]) -> Iterator[Event]:
        """The last of each kind in the second before a time."""
        missing = set(kinds)
        for event in reversed(self._past[: self._index(time_ns)]):
            if not missing or event.log_time_ns < time_ns - _NEWS_NS:
                return
            if type(event.record) in missing:
                missing.remove(type(event.record))
                yield event

    def _index(self, time_ns: int) -> int:
        """Of the first event that is not before; all before it have been made then."""
        while (not self._past or self._past[-1].log_time_ns < time_ns) and self._pull():
            pass
        return bisect_left(self._past, time_ns, key=lambda event: event.log_time_ns)

    def _pull(self) -> bool:
        event = next(self._coming, None)
        if event is not None:
            self._past.append(event)
        return event is not None
