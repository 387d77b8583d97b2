import json

import mcap.writer
import numpy as np
import pytest

from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import Odometry, Truth
from logs.info import summarize
from logs.reader import LogFile
from logs.samples import sample_path
from logs.schema import encode
from logs.source import Source
from logs.writer import LogWriter


def test_the_sample_s_topics_with_their_rates_and_gaps():
    summary = summarize(LogFile(sample_path("woods")))
    assert [(row.topic, row.role, row.count) for row in summary.rows] == [
        ("/field", "field", 1),
        ("/landmarks", "landmarks", 12609),
        ("/odometry", "odometry", 12609),
        ("/truth", "truth", 12278),
    ]
    odometry, truth = summary.rows[2:]
    assert odometry.rate_hz == pytest.approx(10.0, rel=1e-9)
    assert odometry.longest_gap_s == pytest.approx(0.1, rel=1e-9)
    assert (odometry.first_ns, odometry.last_ns) == (0, 1_260_800_000_000)
    assert truth.longest_gap_s == pytest.approx(4.0, rel=1e-9)
    assert summary.duration_s == 1260.8
    assert summary.warnings == ()
    assert summary.rows[0].rate_hz is None


def test_rates_are_those_of_the_stamps_not_of_the_log(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        for i, stamp in enumerate([3, 1, 2, 7]):
            log.write("/truth", Truth(stamp * 10**9, np.zeros(3)), log_time_ns=i)
    (row,) = summarize(LogFile(tmp_path / "log.mcap")).rows
    assert (row.first_ns, row.last_ns, row.rate_hz, row.longest_gap_s) == (10**9, 7 * 10**9, 0.5, 4.0)


def write_raw(path, messages):
    with path.open("wb") as file:
        log = mcap.writer.Writer(file)
        log.start()
        for topic, schema, encoding, time_ns, data in messages:
            number = log.register_schema(schema, "jsonschema", b"{}") if schema else 0
            log.add_message(log.register_channel(topic, encoding, number), time_ns, data, time_ns)
        log.finish()


def test_topics_of_others_wrong_types_and_bad_messages_are_shown_not_raised(tmp_path):
    bad = json.dumps({**json.loads(encode(Truth(0, np.zeros(3)))), "x_m": float("nan")}).encode()
    write_raw(
        tmp_path / "log.mcap",
        [
            ("/imu", "sensor_msgs/msg/Imu", "cdr", 5, b"\x00"),
            ("/plain", "", "text", 6, b"hello"),
            ("/odometry", "nav_msgs/msg/Odometry", "cdr", 7, b"\x00"),
            ("/truth", "fieldloc.Truth.v1", "json", 8, bad),
        ],
    )
    summary = summarize(LogFile(tmp_path / "log.mcap"))
    assert [(row.topic, row.type, row.role, row.count, row.first_ns) for row in summary.rows] == [
        ("/imu", "sensor_msgs/msg/Imu", None, 1, 5),
        ("/odometry", "nav_msgs/msg/Odometry", None, 1, 7),
        ("/plain", "text", None, 1, 6),
        ("/truth", "fieldloc.Truth.v1", "truth", 1, None),
    ]
    assert "x_m is NaN" in summary.warnings[0]
    assert "/odometry carries nav_msgs/msg/Odometry" in summary.warnings[1]


def test_a_role_can_be_played_by_another_topic(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/wheels", Odometry(1, np.zeros(3)))
    (row,) = summarize(LogFile(tmp_path / "log.mcap", {"odometry": "/wheels"})).rows
    assert row.role == "odometry"
    (row,) = summarize(LogFile(tmp_path / "log.mcap", {"odometry": "/feet"})).rows
    assert (row.role, row.candidate, row.count, row.first_ns) == (None, "odometry", 1, 1)


def test_two_channels_of_one_topic_have_a_row_each_with_its_own_rate(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        for i in range(21):
            log.write_raw(Source("/tf", "cdr", "tf2_msgs/msg/TFMessage", "ros2msg", b"one"), i * 10**8, b"")
            if i % 2 == 0:
                log.write_raw(Source("/tf", "cdr", "tf2_msgs/msg/TFMessage", "ros2msg", b"other"), i * 10**8, b"")
    rows = summarize(LogFile(tmp_path / "log.mcap")).rows
    assert [(row.topic, row.role, row.count) for row in rows] == [("/tf", "tf", 21), ("/tf", "tf", 11)]
    assert [row.rate_hz for row in rows] == pytest.approx([10.0, 5.0])
    assert [row.longest_gap_s for row in rows] == pytest.approx([0.1, 0.2])


def test_a_cut_log_and_one_without_messages_have_summaries(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/field", FieldMap("empty", np.zeros((0, 2, 2)), np.zeros((0, 3)), ()), log_time_ns=4)
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "log.mcap").read_bytes()[:150])
    summary = summarize(LogFile(tmp_path / "cut.mcap"))
    assert (summary.rows, summary.start_ns, summary.duration_s) == ((), None, 0.0)
    assert "cut off" in summary.warnings[0]
    assert summarize(LogFile(tmp_path / "log.mcap")).rows[0].count == 1


def test_what_is_no_log_is_an_error(tmp_path):
    with pytest.raises(FieldlocError, match="no such file"):
        summarize(LogFile(tmp_path / "missing.mcap"))
