"""What importing did, as data for whoever prints it, and the one way all importers write their log."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from heapq import merge
from pathlib import Path

from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from logs.schema import Stamped, topic_of
from logs.writer import LogWriter

Progress = Callable[[int, int], None]
"""Told now and then how many of how many messages are written."""

_PROGRESS_EVERY = 1000


@dataclass(frozen=True, slots=True)
class Imported:
    """The log that was written, its messages by topic, and what of the source is not in it."""

    path: Path
    counts: Mapping[str, int]
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Cut:
    """How an importer thins the landmarks out. anonymous: drop who they are. max_range_m: drop those farther away."""

    anonymous: bool = False
    max_range_m: float | None = None

    def __post_init__(self) -> None:
        if self.max_range_m is not None and not self.max_range_m > 0.0:
            raise ValueError(f"max_range_m is {self.max_range_m}, must be above 0")

    def keeps(self, range_m: float) -> bool:
        return self.max_range_m is None or range_m <= self.max_range_m

    def label(self, label: str) -> str | None:
        return None if self.anonymous else label


def write_log(
    path: str | Path,
    field: FieldMap,
    streams: Sequence[Sequence[Stamped]],
    source: Mapping[str, str],
    config: Mapping[str, float | str | bool | None],
    warnings: Iterable[str] = (),
    progress: Progress | None = None,
) -> Imported:
    """The map first, then the streams (each in order of its stamps) merged by stamp; the log time is the stamp.

    source: what to say about the data set in the log's metadata. config: the importer's options.
    """
    counts: dict[str, int] = {}
    done, total = 0, sum(map(len, streams))
    if total == 0:
        raise FieldlocError(f"{path}: not written: the source has no measurements")
    with LogWriter(path, {**source, "config": json.dumps(config)}) as log:
        for record in merge(*streams, key=lambda record: record.stamp_ns):
            if not counts:
                log.write(topic_of(FieldMap), field, log_time_ns=record.stamp_ns)
                counts[topic_of(FieldMap)] = 1
            topic = topic_of(type(record))
            log.write(topic, record)
            counts[topic] = counts.get(topic, 0) + 1
            done += 1
            if progress is not None and (done % _PROGRESS_EVERY == 0 or done == total):
                progress(done, total)
    return Imported(Path(path), counts, tuple(warnings))
