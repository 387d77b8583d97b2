"""From a container to a writer, as it is; what every edit has in common."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from fieldloc.errors import FieldlocError
from logs.progress import Progress
from logs.reader.container import open_container
from logs.reader.damage import times
from logs.schema import seconds
from logs.source import Container, RawMessage, Source
from logs.writer import LogWriter

_PROGRESS_EVERY = 2000
_PROFILES = {("cdr", "ros2msg"): "ros2", ("cdr", "ros2idl"): "ros2", ("ros1", "ros1msg"): "ros1"}


@dataclass(frozen=True, slots=True)
class Summary:
    """What an edit wrote. counts: messages by topic. span_ns: log time of the first and the last.

    lost: what the input held, or once held, and the output does not although it should, one sentence each.
    notes: what else a person should know, one sentence each.
    """

    path: Path
    counts: Mapping[str, int]
    span_ns: tuple[int, int] | None
    attachments: int
    lost: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def messages(self) -> int:
        return sum(self.counts.values())


class Copy:
    """One container on its way into a writer, and the tally of it."""

    def __init__(self, source: Container, out: LogWriter, progress: Progress) -> None:
        self._source, self._out, self._progress = source, out, progress
        self._attachments = 0
        self.counts = dict.fromkeys(source.sources, 0)
        self._first_ns: int | None = None
        self._last_ns = 0

    def everything_else(self) -> None:
        """Metadata and attachments: first, so that they are there if the rest never comes."""
        for name, mapping in self._source.metadata.items():
            self._out.add_metadata(name, mapping)
        for attachment in self._source.attachments():
            self._out.attach(attachment)
            self._attachments += 1

    def whole(self) -> None:
        """All of it, channels without messages too."""
        self.everything_else()
        for channel in self._source.sources.values():
            self._out.add_source(channel)
        self.messages(self._source.messages(self._source.sources.keys()), self._source.span_ns or (0, 0))

    def messages(self, messages: Iterable[RawMessage], span_ns: tuple[int, int]) -> None:
        """In their order. span_ns: roughly where they begin and end; only for whoever watches."""
        sources, write = self._source.sources, self._out.write_raw
        first_ns, last_ns = span_ns
        total = (last_ns - first_ns) // 10**6 + 1
        for i, message in enumerate(messages):
            try:
                write(
                    sources[message.channel],
                    message.log_time_ns,
                    message.data,
                    message.publish_time_ns,
                    message.sequence,
                )
            except ValueError as error:  # times before the epoch: other formats have them, MCAP does not
                topic = sources[message.channel].topic
                raise FieldlocError(f"{self._source.path}: {topic}: {error}; leave the topic out") from None
            self.counts[message.channel] += 1
            if self._first_ns is None:
                self._first_ns = message.log_time_ns
            self._last_ns = message.log_time_ns
            if i % _PROGRESS_EVERY == 0:
                self._progress(min(max(message.log_time_ns - first_ns, 0) // 10**6, total), total, "messages")

    def summary(self, path: Path, lost: tuple[str, ...] = (), notes: tuple[str, ...] = ()) -> Summary:
        counts: dict[str, int] = {}
        for channel, count in self.counts.items():
            topic = self._source.sources[channel].topic
            counts[topic] = counts.get(topic, 0) + count
        span_ns = None if self._first_ns is None else (self._first_ns, self._last_ns)
        by_topic = {topic: counts[topic] for topic in sorted(counts) if counts[topic]}
        return Summary(path, by_topic, span_ns, self._attachments, lost, notes)

    def missing(self) -> tuple[str, ...]:
        """Topics of which fewer messages came than the file's index had promised, if all were asked for."""
        lost: dict[str, int] = {}
        for channel, count in self._source.counts.items():
            topic = self._source.sources[channel].topic
            lost[topic] = lost.get(topic, 0) + count - self.counts[channel]
        return tuple(f"{topic}: {times(n, 'message')} in damaged records" for topic, n in sorted(lost.items()) if n > 0)


def opened(source: Container | Path | str) -> Container:
    """The container itself, or that of a path."""
    return open_container(Path(source)) if isinstance(source, (str, Path)) else source


def profile(sources: Collection[Source]) -> str:
    """MCAP's name for a file with nothing but messages of one ROS version in it."""
    profiles = {_PROFILES.get((source.message_encoding, source.schema_encoding), "") for source in sources}
    return profiles.pop() if len(profiles) == 1 else ""


def span(source: Container) -> str:
    """For people."""
    return "no messages" if source.span_ns is None else " to ".join(map(seconds, source.span_ns))
