"""The summary of a log for the terminal."""

from textwrap import shorten

from logs.info import LogSummary, TopicRow
from logs.schema import seconds
from logs.table import Cell, Table
from logs.table_text import format_columns

_WIDE = 100  # characters of what a metadata record says: some hold whole configurations
_TITLES = ("topic", "type", "role", "messages", "rate / Hz", "longest gap / s")


def format_summary(summary: LogSummary) -> str:
    """A line on the whole log, what its maker said about it, and a row per topic; `role?` is one it could play."""
    span = "no messages"
    if summary.start_ns is not None and summary.end_ns is not None:
        span = f"{summary.duration_s:.1f} s, from {seconds(summary.start_ns)} to {seconds(summary.end_ns)}"
    said = [
        f"{key}: {shorten(value, _WIDE, placeholder=' ...')}"
        for record in summary.metadata.values()
        for key, value in record.items()
    ]
    table = Table(tuple(("", title) for title in _TITLES), tuple(map(_cells, summary.rows)))
    return "\n".join([f"{summary.path}: {span}", *said, format_columns(table)])


def _cells(row: TopicRow) -> tuple[Cell, ...]:
    rate = "-" if row.rate_hz is None else f"{row.rate_hz:.2f}"
    gap = "-" if row.longest_gap_s is None else f"{row.longest_gap_s:.3f}"
    role = row.role or (f"{row.candidate}?" if row.candidate else "-")
    return tuple(Cell(text) for text in (row.topic, row.type, role, str(row.count), rate, gap))
