"""Several recordings as one."""

import heapq
from collections.abc import Collection, Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path

from logs.source import Attachment, Container, RawMessage, Source

_LOG_TIME = itemgetter(1)


class Merged:
    """Containers as one: messages in the order of log time over all, at equal times in the order of the containers.

    Channels are numbered anew from 1: the same source in two containers is one channel. A metadata record whose name
    an earlier container has is found as "name (file)". path is that of the first.
    """

    def __init__(self, containers: Sequence[Container]) -> None:
        if not containers:
            raise ValueError("nothing to merge")
        self._containers = tuple(containers)
        self._sources: dict[int, Source] = {}
        self._numbers: list[dict[int, int]] = []  # of each container: its number of a channel -> number here
        known: dict[object, int] = {}
        for container in containers:
            numbers = {}
            for number, source in container.sources.items():
                new = numbers[number] = known.setdefault(_key(source), len(known) + 1)
                self._sources.setdefault(new, source)
            self._numbers.append(numbers)

    @property
    def path(self) -> Path:
        return self._containers[0].path

    @property
    def sources(self) -> Mapping[int, Source]:
        return self._sources

    @property
    def counts(self) -> Mapping[int, int]:
        out: dict[int, int] = {}
        for container, numbers in zip(self._containers, self._numbers, strict=True):
            for number, count in container.counts.items():
                out[numbers[number]] = out.get(numbers[number], 0) + count
        return out

    @property
    def span_ns(self) -> tuple[int, int] | None:
        spans = [span for container in self._containers if (span := container.span_ns)]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        out: dict[str, Mapping[str, str]] = {}
        for container in self._containers:
            for name, record in container.metadata.items():
                names = (name, f"{name} ({container.path.name})", f"{name} ({container.path})")
                out[next((free for free in names if free not in out), names[-1])] = record
        return out

    @property
    def damage(self) -> tuple[str, ...]:
        return tuple(f"{c.path.name}: {sentence}" for c in self._containers for sentence in c.damage)

    def messages(
        self, channels: Collection[int], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        for together in self._overlapping():
            yield from heapq.merge(*[self._renumbered(i, channels, start_ns, end_ns) for i in together], key=_LOG_TIME)

    def attachments(self) -> Iterator[Attachment]:
        for container in self._containers:
            yield from container.attachments()

    def _overlapping(self) -> Iterator[list[int]]:
        """Groups of containers, one after the other in time: the parts of a split recording are opened in turn."""
        spans = sorted((span, i) for i, container in enumerate(self._containers) if (span := container.span_ns))
        group: list[int] = []
        end = -1
        for (first, last), i in spans:
            if group and first > end:
                yield sorted(group)
                group = []
            group.append(i)
            end = max(end, last)
        if group:
            yield sorted(group)

    def _renumbered(
        self, i: int, channels: Collection[int], start_ns: int | None, end_ns: int | None
    ) -> Iterator[RawMessage]:
        numbers = self._numbers[i]
        own = [number for number, new in numbers.items() if new in channels]
        messages = self._containers[i].messages(own, start_ns, end_ns)
        if all(numbers[number] == number for number in own):
            yield from messages
        else:
            for number, log_time_ns, publish_time_ns, sequence, data in messages:
                yield RawMessage(numbers[number], log_time_ns, publish_time_ns, sequence, data)


def _key(source: Source) -> object:
    metadata = frozenset(source.metadata.items())
    schema = (source.schema_name, source.schema_encoding, source.schema_data)
    return source.topic, source.message_encoding, schema, metadata
