"""A log: any recording, fieldloc's own or someone else's, whose messages are read as fieldloc's records."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, get_args

from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import CameraMount, Measurement
from logs.foreign.interpreter import Interpreter, Span, Translation
from logs.foreign.notes import Notes, complaint
from logs.foreign.parts import ImagePart, VideoPart
from logs.foreign.roles import PLAYERS
from logs.foreign.settings import LogMapping
from logs.foreign.surroundings import Unusable
from logs.foreign.wires import known_type, own_schema
from logs.reader.container import open_container
from logs.reader.merged import Merged
from logs.reader.windows import in_windows
from logs.schema import BY_KIND, BY_ROLE, MESSAGE_ENCODING, TOPICS, BadMessage, R, Record, Schema
from logs.source import Container, Source

_GOOD = {*BY_KIND}
_LATCHED = (FieldMap, Camera)  # in force from their log time on, so also before the part of the log that is read


class Message(NamedTuple):
    """A record, where it was logged, and when; the record's own stamp is when it was measured.

    A record that took several messages of someone else's robot is logged when the last of them was.
    """

    topic: str
    log_time_ns: int
    record: Record


_as_message: Callable[[Iterable[object]], Message] = partial(tuple.__new__, Message)  # at a third of the price


class LogFile:
    """What a recording holds, and its messages. Nothing is kept open between calls, and little of it in memory.

    path: one file (or folder of a ROS 2 bag), or several that are read as one. mapping: what the log does not say, or
    only the topic of each role that is not played by what would be guessed (logs.foreign.roles). start_s, end_s: the
    part of the log that is read, by log time since its first message; the map and the camera hold from before.
    Opening raises FieldlocError for what is no recording at all. A damaged or unfinished one opens with what is whole
    in it; `warnings` says what is not.
    """

    def __init__(
        self,
        path: str | Path | Sequence[str | Path],
        mapping: LogMapping | Mapping[str, str] | None = None,
        start_s: float | None = None,
        end_s: float | None = None,
    ) -> None:
        paths = [path] if isinstance(path, (str, Path)) else list(path)
        containers = [open_container(Path(one)) for one in paths]
        self.container: Container = containers[0] if len(containers) == 1 else Merged(containers)
        self.path = self.container.path
        self._sources: Mapping[int, Source] = dict(self.container.sources)
        self.mapping = mapping if isinstance(mapping, LogMapping) else _with_topics(mapping or {})
        self._notes = Notes()
        self._span = self._part(start_s, end_s)
        self._check_topics()
        self._interpreter = Interpreter(self.container, self.mapping, self._notes, self._span)

    @property
    def roles(self) -> Mapping[str, str]:
        """The topic of each role of logs.schema.TOPICS, the usual one where nothing plays it; several with commas."""
        played = {**self._interpreter.roles.topics, **self.mapping.roles}
        return MappingProxyType({role: ", ".join(played.get(role, ())) or usual for role, usual in TOPICS.items()})

    @property
    def sources(self) -> tuple[tuple[Source, int], ...]:
        """Every channel, known to fieldloc or not, with its number of messages in the whole log, by topic."""
        counts = self.container.counts
        pairs = [(source, counts.get(number, 0)) for number, source in self._sources.items()]
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
        totals: dict[str, int] = {}
        for source, count in self.sources:
            totals[source.topic] = totals.get(source.topic, 0) + count
        sentences = (*self.container.damage, *self._notes.sentences(totals))
        return tuple(f"{self.path}: {sentence}" for sentence in sentences)

    def role(self, source: Source) -> str | None:
        """What the channel's messages are to fieldloc: one of logs.foreign.settings.ROLES, or None."""
        return next(iter(self.plays(source)), None)

    def plays(self, source: Source) -> tuple[str, ...]:
        """All of its roles."""
        return self._interpreter.plays(source)

    def candidate(self, source: Source) -> str | None:
        """The role that the channel could play if another did not."""
        return self._interpreter.roles.candidates.get(source.topic)

    def problem(self, source: Source) -> str | None:
        """Why a topic that has a role cannot play it, or None."""
        role = self._meant(source.topic)
        own, part = own_schema(source), known_type(source)
        if role is None or (own.role == role if own else part in PLAYERS[role]):
            return None
        if own is None and part is not None and not self._is_told(source.topic):
            return None  # an image on /camera
        carried = f"{source.schema_name or 'no schema'} ({source.message_encoding or 'no encoding'})"
        if role not in BY_ROLE:
            return f"topic {source.topic} carries {carried}, which cannot be {role}"
        known = BY_ROLE[role].name
        if source.message_encoding == MESSAGE_ENCODING and source.schema_name.startswith("fieldloc."):
            name, _, version = source.schema_name.rpartition(".")
            if known.startswith(f"{name}.") and version != known.rpartition(".")[2]:
                return f"topic {source.topic} carries {source.schema_name}, known is {known}: update fieldloc"
        return f"topic {source.topic} carries {carried}, needs {known} ({MESSAGE_ENCODING})"

    def has(self, kind: type[R]) -> bool:
        """Whether there are messages on a topic of this kind of record."""
        topics = self.topics(BY_KIND[kind].role)
        told = kind is Camera and self.mapping.camera is not None
        return told or any(source.topic in topics and count > 0 for source, count in self.sources)

    def records(self, kind: type[R]) -> Iterator[R]:
        """What is on the topics of this kind of record, in the order of log time; nothing if there is no such topic."""
        if kind is Camera and self.mapping.camera is not None:
            return (camera for camera in (self.mapping.camera,) if isinstance(camera, kind))
        span = (None, self._span[1]) if kind in _LATCHED else self._span
        return (record for record in self._records((kind,), span) if isinstance(record, kind))

    def measurements(self) -> Iterator[Measurement]:
        """What an estimator may see, of all kinds in the order of log time, in one go through the file."""
        return (
            record for record in self._records(get_args(Measurement), self._span) if isinstance(record, Measurement)
        )

    def field_map(self) -> FieldMap | None:
        """The map that the log was recorded on, where the log says so."""
        return next(self.records(FieldMap), None)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Messages on these topics, or on all that fieldloc understands, in the order of log time.

        A message that its schema does not allow is left out and counted in `warnings`. Raises FieldlocError, before
        the first message, if a topic carries something else than its role needs, or if there is nothing to read.
        """
        own = self._own(topics)
        interpreter = self._interpreter
        others = {
            role: [n for n in interpreter.channels(role) if topics is None or interpreter.topic(n) in topics]
            for role in TOPICS
        }
        counts = self.container.counts
        if not any(counts.get(number) for number in {*own, *(n for numbers in others.values() for n in numbers)}):
            raise FieldlocError(f"{self.path}: {self._nothing(topics)}")
        return self._decoded(own, interpreter.translation(others), self._span)

    def images(self, topic: str | None = None) -> Iterator[ImagePart]:
        """Pictures as they were logged, of one topic, the likeliest if none is named. FieldlocError where none are."""
        sources, counts = self._sources, self.container.counts
        parts = {n: known_type(source) for n, source in sources.items() if counts.get(n)}
        found = {n: sources[n].topic for n, part in parts.items() if part in PLAYERS["image"]}
        playing = self._interpreter.roles.topics.get("image", ())
        wanted = topic or next(iter(playing), None)
        number = next((n for n, name in found.items() if name == wanted), None)
        if number is None:
            where = f"no images on {topic}" if topic else "holds no images"
            held = f"; there are some on {', '.join(sorted(set(found.values())))}" if found else ""
            raise FieldlocError(f"{self.path}: {where}{held}")
        if parts[number] is VideoPart:
            raise FieldlocError(
                f"{self.path}: {found[number]} is compressed video ({sources[number].schema_name}), for which there is "
                "no decoder here: record CompressedImage instead, or convert the video to it"
            )
        return self._interpreter.images(number)

    def mount(self, image: ImagePart) -> CameraMount | None:
        """Where the camera was when it took one of `images`. None, and counted as left out, where nothing says so."""
        try:
            return self._interpreter.surroundings.mount(image.frame, image.stamp_ns)
        except Unusable as error:
            self.leave_out(image, str(error))
            return None

    def leave_out(self, image: ImagePart, problem: str) -> None:
        """One of `images` is of no use: `warnings` counts it."""
        topic = next(iter(self._interpreter.roles.topics.get("image", ())), "pictures")
        self._notes.leave_out(topic, complaint(topic, image.stamp_ns, problem))

    def log_times(self, wanted: Collection[Source] | None = None) -> Iterator[tuple[Source, int]]:
        """Log time of every message on these channels or on all, decoded by nobody, in the order of log time."""
        channels = [number for number, source in self._sources.items() if wanted is None or source in wanted]
        for raw in self.container.messages(channels, *self._span):
            yield self._sources[raw.channel], raw.log_time_ns

    def _records(self, kinds: Iterable[type], span: Span) -> Iterator[Record]:
        roles = [BY_KIND[kind].role for kind in kinds]
        own: dict[int, tuple[str, Schema]] = {}
        for role in roles:
            of_role = self._own(self.topics(role), role)
            if not of_role and not self._interpreter.channels(role):
                for source, count in self.sources:
                    if count and source.topic in self.topics(role) and (problem := self.problem(source)):
                        self._notes.say(problem)
            own |= of_role
        translation = self._interpreter.translation({role: self._interpreter.channels(role) for role in roles})
        if not own and not translation.channels:
            return iter(())
        return (message.record for message in self._decoded(own, translation, span))

    def _part(self, start_s: float | None, end_s: float | None) -> Span:
        span = self.container.span_ns
        if span is None or (start_s is None and end_s is None):
            return None, None
        length_s = (span[1] - span[0]) / 1e9
        if end_s is not None and end_s <= (start_s or 0.0):
            raise FieldlocError(f"{self.path}: nothing between {start_s or 0.0:g} s and {end_s:g} s")
        if start_s is not None and start_s > length_s:
            raise FieldlocError(f"{self.path}: nothing from {start_s:g} s on: the log is {length_s:.1f} s long")
        start_ns = None if start_s is None else span[0] + round(max(start_s, 0.0) * 1e9)
        return start_ns, None if end_s is None else span[0] + round(end_s * 1e9)

    def _check_topics(self) -> None:
        """--role with a topic that is not there is a mistake; a mapping may serve several logs."""
        held = {source.topic for source, _ in self.sources}
        for role, topics in self.mapping.roles.items():
            for topic in topics:
                if topic not in held and role in self.mapping.told:
                    there = ", ".join(sorted(held)) or "none"
                    raise FieldlocError(f"{self.path}: --role {role}={topic}: no such topic; there is {there}")
                if topic not in held:
                    self._notes.say(f"no topic {topic}, which is to be {role}")

    def topics(self, role: str) -> tuple[str, ...]:
        """Those that play the role or should: the usual one where the mapping says nothing and nothing plays it."""
        if role in self.mapping.roles:
            return self.mapping.roles[role]
        return self._interpreter.roles.topics.get(role) or (TOPICS[role],)

    def _is_told(self, topic: str) -> bool:
        return any(topic in topics for topics in self.mapping.roles.values())

    def _meant(self, topic: str) -> str | None:
        """The role that the topic should play, by the mapping or because it is the usual one."""
        told = next((role for role, topics in self.mapping.roles.items() if topic in topics), None)
        usual = next((role for role, name in TOPICS.items() if name == topic and role not in self.mapping.roles), None)
        return told or usual

    def _own(self, topics: Collection[str] | None, role: str | None = None) -> dict[int, tuple[str, Schema]]:
        """fieldloc's own channels on these topics. FieldlocError for one that is not what it should be.

        A message of someone else's type on a usual topic is no mistake: it is nobody's.
        """
        out = {}
        for number, source in self._sources.items():
            if topics is not None and source.topic not in topics:
                continue
            mistaken = source.schema_name.startswith("fieldloc.") or self._is_told(source.topic)
            if mistaken and (problem := self.problem(source)):
                raise FieldlocError(f"{self.path}: {problem}")
            schema = own_schema(source)
            if schema and (role is None or schema.role == role):
                out[number] = (source.topic, schema)
        return out

    def _decoded(
        self, own: Mapping[int, tuple[str, Schema]], translation: Translation, span: Span
    ) -> Iterator[Message]:
        for topic, _ in own.values():
            self._notes.begin(topic)
        topics = {number: topic for number, (topic, _) in own.items()}
        raws = self.container.messages({*own, *translation.channels}, *span)
        last_ns = 0
        for window, channels, times_ns, records in in_windows(raws, own):
            last_ns = times_ns[-1]
            if {*map(type, records)} <= _GOOD:
                yield from map(_as_message, zip(map(topics.__getitem__, channels), times_ns, records, strict=True))
                continue
            for raw, record in zip(window, records, strict=True):
                if record is None:
                    topic = self._interpreter.topic(raw.channel)
                    for one in translation.take(raw):
                        yield Message(topic, raw.log_time_ns, one)
                elif isinstance(record, BadMessage):
                    self._notes.leave_out(topics[raw.channel], str(record))
                else:
                    yield Message(topics[raw.channel], raw.log_time_ns, record)
        for one in translation.finish():
            yield Message(self.roles[BY_KIND[type(one)].role], last_ns, one)

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


def _with_topics(topics: Mapping[str, str]) -> LogMapping:
    return LogMapping(roles=MappingProxyType({role: (topic,) for role, topic in topics.items()}))
