"""Several logs as one."""

from dataclasses import replace

import edit_logs
import pytest
from edit_logs import IMU, PLAIN, TF, TF_STATIC, S, contents, imu, write
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fieldloc.errors import FieldlocError
from logs.edit import merge
from logs.reader.container import open_container
from logs.source import Attachment, RawMessage


def topics(path):
    return sorted(source.topic for source in open_container(path).sources.values())


def test_the_parts_of_a_recording_become_the_whole(tmp_path):
    whole = contents(write(tmp_path / "whole.mcap", [(TF_STATIC, 0, b"x"), *imu(200)]))
    parts = [[(TF_STATIC, 0, b"x"), *imu(200)[:70]], imu(200)[70:140], imu(200)[140:]]
    paths = [write(tmp_path / f"{i}.mcap", part) for i, part in enumerate(parts)]
    summary = merge([paths[2], paths[0], paths[1]], tmp_path / "out.mcap")
    assert contents(tmp_path / "out.mcap") == whole
    assert topics(tmp_path / "out.mcap") == ["/imu", "/tf_static"]
    assert summary.counts == {"/imu": 200, "/tf_static": 1}
    assert (summary.notes, summary.lost) == ((), ())


@given(
    logs=st.lists(
        st.lists(st.tuples(st.sampled_from([IMU, TF, PLAIN]), st.integers(0, 5), st.binary(max_size=3)), max_size=12),
        min_size=1,
        max_size=4,
    )
)
@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_messages_come_in_time_order_and_at_one_time_in_the_order_of_the_logs(logs, tmp_path):
    logs = [sorted(log, key=lambda message: message[1]) for log in logs]
    paths = [write(tmp_path / f"{i}.mcap", log) for i, log in enumerate(logs)]
    merge(paths, tmp_path / "out.mcap")
    wanted = sorted((m for log in logs for m in log), key=lambda message: message[1])
    assert [(m[0][0], m[1], m[4]) for m in contents(tmp_path / "out.mcap")] == [
        (source.topic, time, data) for source, time, data in wanted
    ]


def test_what_logs_have_of_the_same_name_is_all_kept(tmp_path):
    files = [Attachment("map.pgm", "image/x", 1, 2, b"a"), Attachment("map.pgm", "image/x", 1, 2, b"b")]
    a = write(tmp_path / "a.mcap", imu(), [("fieldloc", {"version": "1"}), ("only a", {})], files[:1])
    b = write(tmp_path / "b.mcap", imu(first=20 * S), [("fieldloc", {"version": "2"})], files[1:])
    summary = merge([a, b], tmp_path / "out.mcap")
    out = open_container(tmp_path / "out.mcap")
    assert dict(out.metadata) == {"fieldloc": {"version": "1"}, "only a": {}, "fieldloc (b.mcap)": {"version": "2"}}
    assert [*out.attachments()] == files
    assert summary.attachments == 2


def test_two_robots_stay_apart_by_prefixes(tmp_path):
    a = write(tmp_path / "a.mcap", [*imu(), *imu(source=TF)])
    b = write(tmp_path / "b.mcap", imu(first=1))
    summary = merge([a, b], tmp_path / "out.mcap", ["robot1", "/robot2/"])
    assert topics(tmp_path / "out.mcap") == ["/robot1/imu", "/robot1/tf", "/robot2/imu"]
    assert summary.counts == {"/robot1/imu": 100, "/robot1/tf": 100, "/robot2/imu": 100}
    assert summary.notes == ()
    merge([a, b], tmp_path / "out.mcap", ["", "robot2"])
    assert topics(tmp_path / "out.mcap") == ["/imu", "/robot2/imu", "/tf"]
    there = {m[0]: m[0] for m in contents(tmp_path / "out.mcap")}
    assert edit_logs.key(replace(IMU, topic="/robot2/imu")) in there


def test_logs_of_one_time_that_become_one_topic_are_told(tmp_path):
    a = write(tmp_path / "a.mcap", [*imu(), (PLAIN, 9 * S, b"")])
    b = write(tmp_path / "b.mcap", imu(first=5 * S))
    summary = merge([a, b], tmp_path / "out.mcap")
    assert summary.notes == (f"joined, although {a} and {b} overlap in time: /imu",)
    assert summary.counts == {"/anything": 1, "/imu": 200}


def test_one_topic_of_two_types_is_the_user_s_to_decide(tmp_path):
    a = write(tmp_path / "a.mcap", imu())
    b = write(tmp_path / "b.mcap", imu(source=replace(IMU, schema_name="sensor_msgs/msg/MagneticField")))
    with pytest.raises(FieldlocError, match=r"/imu is sensor_msgs/msg/Imu \(cdr\) in .*a.mcap and .*prefix"):
        merge([a, b], tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()
    merge([a, b], tmp_path / "out.mcap", ["a", "b"])
    assert topics(tmp_path / "out.mcap") == ["/a/imu", "/b/imu"]


def test_one_type_of_two_definitions_is_two_channels_of_one_topic(tmp_path):
    newer = replace(IMU, schema_data=b"float64 x\nfloat64 y")
    a, b = write(tmp_path / "a.mcap", imu()), write(tmp_path / "b.mcap", imu(source=newer, first=10 * S))
    merge([a, b], tmp_path / "out.mcap")
    assert {source.schema_data for source in open_container(tmp_path / "out.mcap").sources.values()} == {
        IMU.schema_data,
        newer.schema_data,
    }


def test_channels_without_messages_are_kept(tmp_path):
    told = [(IMU, RawMessage(1, 5, 5, 0, b"x"))]
    fake = edit_logs.Fake(tmp_path / "fake", told)
    fake.silent = {7: TF}
    merge([fake], tmp_path / "out.mcap")
    assert topics(tmp_path / "out.mcap") == ["/imu", "/tf"]


def test_mistakes_are_told_before_anything_is_written(tmp_path):
    a, b = write(tmp_path / "a.mcap", imu()), write(tmp_path / "b.mcap", imu())
    before = a.read_bytes()
    with pytest.raises(FieldlocError, match="given twice"):
        merge([a, b, tmp_path / "." / "a.mcap"], tmp_path / "out.mcap")
    with pytest.raises(FieldlocError, match="1 prefixes for 2 logs"):
        merge([a, b], tmp_path / "out.mcap", ["one"])
    with pytest.raises(FieldlocError, match="no logs"):
        merge([], tmp_path / "out.mcap")
    with pytest.raises(FieldlocError, match="is what is read"):
        merge([a, b], b)
    assert (a.read_bytes(), sorted(tmp_path.iterdir())) == (before, [a, b])


def test_what_is_wrong_with_a_log_is_told_with_its_name(tmp_path):
    a, b = write(tmp_path / "a.mcap", imu()), write(tmp_path / "b.mcap", imu(first=20 * S))
    b.write_bytes(b.read_bytes()[:-300])
    summary = merge([a, b], tmp_path / "out.mcap")
    assert any("b.mcap" in sentence for sentence in summary.lost)
    assert summary.messages > 100
