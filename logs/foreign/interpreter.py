"""Other people's messages in a container, as records. What they need of the rest of the log is read when needed."""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from itertools import islice

import numpy as np

from fieldloc.camera import Camera
from logs.foreign.adapters import Adapter, adapter, frames_of, is_finite, stamp_of
from logs.foreign.camera import camera_of
from logs.foreign.frames import Frames, plain
from logs.foreign.notes import Notes, complaint
from logs.foreign.parts import BadPart, CameraPart, ImagePart, Part, Transforms
from logs.foreign.roles import PLAYERS, Roles, guess_roles, is_command, is_static
from logs.foreign.settings import LogMapping
from logs.foreign.surroundings import FIELD_NAMES, ODOM_NAMES, ROBOT_NAMES, Surroundings, Unusable, last
from logs.foreign.wires import decoder, known_type, own_schema
from logs.schema import TOPICS, BadMessage, Record, decode
from logs.source import Container, RawMessage, Source

_PEEKED = 500  # transforms looked at for an odometry among them
_TRIED = 100  # calibrations looked at for one that is any
_MARGIN_NS = 2_000_000_000  # transforms read on both sides of what is read of the log
_NAMED = (*ROBOT_NAMES, *ODOM_NAMES, *FIELD_NAMES)

Decode = Callable[[bytes], Part]
Span = tuple[int | None, int | None]
"""Log times from and to which a log is read."""


class Interpreter:
    """Knows what the container's topics mean. Sources and roles are looked at once, when it is made."""

    def __init__(self, container: Container, mapping: LogMapping, notes: Notes, span: Span) -> None:
        self._container = container
        self._mapping = mapping
        self._notes = notes
        self._span = span
        self._sources: Mapping[int, Source] = dict(container.sources)
        self._decoders: dict[int, Decode] = {}
        counts = container.counts
        channels = [(source, counts.get(number, 0)) for number, source in self._sources.items()]
        self.roles: Roles = guess_roles(channels, mapping, self._has_odometry)

    def plays(self, source: Source) -> tuple[str, ...]:
        """The roles of the channel, those that give records first."""
        own, part = own_schema(source), known_type(source)
        return tuple(
            role
            for role in self.roles.of(source.topic)
            if (own.role == role if own is not None else part in PLAYERS[role])
        )

    def channels(self, role: str) -> tuple[int, ...]:
        """Those of others that play it."""
        return tuple(
            number
            for number, source in self._sources.items()
            if own_schema(source) is None and role in self.plays(source)
        )

    def translation(self, channels: Mapping[str, Collection[int]]) -> "Translation":
        """A fresh reading of these channels by role."""
        for number in channels.get("odometry", ()):
            if "odometry" not in self._mapping.roles and is_command(topic := self._sources[number].topic):
                self._notes.say(f"odometry is guessed to be {topic}, which is what the robot was told, not what it did")
        return Translation(self, {role: numbers for role, numbers in channels.items() if numbers})

    def images(self, number: int) -> Iterator[ImagePart]:
        """The channel's pictures, not decoded; those that are none are left out."""
        topic = self._sources[number].topic
        self._notes.begin(topic)
        for raw, part in self.parts((number,), self._span):
            if isinstance(part, ImagePart):
                stamp_ns = self._notes.stamp(topic, part.stamp_ns, raw.log_time_ns)
                yield part if stamp_ns == part.stamp_ns else replace(part, stamp_ns=stamp_ns)

    def parts(self, channels: Collection[int], span: Span) -> Iterator[tuple[RawMessage, Part]]:
        """Decoded messages of others; those that do not fit their definition are left out."""
        for raw in self._container.messages(channels, *span):
            if (part := self.part(raw)) is not None:
                yield raw, part

    def part(self, raw: RawMessage) -> Part | None:
        """The message decoded; None, and noted as left out, where it is broken."""
        try:
            return self._decode(raw.channel)(raw.data)
        except BadPart as error:
            topic = self._sources[raw.channel].topic
            self._notes.leave_out(topic, complaint(topic, raw.log_time_ns, str(error)))
            return None

    def topic(self, number: int) -> str:
        return self._sources[number].topic

    @property
    def notes(self) -> Notes:
        return self._notes

    @cached_property
    def surroundings(self) -> Surroundings:
        return Surroundings(self._mapping, self._notes, self._read_frames, self._read_camera)

    def _decode(self, number: int) -> Decode:
        if number not in self._decoders:
            found = decoder(self._sources[number])
            assert found is not None  # only channels whose type is known play a role
            self._decoders[number] = found
        return self._decoders[number]

    def _transforms(self, static: bool) -> tuple[int, ...]:
        return tuple(n for n in self.channels("tf") if is_static(self._sources[n].topic) == static)

    def _read_frames(self) -> Frames:
        named = self._frames_named()
        frames = Frames(self._mapping.frames.max_age_s, lambda frame: frame in named or last(frame) in _NAMED)
        start_ns, end_ns = self._span
        around = (start_ns and max(0, start_ns - _MARGIN_NS), end_ns and end_ns + _MARGIN_NS)
        for static, span in ((True, (None, None)), (False, around)):
            if channels := self._transforms(static):
                for raw, part in self.parts(channels, span):
                    if isinstance(part, Transforms):
                        frames.add(part.transforms, raw.log_time_ns, static)
        return frames

    def _frames_named(self) -> set[str]:
        """Those of the mapping, and those that the first message of each role names."""
        told = self._mapping.frames
        out = {told.field, told.odom, told.robot, told.camera}
        for role in self.roles.topics.keys() & TOPICS.keys():
            for number in self.channels(role):
                for raw in islice(self._container.messages((number,)), 1):
                    if (part := self.part(raw)) is not None:
                        out.update(frames_of(part))
        return {plain(frame) for frame in out if frame}

    def _read_camera(self) -> tuple[Camera | None, str]:
        """From the beginning on, whatever part of the log is read."""
        topics = self.roles.topics.get("camera", ())
        own = {n: s for n, source in self._sources.items() if source.topic in topics and (s := own_schema(source))}
        frame = ""
        for raw in islice(self._container.messages({*own, *self.channels("camera")}), _TRIED):
            try:
                if raw.channel in own:
                    record = decode(own[raw.channel], self._sources[raw.channel].topic, raw.data)
                    if isinstance(record, Camera):
                        return record, ""
                else:
                    part = self._decode(raw.channel)(raw.data)
                    if isinstance(part, CameraPart):
                        frame = frame or part.frame
                        return camera_of(part, self._mapping.rectified), part.frame
            except (BadMessage, BadPart, Unusable):
                continue  # whoever reads the cameras counts them
        return None, frame

    def _has_odometry(self, topics: Collection[str]) -> bool:
        """Whether transforms on these topics tell how the robot moves."""
        told = plain(self._mapping.frames.odom)
        channels = [
            number
            for number, source in self._sources.items()
            if source.topic in topics and known_type(source) is Transforms
        ]
        for raw in islice(self._container.messages(channels), _PEEKED):
            try:
                part = self._decode(raw.channel)(raw.data)
            except BadPart:
                continue
            if isinstance(part, Transforms):
                parents = [plain(transform.parent) for transform in part.transforms]
                if any(parent == told if told else last(parent) in ODOM_NAMES for parent in parents):
                    return True
        return False


class Translation:
    """One reading of channels of others: their messages in, records out. It remembers what came before."""

    def __init__(self, interpreter: Interpreter, channels: Mapping[str, Collection[int]]) -> None:
        self._interpreter = interpreter
        self._adapters: dict[int, list[Adapter]] = {}
        self._all: list[Adapter] = []
        for role, numbers in channels.items():
            topics = sorted({interpreter.topic(number) for number in numbers})
            for topic in topics:
                interpreter.notes.begin(topic)
            made = adapter(role, topics, interpreter.surroundings)
            if made is not None:
                self._all.append(made)
                for number in numbers:
                    self._adapters.setdefault(number, []).append(made)

    @property
    def channels(self) -> Collection[int]:
        return self._adapters.keys()

    def take(self, raw: RawMessage) -> Iterator[Record]:
        """What is known with this message."""
        part = self._interpreter.part(raw)
        if part is None:
            return
        topic, notes = self._interpreter.topic(raw.channel), self._interpreter.notes
        stated_ns = stamp_of(part)
        stamp_ns = notes.stamp(topic, stated_ns, raw.log_time_ns)
        for made in self._adapters[raw.channel]:
            out: list[Record] = []
            with np.errstate(all="ignore"):  # numbers beyond all reason end as NaN
                try:
                    out += made.take(topic, stamp_ns, part)
                except Unusable as error:
                    notes.leave_out(topic, complaint(topic, stamp_ns, str(error)))
            for record in out:
                if is_finite(record):
                    yield record
                else:
                    notes.leave_out(topic, complaint(topic, stamp_ns, "its numbers are beyond all reason"))

    def finish(self) -> Iterator[Record]:
        """What was waiting for more."""
        for made in self._all:
            yield from filter(is_finite, made.finish())
