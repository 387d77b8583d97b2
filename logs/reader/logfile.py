"""A log: an MCAP file whose messages are read as fieldloc's records."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from logs.reader.container import open_container
from logs.schema import (
    BY_KIND,
    BY_NAME,
    BY_ROLE,
    MESSAGE_ENCODING,
    SCHEMA_ENCODING,
    TOPICS,
    BadMessage,
    R,
    Record,
    Schema,
    decode,
)
from logs.source import Source


@dataclass(frozen=True, slots=True)
class Message:
    """A record, where it was logged, and when; the record's own stamp is when it was measured."""

    topic: str
    log_time_ns: int
    record: Record


@dataclass(slots=True)
class _Skipped:
    count: int
    first: str


class LogFile:
    """What an MCAP file holds, and its messages. Nothing is kept open between calls.

    roles: the topic of each role where it is not the usual one (logs.schema.TOPICS).
    Opening raises FieldlocError for what is not an MCAP file at all. A damaged or unfinished one opens with what is
    whole in it; `warnings` says what is not.
    """

    def __init__(self, path: str | Path, roles: Mapping[str, str] | None = None) -> None:
        self.path = Path(path)
        self.roles: Mapping[str, str] = MappingProxyType({**TOPICS, **(roles or {})})
        self.container = open_container(self.path)
        self._skipped: dict[str, _Skipped] = {}

    @property
    def sources(self) -> tuple[tuple[Source, int], ...]:
        """Every channel, known to fieldloc or not, with its number of messages, by topic."""
        counts = self.container.counts
        pairs = [(source, counts.get(number, 0)) for number, source in self.container.sources.items()]
        return tuple(sorted(pairs, key=lambda pair: (pair[0].topic, pair[0].schema_name)))

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name; what fieldloc writes about a log is in "fieldloc"."""
        return self.container.metadata

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Log time of the first and the last message on any topic."""
        return self.container.span_ns

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the file, and with the messages met so far."""
        out = [f"{self.path}: {sentence}" for sentence in self.container.damage]
        for topic, skipped in self._skipped.items():
            total = sum(count for source, count in self.sources if source.topic == topic)
            out.append(f"{self.path}: {skipped.count} of {total} messages left out, the first: {skipped.first}")
        return tuple(out)

    def role(self, source: Source) -> str | None:
        """What the channel's messages are to fieldloc: a key of logs.schema.TOPICS, or None."""
        role = next((role for role, topic in self.roles.items() if topic == source.topic), None)
        return role if role is not None and _schema(source) is BY_ROLE[role] else None

    def problem(self, source: Source) -> str | None:
        """Why a topic that has a role cannot play it, or None."""
        role = next((role for role, topic in self.roles.items() if topic == source.topic), None)
        if role is None or _schema(source) is BY_ROLE[role]:
            return None
        if source.message_encoding == MESSAGE_ENCODING and source.schema_name.startswith("fieldloc."):
            name, _, version = source.schema_name.rpartition(".")
            if BY_ROLE[role].name.startswith(f"{name}.") and version != BY_ROLE[role].name.rpartition(".")[2]:
                known = BY_ROLE[role].name
                return f"topic {source.topic} carries {source.schema_name}, known is {known}: update fieldloc"
        carried = f"{source.schema_name or 'no schema'} ({source.message_encoding or 'no encoding'})"
        return f"topic {source.topic} carries {carried}, needs {BY_ROLE[role].name} ({MESSAGE_ENCODING})"

    def has(self, kind: type[R]) -> bool:
        """Whether there are messages on the topic of this kind of record."""
        topic = self.roles[BY_KIND[kind].role]
        return any(source.topic == topic and count > 0 for source, count in self.sources)

    def records(self, kind: type[R]) -> Iterator[R]:
        """What is on the topic of this kind of record, in the order of log time; nothing if there is no such topic."""
        if not self.has(kind):
            return iter(())
        messages = self.messages([self.roles[BY_KIND[kind].role]])
        return (message.record for message in messages if isinstance(message.record, kind))

    def field_map(self) -> FieldMap | None:
        """The map that the log was recorded on, where the log says so."""
        return next(self.records(FieldMap), None)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Messages on these topics, or on all that fieldloc understands, in the order of log time.

        A message that its schema does not allow is left out and counted in `warnings`. Raises FieldlocError, before
        the first message, if a topic carries something else than its role needs, or if there is nothing to read.
        """
        wanted: dict[int, tuple[str, Schema]] = {}
        for number, source in self.container.sources.items():
            if topics is not None and source.topic not in topics:
                continue
            if problem := self.problem(source):
                raise FieldlocError(f"{self.path}: {problem}")
            if schema := _schema(source):
                wanted[number] = (source.topic, schema)
        if not any(self.container.counts.get(number) for number in wanted):
            raise FieldlocError(f"{self.path}: {self._nothing(topics)}")
        return self._decoded(wanted)

    def log_times(self) -> Iterator[tuple[Source, int]]:
        """Log time of every message on every channel, decoded by nobody, in the order of log time."""
        sources = self.container.sources
        for raw in self.container.messages(sources.keys()):
            yield sources[raw.channel], raw.log_time_ns

    def _decoded(self, wanted: Mapping[int, tuple[str, Schema]]) -> Iterator[Message]:
        for topic, _ in wanted.values():
            self._skipped.pop(topic, None)
        for raw in self.container.messages(wanted.keys()):
            topic, schema = wanted[raw.channel]
            try:
                record = decode(schema, topic, raw.data)
            except BadMessage as error:
                self._skipped.setdefault(topic, _Skipped(0, str(error))).count += 1
                continue
            yield Message(topic, raw.log_time_ns, record)

    def _nothing(self, topics: Collection[str] | None) -> str:
        if not sum(self.container.counts.values()):
            return "; ".join(["holds no messages", *self.container.damage])
        held = ", ".join(f"{s.topic} ({s.schema_name or s.message_encoding})" for s, count in self.sources if count)
        wanted = "no topic that fieldloc understands" if topics is None else f"no messages on {', '.join(topics)}"
        return f"{wanted}; it holds {held}"


def read_log(
    path: str | Path, topics: Collection[str] | None = None, roles: Mapping[str, str] | None = None
) -> Iterator[Message]:
    """The messages of a log; `LogFile` says more about it, warnings too."""
    return LogFile(path, roles).messages(topics)


def _schema(source: Source) -> Schema | None:
    if (source.message_encoding, source.schema_encoding) != (MESSAGE_ENCODING, SCHEMA_ENCODING):
        return None
    return BY_NAME.get(source.schema_name)
