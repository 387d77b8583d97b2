from pathlib import Path

import pytest
from real_logs import sample_messages, write

from logs.info import LogSummary, TopicRow, summarize
from logs.info_text import format_summary
from logs.reader import LogFile


def summary(*rows: TopicRow, start_ns: int | None = 0, end_ns: int | None = 2_500_000_000) -> LogSummary:
    metadata = {"fieldloc": {"source": "a robot", "version": "1.2"}, "other": {"weather": "sunny"}}
    return LogSummary(Path("some.mcap"), rows, start_ns, end_ns, metadata, ("a warning",))


def test_a_log_has_its_span_what_its_maker_said_and_a_line_per_topic() -> None:
    text = format_summary(
        summary(
            TopicRow("/odometry", "fieldloc.Odometry.v1", "odometry", 26, 0, 2_500_000_000, 10.0, 0.1),
            TopicRow("/imu", "sensor_msgs/msg/Imu", None, 1, 0, 0, None, None),
        )
    )
    lines = text.splitlines()
    assert lines[0] == "some.mcap: 2.5 s, from 0.0 s to 2.5 s"
    assert lines[1:4] == ["source: a robot", "version: 1.2", "weather: sunny"]
    assert lines[-2].split() == ["/odometry", "fieldloc.Odometry.v1", "odometry", "26", "10.00", "0.100"]
    assert lines[-1].split() == ["/imu", "sensor_msgs/msg/Imu", "-", "1", "-", "-"]


def test_stamps_of_todays_clock_keep_every_digit() -> None:
    text = format_summary(summary(start_ns=1_248_444_187_156_000_001, end_ns=1_248_444_188_156_000_001))
    assert "1.0 s, from 1248444187.156000001 s to 1248444188.156000001 s" in text


def test_a_log_without_messages_says_so() -> None:
    assert format_summary(summary(start_ns=None, end_ns=None)).startswith("some.mcap: no messages\n")


def test_columns_are_aligned_under_their_titles(tmp_path: Path) -> None:
    lines = format_summary(summarize(LogFile(write(tmp_path / "log.mcap", sample_messages(2.0))))).splitlines()
    titles = next(line for line in lines if line.startswith("topic"))
    rows = lines[lines.index(titles) + 1 :]
    assert [row.split()[0] for row in rows] == ["/field", "/landmarks", "/odometry", "/truth"]
    for title in ("type", "role", "messages", "rate / Hz", "longest gap / s"):
        end = titles.index(title) + len(title)
        assert all(len(row) == end or row[end : end + 2] == "  " for row in rows), title
        assert all(row[end - 1] != " " for row in rows), title


@pytest.mark.parametrize("count", [1, 2])
def test_rates_and_gaps_need_two_messages(tmp_path: Path, count: int) -> None:
    messages = [m for m in sample_messages(2.0) if m.topic == "/odometry"][:count]
    last = format_summary(summarize(LogFile(write(tmp_path / "log.mcap", messages)))).splitlines()[-1]
    assert last.split()[-2:] == (["-", "-"] if count == 1 else ["10.00", "0.100"])
