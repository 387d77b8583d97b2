"""Parts of the sample log, as they are or changed, as logs of their own."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from fieldloc.measurements import LandmarkScan
from logs.reader import LogFile, Message
from logs.samples import sample_path
from logs.schema import Record
from logs.writer import LogWriter


def sample_messages(until_s: float) -> list[Message]:
    out = []
    for message in LogFile(sample_path("woods")).messages():
        if message.log_time_ns > until_s * 1e9:
            break
        out.append(message)
    return out


def write(
    path: Path, messages: list[Message], change: Callable[[Record], Record | None] = lambda record: record
) -> Path:
    """change: what is logged instead of a record, None for nothing."""
    with LogWriter(path) as log:
        for message in messages:
            if (record := change(message.record)) is not None:
                log.write(message.topic, record, message.log_time_ns)
    return path


def without(*kinds: type) -> Callable[[Record], Record | None]:
    return lambda record: None if isinstance(record, kinds) else record


def nearer_than(range_m: float) -> Callable[[Record], Record]:
    """As `import --max-range-m` cuts them."""

    def cut(record: Record) -> Record:
        if not isinstance(record, LandmarkScan):
            return record
        near = record.range_bearing[:, 0] <= range_m
        labels = tuple(label for label, keep in zip(record.labels, near, strict=True) if keep)
        return replace(
            record, labels=labels, range_bearing=record.range_bearing[near], covariance=record.covariance[near]
        )

    return cut


def relabelled(change: Callable[[str | None], str | None]) -> Callable[[Record], Record]:
    def relabel(record: Record) -> Record:
        return replace(record, labels=tuple(map(change, record.labels))) if isinstance(record, LandmarkScan) else record

    return relabel
