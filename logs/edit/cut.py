"""A part of a log: some time, some topics."""

from collections.abc import Collection
from fnmatch import fnmatchcase
from itertools import chain
from pathlib import Path

from fieldloc.errors import FieldlocError
from logs.edit.copying import Copy, Summary, opened, profile, span
from logs.edit.lasting import carried
from logs.output import output_file
from logs.progress import Progress, unwatched
from logs.schema import seconds
from logs.source import Container, RawMessage
from logs.writer import LogWriter


def cut(
    source: Container | Path | str,
    out: Path | str,
    start_ns: int | None = None,
    end_ns: int | None = None,
    topics: Collection[str] | None = None,
    without: Collection[str] = (),
    progress: Progress = unwatched,
) -> Summary:
    """Messages with start <= log time < end on some topics.

    topics: all by default; without: left out of them. Both are names or patterns such as "/camera/*". What was said
    once before the start and still holds (logs.edit.lasting lists it) is carried over to the start.
    FieldlocError where nothing remains, or a name or pattern fits no topic.
    """
    container = opened(source)
    path = output_file(Path(out), container.path)
    channels = _chosen(container, topics, without)
    before = carried(container, channels, start_ns, end_ns) if start_ns is not None else []
    inside = container.messages(channels, start_ns, end_ns)
    first = next(inside, None)
    if first is None:
        raise FieldlocError(f"{container.path}: no messages {_range(start_ns, end_ns)}; it goes from {span(container)}")
    with LogWriter(path, profile=profile([container.sources[i] for i in channels]), signed=False) as writer:
        copy = Copy(container, writer, progress)
        copy.everything_else()
        copy.messages(chain(before, [first], inside), _watched(container, first, end_ns))
    names = sorted({container.sources[message.channel].topic for message in before})
    notes = (f"carried over from before the start: {', '.join(names)}",) if names else ()
    whole = start_ns is None and end_ns is None and len(channels) == len(container.sources)
    return copy.summary(path, (*container.damage, *(copy.missing() if whole else ())), notes)


def _chosen(container: Container, topics: Collection[str] | None, without: Collection[str]) -> frozenset[int]:
    names = {source.topic for source in container.sources.values()}
    for pattern in (*(topics or ()), *without):
        if not any(fnmatchcase(name, pattern) for name in names):
            there = ", ".join(sorted(names)) or "none"
            raise FieldlocError(f"{container.path}: no topic {pattern}; there are: {there}")
    kept = {name for name in names if (topics is None or _fits(name, topics)) and not _fits(name, without)}
    return frozenset(i for i, source in container.sources.items() if source.topic in kept)


def _fits(name: str, patterns: Collection[str]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def _range(start_ns: int | None, end_ns: int | None) -> str:
    said = [] if start_ns is None else [f"from {seconds(start_ns)}"]
    said += [] if end_ns is None else [f"before {seconds(end_ns)}"]
    return " ".join([*said, "on these topics"])


def _watched(container: Container, first: RawMessage, end_ns: int | None) -> tuple[int, int]:
    last_ns = first.log_time_ns if container.span_ns is None else container.span_ns[1]
    return first.log_time_ns, last_ns if end_ns is None else min(end_ns, last_ns)
