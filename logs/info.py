"""What is in a log, topic by topic, as data for a table."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from logs.foreign.wires import own_schema
from logs.pace import Pace
from logs.reader import LogFile
from logs.source import Source


@dataclass(frozen=True, slots=True)
class TopicRow:
    """One channel.

    role: what its messages are to fieldloc, several with commas, None where they are nothing. candidate: a role that
    another topic plays, or nobody, and this one could. count: messages in the file, the unusable too.
    first_ns, last_ns, rate_hz, longest_gap_s: by the stamps of the usable messages, by log time for what others wrote
    and where there are none; None where there are too few messages to tell.
    """

    topic: str
    type: str
    role: str | None
    count: int
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None
    longest_gap_s: float | None
    candidate: str | None = None


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


def summarize(log: LogFile) -> LogSummary:
    """Reads all of it, decoding what fieldloc wrote."""
    sources = log.sources
    problems = {source.topic: problem for source, _ in sources if (problem := log.problem(source))}
    own = {s.topic for s, count in sources if count and own_schema(s) and log.plays(s) and s.topic not in problems}
    decoded = {topic: Pace() for topic in own}
    logged: dict[int, Pace] = {}  # by the source's identity: two may say the same of themselves but for a detail
    others = [source for source, count in sources if count and not (own_schema(source) and source.topic in own)]
    for source, time_ns in log.log_times(others) if others else ():
        logged.setdefault(id(source), Pace()).add(time_ns)
    for message in log.messages(own) if own else ():
        record = message.record
        stamp_ns = message.log_time_ns if isinstance(record, (Camera, FieldMap)) else record.stamp_ns
        decoded[message.topic].add(stamp_ns)
    rows = []
    for source, count in sources:
        pace = decoded.get(source.topic) if own_schema(source) and log.plays(source) else logged.get(id(source))
        rows.append(_row(log, source, count, pace))
    start_ns, end_ns = log.span_ns or (None, None)
    warnings = (*log.warnings, *(f"{log.path}: {problem}" for problem in problems.values()))
    return LogSummary(log.path, tuple(rows), start_ns, end_ns, log.metadata, warnings)


def _row(log: LogFile, source: Source, count: int, pace: Pace | None) -> TopicRow:
    name = source.topic, source.schema_name or source.message_encoding, ", ".join(log.plays(source)) or None
    candidate = None if name[2] else log.candidate(source)
    first_ns, last_ns, rate_hz, longest_gap_s = (pace and pace.measured()) or (None, None, None, None)
    return TopicRow(*name, count, first_ns, last_ns, rate_hz, longest_gap_s, candidate)
