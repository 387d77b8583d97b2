"""What is played to a viewer, and what holds from an earlier time on, so that late comers need it too."""

import heapq
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Protocol

from logs.source import Container, Encoded, Source, is_latched

_FEW = 20  # a topic with no more messages than this holds what it last said
_MANY = 1000  # messages: who says so much does not need to be repeated
_ADDING_UP = ("tf_static",)  # each message adds to those before it


class Programme(Protocol):
    """sources: everything that is ever sent. span_ns: log time of the first and the last message."""

    @property
    def sources(self) -> Sequence[Source]: ...
    @property
    def span_ns(self) -> tuple[int, int]: ...

    def messages(self, start_ns: int) -> Iterator[Encoded]:
        """From a time on, in the order of log time."""

    def standing(self, at_ns: int) -> Iterator[Encoded]:
        """What was said before a time and still holds then."""


class RawProgramme:
    """Channels of a log as they are. channels: which of them, all if not told."""

    def __init__(self, container: Container, channels: Collection[int] | None = None) -> None:
        self._container = container
        numbers = container.sources.keys() if channels is None else channels
        self._sources = {number: container.sources[number] for number in numbers}
        self._lasting = lasting_channels(self._sources, container.counts)
        self._said: list[Encoded] | None = None

    @property
    def sources(self) -> Sequence[Source]:
        return list(self._sources.values())

    @property
    def span_ns(self) -> tuple[int, int]:
        return self._container.span_ns or (0, 0)

    def messages(self, start_ns: int) -> Iterator[Encoded]:
        for message in self._container.messages(self._sources.keys(), start_ns):
            yield Encoded(self._sources[message.channel], message.log_time_ns, message.data)

    def standing(self, at_ns: int) -> Iterator[Encoded]:
        if self._said is None:
            self._said = [
                Encoded(self._sources[message.channel], message.log_time_ns, message.data)
                for message in self._container.messages(self._lasting)
            ]
        by_topic: dict[str, list[Encoded]] = {}
        for message in self._said:
            if message.log_time_ns < at_ns:
                by_topic.setdefault(message.source.topic, []).append(message)
        for topic, messages in by_topic.items():
            yield from messages if topic.endswith(_ADDING_UP) else messages[-1:]


class Together:
    """Several programmes at once."""

    def __init__(self, programmes: Sequence[Programme]) -> None:
        self._programmes = programmes

    @property
    def sources(self) -> Sequence[Source]:
        return [source for programme in self._programmes for source in programme.sources]

    @property
    def span_ns(self) -> tuple[int, int]:
        spans = [programme.span_ns for programme in self._programmes if programme.sources]
        return (min(s[0] for s in spans), max(s[1] for s in spans)) if spans else (0, 0)

    def messages(self, start_ns: int) -> Iterator[Encoded]:
        streams = [programme.messages(start_ns) for programme in self._programmes]
        return heapq.merge(*streams, key=lambda message: message.log_time_ns)

    def standing(self, at_ns: int) -> Iterator[Encoded]:
        for programme in self._programmes:
            yield from programme.standing(at_ns)


class Without:
    """A programme but for topics that someone else serves."""

    def __init__(self, programme: Programme, topics: Collection[str]) -> None:
        self._programme, self._topics = programme, frozenset(topics)

    @property
    def sources(self) -> Sequence[Source]:
        return [source for source in self._programme.sources if source.topic not in self._topics]

    @property
    def span_ns(self) -> tuple[int, int]:
        return self._programme.span_ns

    def messages(self, start_ns: int) -> Iterator[Encoded]:
        return (one for one in self._programme.messages(start_ns) if one.source.topic not in self._topics)

    def standing(self, at_ns: int) -> Iterator[Encoded]:
        return (one for one in self._programme.standing(at_ns) if one.source.topic not in self._topics)


def lasting_channels(sources: Mapping[int, Source], counts: Mapping[int, int]) -> list[int]:
    """Which channels say what holds until they say something else: maps, cameras, static transforms."""
    return [
        number for number, source in sources.items() if counts.get(number, 0) <= (_MANY if _says_so(source) else _FEW)
    ]


def _says_so(source: Source) -> bool:
    return source.topic.endswith(_ADDING_UP) or is_latched(source)
