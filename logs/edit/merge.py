"""Several logs as one."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

from fieldloc.errors import FieldlocError
from logs.edit.copying import Copy, Summary, opened, profile
from logs.output import output_file
from logs.progress import Progress, unwatched
from logs.reader.merged import Merged
from logs.source import Attachment, Container, RawMessage, Source
from logs.writer import LogWriter


def merge(
    sources: Sequence[Container | Path | str],
    out: Path | str,
    prefixes: Sequence[str] = (),
    progress: Progress = unwatched,
) -> Summary:
    """All messages of several logs in the order of log time, at equal times in the order of the logs.

    prefixes: one for each log, put before its topics (robot1: /imu becomes /robot1/imu; empty: they stay), so that the
    logs of two robots stay apart. Without, a topic that is in several logs becomes one; `notes` says so where the logs
    overlap in time. FieldlocError where it carries different types, for one log twice, and for prefixes that are not as
    many as the logs.
    """
    containers = _with_prefixes([opened(source) for source in sources], prefixes)
    path = output_file(Path(out), *(container.path for container in containers))
    for one, other in combinations(containers, 2):
        _check(one, other)
    merged = Merged(containers)
    with LogWriter(path, profile=profile(merged.sources.values()), signed=False) as writer:
        copy = Copy(merged, writer, progress)
        copy.whole()
    notes = tuple(note for one, other in combinations(containers, 2) for note in _joined(one, other))
    return copy.summary(path, (*merged.damage, *copy.missing()), notes)


class _Prefixed:
    """A container whose topics have another name."""

    def __init__(self, container: Container, prefix: str) -> None:
        self._container = container
        start = f"/{prefix.strip('/')}/"
        self.sources: Mapping[int, Source] = {
            number: replace(source, topic=start + source.topic.lstrip("/"))
            for number, source in container.sources.items()
        }

    @property
    def path(self) -> Path:
        return self._container.path

    @property
    def counts(self) -> Mapping[int, int]:
        return self._container.counts

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return self._container.span_ns

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        return self._container.metadata

    @property
    def damage(self) -> tuple[str, ...]:
        return self._container.damage

    def messages(
        self, channels: Collection[int], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        return self._container.messages(channels, start_ns, end_ns)

    def attachments(self) -> Iterator[Attachment]:
        return self._container.attachments()


def _with_prefixes(containers: Sequence[Container], prefixes: Sequence[str]) -> list[Container]:
    if not containers:
        raise FieldlocError("merge: no logs given")
    if not prefixes:
        return [*containers]
    if len(prefixes) != len(containers):
        raise FieldlocError(f"merge: {len(prefixes)} prefixes for {len(containers)} logs; give one for each")
    pairs = zip(containers, prefixes, strict=True)
    return [_Prefixed(container, prefix) if prefix.strip("/") else container for container, prefix in pairs]


def _check(one: Container, other: Container) -> None:
    if one.path.exists() and other.path.exists() and one.path.samefile(other.path):
        raise FieldlocError(f"{one.path}: given twice")
    types = {source.topic: _type(source) for source in one.sources.values()}
    for source in other.sources.values():
        if (carried := types.get(source.topic, _type(source))) != _type(source):
            raise FieldlocError(
                f"topic {source.topic} is {carried} in {one.path} and {_type(source)} in {other.path}; "
                "give each log a prefix to keep them apart"
            )


def _joined(one: Container, other: Container) -> Iterator[str]:
    if one.span_ns is None or other.span_ns is None:
        return
    if one.span_ns[0] > other.span_ns[1] or other.span_ns[0] > one.span_ns[1]:  # parts of one recording
        return
    if both := sorted(_spoken(one) & _spoken(other)):
        yield f"joined, although {one.path} and {other.path} overlap in time: {', '.join(both)}"


def _spoken(container: Container) -> set[str]:
    return {source.topic for number, source in container.sources.items() if container.counts.get(number)}


def _type(source: Source) -> str:
    return f"{source.schema_name or 'no schema'} ({source.message_encoding or 'no encoding'})"
