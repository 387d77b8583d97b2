"""What is in a log, topic by topic, as data for a table."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from logs.reader import LogFile


@dataclass(frozen=True, slots=True)
class TopicRow:
    """One channel.

    role: what its messages are to fieldloc, None where they are nothing. count: messages in the file, the unusable too.
    first_ns, last_ns, rate_hz, longest_gap_s: by the stamps of the usable messages, by log time where there are none;
    None where there are too few messages to tell.
    """

    topic: str
    type: str
    role: str | None
    count: int
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None
    longest_gap_s: float | None


@dataclass(frozen=True, slots=True)
class LogSummary:
    """Rows by topic; start and end by log time, None in a log without messages; what is wrong with the log."""

    path: Path
    rows: tuple[TopicRow, ...]
    start_ns: int | None
    end_ns: int | None
    metadata: Mapping[str, Mapping[str, str]]
    warnings: tuple[str, ...]

    @property
    def duration_s(self) -> float:
        return 0.0 if self.start_ns is None or self.end_ns is None else (self.end_ns - self.start_ns) / 1e9


def summarize(path: str | Path, roles: Mapping[str, str] | None = None) -> LogSummary:
    """Read the whole log once, decoding what has a role. FieldlocError only for what is not an MCAP file."""
    log = LogFile(path, roles)
    times: dict[tuple[str, str], list[int]] = {}
    if any(count and log.role(source) is None for source, count in log.sources):
        for source, time_ns in log.log_times():
            if log.role(source) is None:
                times.setdefault((source.topic, source.schema_name), []).append(time_ns)
    usable = {source.topic: source.schema_name for source, count in log.sources if count and log.role(source)}
    problems = {source.topic: problem for source, _ in log.sources if (problem := log.problem(source))}
    if readable := usable.keys() - problems.keys():
        for message in log.messages(readable):
            record = message.record
            stamp_ns = message.log_time_ns if isinstance(record, (Camera, FieldMap)) else record.stamp_ns
            times.setdefault((message.topic, usable[message.topic]), []).append(stamp_ns)
    rows = tuple(
        _row(source.topic, source.schema_name or source.message_encoding, log.role(source), count, stamps)
        for source, count in log.sources
        for stamps in [times.get((source.topic, source.schema_name), [])]
    )
    start_ns, end_ns = log.span_ns or (None, None)
    warnings = (*log.warnings, *(f"{log.path}: {problem}" for problem in problems.values()))
    return LogSummary(log.path, rows, start_ns, end_ns, log.metadata, warnings)


def _row(topic: str, kind: str, role: str | None, count: int, stamps: list[int]) -> TopicRow:
    if not stamps:
        return TopicRow(topic, kind, role, count, None, None, None, None)
    ordered = np.sort(np.array(stamps, dtype=np.uint64))
    first, last = int(ordered[0]), int(ordered[-1])
    rate = (len(ordered) - 1) / ((last - first) / 1e9) if last > first else None
    gap = float(np.diff(ordered).max()) / 1e9 if len(ordered) > 1 else None
    return TopicRow(topic, kind, role, count, first, last, rate, gap)
