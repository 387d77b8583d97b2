"""A log: an MCAP file whose messages are read as fieldloc's records."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import IO

from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from logs.reader.index import Index, Source, index
from logs.reader.order import in_time_order
from logs.reader.records import MAGIC
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
        with _open(self.path) as file:
            self._index: Index = index(file, self.path.stat().st_size)
        self._skipped: dict[str, _Skipped] = {}
        self._missing: dict[str, int] = {}

    @property
    def sources(self) -> tuple[tuple[Source, int], ...]:
        """Every channel, known to fieldloc or not, with its number of messages, by topic."""
        counts = self._index.counts
        pairs = [(source, counts.get(number, 0)) for number, source in self._index.sources.items()]
        return tuple(sorted(pairs, key=lambda pair: (pair[0].topic, pair[0].schema_name)))

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name; what fieldloc writes about a log is in "fieldloc"."""
        return self._index.metadata

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Log time of the first and the last message on any topic."""
        blocks = self._index.blocks
        return (min(b.first_ns for b in blocks), max(b.last_ns for b in blocks)) if blocks else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the file, and with the messages met so far."""
        out = [f"{self.path}: {sentence}" for sentence in self._index.damage]
        out += [f"{self.path}: {topic}: {n} messages are in damaged records" for topic, n in self._missing.items()]
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
        for number, source in self._index.sources.items():
            if topics is not None and source.topic not in topics:
                continue
            if problem := self.problem(source):
                raise FieldlocError(f"{self.path}: {problem}")
            if schema := _schema(source):
                wanted[number] = (source.topic, schema)
        if not any(self._index.counts.get(number) for number in wanted):
            raise FieldlocError(f"{self.path}: {self._nothing(topics)}")
        return self._decoded(wanted)

    def log_times(self) -> Iterator[tuple[Source, int]]:
        """Log time of every message on every channel, decoded by nobody, in the order of log time."""
        sources = self._index.sources
        with _open(self.path) as file:
            for raw in in_time_order(file, self._index.blocks, sources.keys()):
                yield sources[raw.channel_id], raw.log_time

    def _decoded(self, wanted: Mapping[int, tuple[str, Schema]]) -> Iterator[Message]:
        for topic, _ in wanted.values():
            self._skipped.pop(topic, None)
            self._missing.pop(topic, None)
        left = {number: self._index.counts.get(number, 0) for number in wanted}
        with _open(self.path) as file:
            for raw in in_time_order(file, self._index.blocks, wanted.keys()):
                left[raw.channel_id] -= 1
                topic, schema = wanted[raw.channel_id]
                try:
                    record = decode(schema, topic, raw.data)
                except BadMessage as error:
                    self._skipped.setdefault(topic, _Skipped(0, str(error))).count += 1
                    continue
                yield Message(topic, raw.log_time, record)
        for number, missing in left.items():
            if missing > 0:
                topic = wanted[number][0]
                self._missing[topic] = self._missing.get(topic, 0) + missing

    def _nothing(self, topics: Collection[str] | None) -> str:
        if not self._index.message_count:
            return "; ".join(["holds no messages", *self._index.damage])
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


def _open(path: Path) -> IO[bytes]:
    """An MCAP file, opened; FieldlocError if it is none."""
    if path.is_dir():
        raise FieldlocError(f"{path}: is a directory; give an MCAP file")
    try:
        file = path.open("rb")
    except FileNotFoundError:
        raise FieldlocError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        raise FieldlocError(f"{path}: cannot be opened: {error}") from None
    try:
        if not file.seekable():
            raise OSError("a pipe, save it to a file first")
        magic = file.read(len(MAGIC))
    except OSError as error:
        file.close()
        raise FieldlocError(f"{path}: cannot be read: {error}") from None
    if magic == MAGIC:
        return file
    file.close()
    if not magic:
        raise FieldlocError(f"{path}: empty; give an MCAP file")
    if MAGIC.startswith(magic):
        raise FieldlocError(f"{path}: cut off within its first {len(MAGIC)} bytes")
    raise FieldlocError(f"{path}: not an MCAP file: it does not begin with MCAP's magic number")
