"""What is wrong with a file, and how it is said: short, once, for people."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from logs.schema import seconds

_HOUR_NS = 3600 * 10**9


@dataclass(frozen=True, slots=True)
class Lost:
    """A chunk that cannot be read. messages, span_ns: how many and when, where the file still tells."""

    why: str
    messages: int | None
    span_ns: tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class Cut:
    """A file without its end.

    indexed: all messages are there, only what comes after them is not.
    chunk_ns: when a chunk that is cut itself begins and ends, by its own word. unchecked: messages read from it.
    """

    indexed: bool = False
    chunk_ns: tuple[int, int] | None = None
    unchecked: int = 0


@dataclass(slots=True)
class Losses:
    """All of it. chunks: by where they begin, so that nothing counts twice; one can turn out bad when it is read."""

    chunks: dict[int, Lost] = field(default_factory=dict)
    records: set[int] = field(default_factory=set)
    attachments: set[int] = field(default_factory=set)
    homeless: int = 0
    contradicted: int = 0
    miscounted: int = 0
    late: set[int] = field(default_factory=set)
    index: bool = False
    cut: Cut | None = None

    def sentences(self, span_ns: tuple[int, int] | None, messages: int) -> tuple[str, ...]:
        """span_ns, messages: of what can be read."""
        return tuple(self._sentences(span_ns, messages))

    def _sentences(self, span_ns: tuple[int, int] | None, messages: int) -> Iterator[str]:
        if self.chunks:
            yield self._chunks(span_ns)
        if self.records:
            yield f"{times(len(self.records), 'damaged record')} left out"
        if self.attachments:
            yield f"{times(len(self.attachments), 'damaged attachment')} left out"
        if self.homeless:
            yield f"{times(self.homeless, 'message')} left out: no channel that can be read is theirs"
        if self.contradicted:
            yield f"{times(self.contradicted, 'channel')} defined in two ways: the first holds"
        if self.miscounted:
            yield f"{times(self.miscounted, 'message')} fewer than the file's own count"
        if self.late:
            yield f"{times(len(self.late), 'chunk')} with messages earlier than the index says: they may come late"
        if self.index and not self.cut:
            yield "the index at the end is damaged"
        if self.cut:
            yield _cut(self.cut, span_ns, messages)

    def _chunks(self, span_ns: tuple[int, int] | None) -> str:
        lost = [self.chunks[place] for place in sorted(self.chunks)]
        spans = [_plausible(chunk.span_ns, span_ns) for chunk in lost]
        known = sorted(span for span in spans if span is not None)
        what = f"{times(len(lost), 'damaged chunk')} left out ({lost[0].why})"
        if not known:
            when = "at what time is not known"
        else:
            at_least = "" if len(known) == len(lost) else "at least "
            when = f"{at_least}{seconds(_covered(known))} missing, from {seconds(known[0][0])} on"
        counts = [chunk.messages for chunk in lost if chunk.messages is not None]
        if not counts:
            return f"{what}: {when}, how many messages is not known"
        return f"{what}: {when}, {'' if len(counts) == len(lost) else 'at least '}{times(sum(counts), 'message')}"


def _plausible(span_ns: tuple[int, int] | None, read_ns: tuple[int, int] | None) -> tuple[int, int] | None:
    """What a damaged chunk claims, if it is near what could be read; else None."""
    if span_ns is None or span_ns[0] > span_ns[1]:
        return None
    if read_ns is None:
        return span_ns if span_ns[1] - span_ns[0] <= _HOUR_NS else None
    margin = max(read_ns[1] - read_ns[0], _HOUR_NS)
    return span_ns if read_ns[0] - margin <= span_ns[0] and span_ns[1] <= read_ns[1] + margin else None


def _covered(spans: list[tuple[int, int]]) -> int:
    """Length of the union of sorted spans."""
    total, end = 0, spans[0][0]
    for first, last in spans:
        total += max(0, last - max(first, end))
        end = max(end, last)
    return total


def _cut(cut: Cut, span_ns: tuple[int, int] | None, messages: int) -> str:
    if cut.indexed:
        return f"the index at the end is cut off; all {times(messages, 'message')} are there"
    what = "cut off (or still being written)"
    if span_ns is None:
        missing = _plausible(cut.chunk_ns, None)
        what = f"{what} before its first whole message"
    else:
        missing = _plausible(cut.chunk_ns and (span_ns[1], cut.chunk_ns[1]), span_ns)
        unchecked = f" (the last {cut.unchecked} could not be checked)" if cut.unchecked else ""
        what = f"{what}: {times(messages, 'message')} read, up to {seconds(span_ns[1])}{unchecked}"
    if missing is None or missing[0] == missing[1]:
        return f"{what}; how much is missing is not known"
    return f"{what}; {seconds(missing[1] - missing[0])} of its last chunk are missing, and all that came after"


def times(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"
