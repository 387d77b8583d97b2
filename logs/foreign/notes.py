"""What could not be used of a log, counted while it is read."""

from collections.abc import Mapping
from dataclasses import dataclass

from logs.schema import seconds

_SECOND_NS = 1_000_000_000
_LAST_NS = 2**63 - 1  # what a record's stamp can be; log times go twice as far
_APART_NS = 10 * _SECOND_NS  # between a measurement and its log; more is another clock


@dataclass(slots=True)
class _LeftOut:
    count: int
    first: str


class Notes:
    """Messages left out by topic, and sentences that are said once however often they come up."""

    def __init__(self) -> None:
        self._left_out: dict[str, _LeftOut] = {}
        self._sentences: dict[str, None] = {}
        self._lags_ns: dict[str, int] = {}

    def begin(self, topic: str) -> None:
        """The topic is read from its beginning: what was counted before counts no more."""
        self._left_out.pop(topic, None)

    def leave_out(self, topic: str, complaint: str) -> None:
        """One message more that could not be used; `complaint` names topic and stamp."""
        found = self._left_out.get(topic)
        if found is None:
            self._left_out[topic] = _LeftOut(1, complaint)
        else:
            found.count += 1

    def say(self, sentence: str) -> None:
        self._sentences[sentence] = None

    def stamp(self, topic: str, stamp_ns: int | None, log_time_ns: int) -> int:
        """When it was measured: what the message says, the log time where it says nothing."""
        log_time_ns = min(log_time_ns, _LAST_NS)
        if stamp_ns is None:
            return log_time_ns
        if 0 < stamp_ns <= _LAST_NS:
            if topic not in self._lags_ns:
                self._lags_ns[topic] = log_time_ns - stamp_ns
            return stamp_ns
        self.say(f"{topic}: messages without a stamp are taken as measured when they were logged")
        return log_time_ns

    def sentences(self, totals: Mapping[str, int]) -> tuple[str, ...]:
        """All of it for people. totals: number of messages by topic."""
        out = [
            f"{skipped.count} of {totals.get(topic, skipped.count)} messages left out, the first: {skipped.first}"
            for topic, skipped in self._left_out.items()
        ]
        return (*out, *self._sentences, *self._clocks())

    def _clocks(self) -> tuple[str, ...]:
        if not self._lags_ns:
            return ()
        lags = sorted((lag, topic) for topic, lag in self._lags_ns.items())
        (least, first), (most, last) = lags[0], lags[-1]
        if most - least <= _APART_NS:
            return ()
        return (
            f"stamps of different clocks: those of {first} are {seconds(least)} before their log time, "
            f"those of {last} {seconds(most)}; what is measured on one clock cannot be put in order with the other",
        )


def complaint(topic: str, stamp_ns: int, problem: str) -> str:
    return f"{topic} at {seconds(stamp_ns)}: {problem}"
