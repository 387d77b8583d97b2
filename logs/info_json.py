"""The summary of a log for programs."""

from logs.info import LogSummary, TopicRow
from logs.results import Json
from logs.source import Container


def summary_document(summary: LogSummary, container: Container) -> dict[str, Json]:
    """What `fieldloc info --json` prints; docs/own-logs.md lists the keys."""
    return {
        "path": str(summary.path),
        "start_ns": summary.start_ns,
        "end_ns": summary.end_ns,
        "duration_s": summary.duration_s,
        "messages": sum(row.count for row in summary.rows),
        "topics": [_topic(row) for row in summary.rows],
        "attachments": [
            {"name": file.name, "media_type": file.media_type, "log_time_ns": file.log_time_ns, "bytes": len(file.data)}
            for file in container.attachments()
        ],
        "metadata": {name: dict(record) for name, record in summary.metadata.items()},
        "warnings": list(summary.warnings),
    }


def _topic(row: TopicRow) -> dict[str, Json]:
    return {
        "topic": row.topic,
        "type": row.type,
        "role": row.role,
        "candidate": row.candidate,
        "messages": row.count,
        "first_ns": row.first_ns,
        "last_ns": row.last_ns,
        "rate_hz": row.rate_hz,
        "longest_gap_s": row.longest_gap_s,
    }
