import json
import os
import random
import struct
import tarfile
from pathlib import Path

import log_records
import mcap.writer
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader

from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import Compass, LandmarkScan, Odometry, Truth
from logs.reader import LogFile, chunks, mcap_container, read_log
from logs.reader.mcap_container import McapContainer
from logs.schema import BY_KIND, encode
from logs.writer import LogWriter

SHARED = Path(__file__).parents[2] / "shared" / "data" / "mcap"
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason=f"{SHARED} is missing: other people's MCAP files")
FIELD = FieldMap("two posts", np.zeros((0, 2, 2)), np.zeros((0, 3)), (Landmark("7", np.ones(2), 0.1, np.eye(2)),))


def odometry(i):
    return Odometry(i * 10**8, np.array([0.1, 0.0, 1e-3 * i]), np.diag([0.1, 0.2, 0.3]))


def truth(i):
    return Truth(i * 10**8, np.array([0.1 * i, -0.1, 0.2]))


def write_log(path, count=400, chunk_messages=None):
    """Odometry and truth in turn; a new chunk after every so many of each."""
    pairs = [(as_raw("/odometry", odometry(i)), as_raw("/truth", truth(i))) for i in range(count)]
    per_chunk = chunk_messages or max(count, 1)
    groups = [[message for pair in pairs[i : i + per_chunk] for message in pair] for i in range(0, count, per_chunk)]
    groups[:1] = [[as_raw("/field", FIELD, time_ns=0), *(groups[0] if groups else [])]]
    return write_raw(path, groups)


def write_raw(path, groups, **options):
    """groups: lists of (topic, schema name, message encoding, log time, bytes), each ends a chunk; or one such list."""
    groups = [groups] if groups and isinstance(groups[0], tuple) else groups
    with path.open("wb") as file:
        log = mcap.writer.Writer(file, **options)
        log.start()
        channels = {}
        for messages in groups:
            for topic, schema, encoding, time_ns, data in messages:
                if (topic, schema) not in channels:
                    number = log.register_schema(schema, "jsonschema" if encoding == "json" else "ros2msg", b"{}")
                    channels[topic, schema] = log.register_channel(topic, encoding, number)
                log.add_message(channels[topic, schema], time_ns, data, time_ns)
            log.flush()
        log.finish()
    return path


def as_raw(topic, record, time_ns=None):
    return topic, BY_KIND[type(record)].name, "json", record.stamp_ns if time_ns is None else time_ns, encode(record)


def test_a_log_tells_what_is_in_it(tmp_path):
    log = LogFile(write_log(tmp_path / "log.mcap", count=5))
    assert [(source.topic, source.schema_name, count) for source, count in log.sources] == [
        ("/field", "fieldloc.FieldMap.v1", 1),
        ("/odometry", "fieldloc.Odometry.v1", 5),
        ("/truth", "fieldloc.Truth.v1", 5),
    ]
    assert log.span_ns == (0, 4 * 10**8)
    assert log_records.same(log.field_map(), FIELD)
    assert [record.stamp_ns for record in log.records(Truth)] == [i * 10**8 for i in range(5)]
    assert list(log.records(Compass)) == []
    assert log.has(Truth)
    assert not log.has(Compass)
    assert log.warnings == ()


def test_topics_can_be_chosen(tmp_path):
    path = write_log(tmp_path / "log.mcap", count=5)
    assert {message.topic for message in read_log(path)} == {"/field", "/odometry", "/truth"}
    assert {message.topic for message in read_log(path, ["/odometry", "/compass"])} == {"/odometry"}


def test_a_role_can_be_played_by_another_topic(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/robot3/vicon", truth(1))
        log.write("/truth", truth(2))
    assert [r.stamp_ns for r in LogFile(tmp_path / "log.mcap", {"truth": "/robot3/vicon"}).records(Truth)] == [10**8]


def test_messages_on_other_topics_are_read_by_their_schema(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/robot3/vicon", truth(1))
    assert [m.record.stamp_ns for m in read_log(tmp_path / "log.mcap")] == [10**8]


# The order of messages


@given(data=st.data())
@settings(deadline=None, max_examples=40)
@pytest.mark.parametrize("chunked", [True, False])
def test_messages_come_in_the_order_of_log_time_and_equal_ones_as_they_stand(tmp_path_factory, data, chunked):
    times = data.draw(st.lists(st.integers(0, 20), min_size=1, max_size=60))
    messages = [as_raw("/truth", Truth(i, np.zeros(3)), time_ns=t) for i, t in enumerate(times)]
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    write_raw(path, messages, chunk_size=data.draw(st.integers(100, 2000)), use_chunking=chunked)
    expected = sorted(enumerate(times), key=lambda pair: pair[1])
    assert [(m.record.stamp_ns, m.log_time_ns) for m in read_log(path)] == expected


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"index_types": mcap.writer.IndexType.NONE},
        {"repeat_channels": False},
        {"repeat_schemas": False},
        {"use_statistics": False},
        {"use_summary_offsets": False},
        {"compression": mcap.writer.CompressionType.NONE},
        {"compression": mcap.writer.CompressionType.LZ4},
        {"enable_crcs": False},
        {"enable_data_crcs": True},
    ],
    ids=str,
)
def test_files_of_other_writers_are_read_whatever_their_index_lacks(tmp_path, options):
    messages = [as_raw("/truth", truth(i)) for i in range(50)]
    log = LogFile(write_raw(tmp_path / "log.mcap", messages, chunk_size=1000, **options))
    assert [record.stamp_ns for record in log.records(Truth)] == [i * 10**8 for i in range(50)]
    assert sum(count for _, count in log.sources) == 50
    assert log.warnings == ()


def test_a_message_outside_chunks_is_found_in_a_file_that_has_an_index_of_chunks(tmp_path):
    path = write_raw(tmp_path / "log.mcap", [as_raw("/truth", truth(i)) for i in range(3)])
    content = path.read_bytes()
    opcode, length, summary, offsets, _ = struct.unpack("<BQQQI", content[-37:-8])
    at = summary - 13  # before DataEnd
    data = encode(truth(3))
    loose = struct.pack("<BQHIQQ", Opcode.MESSAGE, 22 + len(data), 1, 3, 3 * 10**8, 3 * 10**8) + data
    footer = struct.pack("<BQQQI", opcode, length, summary + len(loose), offsets + len(loose), 0)
    path.write_bytes(content[:at] + loose + content[at:-37] + footer + content[-8:])
    assert [record.stamp_ns // 10**8 for record in LogFile(path).records(Truth)] == [0, 1, 2, 3]


@needs_shared
def test_every_official_conformance_file_is_read_in_full(tmp_path):
    with tarfile.open(SHARED / "mcap_conformance.tar.gz") as archive:
        archive.extractall(tmp_path, filter="data")
    paths = sorted(tmp_path.rglob("*.mcap"))
    assert len(paths) == 416
    for path in paths:
        kinds = [record["type"] for record in json.loads(path.with_suffix(".json").read_text())["records"]]
        log = LogFile(path)
        assert len(list(log.log_times())) == sum(n for _, n in log.sources) == kinds.count("Message"), path.name
        assert len(log.metadata) == kinds.count("Metadata"), path.name
        assert log.warnings == (), path.name


@needs_shared
@pytest.mark.parametrize("path", sorted(SHARED.glob("*.mcap")), ids=lambda path: path.name)
def test_a_ros_2_bag_names_its_topics_instead_of_failing_strangely(path):
    with path.open("rb") as file:
        expected = sorted(m.log_time for _, _, m in NonSeekingReader(file).iter_messages())
    log = LogFile(path)
    assert [time_ns for _, time_ns in log.log_times()] == expected
    with pytest.raises(FieldlocError, match=r"no topic that fieldloc understands; it holds .*msg"):
        log.messages()


# What is not a log


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (None, "no such file"),
        (b"", "empty"),
        (b"stamp,x,y\n0,1,2\n", "not an MCAP file"),
        (bytes(1000), "not an MCAP file"),
        (b"\x89MCAP", "cut off within its first 8 bytes"),
    ],
)
def test_what_is_not_an_mcap_file_is_said_in_one_line(tmp_path, content, complaint):
    path = tmp_path / "log.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FieldlocError, match=complaint) as error:
        LogFile(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_a_directory_is_not_a_log(tmp_path):
    with pytest.raises(FieldlocError, match="is a directory"):
        LogFile(tmp_path)


def test_a_pipe_is_not_a_log():
    reading, writing = os.pipe()
    try:
        os.write(writing, b"\x89MCAP0\r\n")
        with pytest.raises(FieldlocError, match="a pipe, save it to a file first"):
            LogFile(f"/dev/fd/{reading}")
    finally:
        os.close(reading)
        os.close(writing)


def test_a_log_without_messages_says_so(tmp_path):
    log = LogFile(write_log(tmp_path / "log.mcap", count=0))
    assert [m.topic for m in log.messages()] == ["/field"]
    with pytest.raises(FieldlocError, match=r"no messages on /odometry; it holds /field"):
        log.messages(["/odometry"])
    with pytest.raises(FieldlocError, match="holds no messages"):
        LogFile(write_raw(tmp_path / "none.mcap", [])).messages()


@pytest.mark.parametrize(
    ("schema", "encoding", "complaint"),
    [
        ("fieldloc.Truth.v1", "json", r"/odometry carries fieldloc\.Truth\.v1 \(json\), needs fieldloc\.Odometry\.v1"),
        ("fieldloc.Odometry.v1", "cbor", r"/odometry carries fieldloc\.Odometry\.v1 \(cbor\), needs"),
        ("fieldloc.Odometry.v2", "json", r"/odometry carries fieldloc\.Odometry\.v2, .*update fieldloc"),
    ],
)
def test_a_topic_of_a_wrong_type_is_refused_when_it_is_asked_for(tmp_path, schema, encoding, complaint):
    path = tmp_path / "log.mcap"
    write_raw(path, [as_raw("/truth", truth(0)), ("/odometry", schema, encoding, 0, encode(truth(0)))])
    log = LogFile(path)
    for read in (log.messages, lambda: log.records(Odometry), lambda: log.messages(["/odometry"])):
        with pytest.raises(FieldlocError, match=complaint):
            read()
    assert len(list(log.records(Truth))) == 1


# Bad messages


def test_bad_messages_are_left_out_and_counted_and_the_rest_is_read(tmp_path):
    good = json.loads(encode(odometry(3)))
    bad = [
        json.dumps({**good, "forward_mps": float("nan")}).encode(),
        json.dumps({**good, "forward_mps": float("-inf")}).encode(),
        json.dumps({**good, "covariance": [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]}).encode(),
        json.dumps({k: v for k, v in good.items() if k != "turn_radps"}).encode(),
        b"\x00garbage",
    ]
    messages = [as_raw("/odometry", odometry(i)) for i in range(10)]
    messages[4:4] = [("/odometry", "fieldloc.Odometry.v1", "json", 4 * 10**8, data) for data in bad]
    log = LogFile(write_raw(tmp_path / "log.mcap", messages))
    for _ in range(2):  # reading again does not count again
        assert [r.stamp_ns for r in log.records(Odometry)] == [i * 10**8 for i in range(10)]
        (warning,) = log.warnings
        assert "5 of 15 messages left out" in warning
        assert "/odometry at 0.3 s: forward_mps is NaN" in warning


@given(
    value=st.sampled_from([float("nan"), float("inf"), None, "1", True, [], {}]),
    place=st.sampled_from(["range_m", "bearing_rad"]),
)
@settings(deadline=None, max_examples=20)
def test_a_scan_with_an_observation_that_is_no_number_is_left_out(tmp_path_factory, value, place):
    scan = LandmarkScan(10, ("7", "7"), np.ones((2, 2)), np.array([np.eye(2)] * 2))
    message = json.loads(encode(scan))
    message["landmarks"][1][place] = value
    raw = [
        as_raw("/landmarks", scan),
        ("/landmarks", "fieldloc.LandmarkScan.v1", "json", 20, json.dumps(message).encode()),
    ]
    log = LogFile(write_raw(tmp_path_factory.mktemp("log") / "log.mcap", raw))
    assert len(list(log.records(LandmarkScan))) == 1
    assert f"1 of 2 messages left out, the first: /landmarks at 0.00000001 s: landmarks[1].{place}" in log.warnings[0]


# Damage


def outcome(read):
    """What `read` returns, or nothing and the one line that it raises."""
    try:
        return read(), ""
    except FieldlocError as error:
        return [], str(error)


def cut(path, length):
    out = path.with_name("cut.mcap")
    out.write_bytes(path.read_bytes()[:length])
    return out


@pytest.mark.parametrize("chunked", [True, False])
def test_wherever_a_file_is_cut_every_whole_chunk_or_record_before_the_cut_is_read(tmp_path, chunked):
    path = tmp_path / "log.mcap"
    write_raw(path, [as_raw("/truth", truth(i)) for i in range(120)], chunk_size=2000, use_chunking=chunked)
    size = path.stat().st_size
    blocks = McapContainer(path)._contents.blocks
    whole = {block.end: block.last_ns // 10**8 + 1 for block in blocks}
    rng = random.Random(5)
    for length in sorted({9, 50, *(rng.randrange(9, size) for _ in range(150)), size - 1}):
        log = LogFile(cut(path, length))
        stamps, error = outcome(lambda log=log: [message.record.stamp_ns for message in log.messages()])
        assert not error or "holds no messages; " in error
        assert stamps == [i * 10**8 for i in range(len(stamps))]
        assert len(stamps) >= max((n for end, n in whole.items() if end <= length), default=0)
        (warning,) = log.warnings
        assert "cut off" in warning
        if 0 < len(stamps) < 120:
            assert f"{len(stamps)} message" in warning
            assert f"up to {(len(stamps) - 1) / 10} s" in warning


def test_a_log_cut_before_its_first_message_says_so(tmp_path):
    path = write_log(tmp_path / "log.mcap", count=100)
    with pytest.raises(FieldlocError, match=r"holds no messages; cut off .* before its first whole message"):
        LogFile(cut(path, 200)).messages()


def test_a_log_that_only_lost_its_index_is_read_in_full(tmp_path):
    path = write_log(tmp_path / "log.mcap", count=100)
    log = LogFile(cut(path, path.stat().st_size - 10))
    assert len(list(log.messages())) == 201
    assert "all 201 messages are there" in log.warnings[0]


def test_a_chunk_whose_bytes_were_changed_is_left_out_with_a_warning(tmp_path):
    path = write_log(tmp_path / "log.mcap", chunk_messages=100)
    block = McapContainer(path)._contents.blocks[1]
    content = bytearray(path.read_bytes())
    content[(block.start + block.end) // 2] ^= 0x10
    path.write_bytes(content)
    log = LogFile(path)
    stamps = [record.stamp_ns // 10**8 for record in log.records(Odometry)]
    assert stamps == [*range(100), *range(200, 400)]
    (warning,) = log.warnings
    assert warning.startswith(f"{path}: 1 damaged chunk left out")
    assert warning.endswith("9.9 s missing, from 10.0 s on, 200 messages")
    content = content[:-8]  # and now without the index
    path.write_bytes(content)
    log = LogFile(path)
    assert [record.stamp_ns // 10**8 for record in log.records(Odometry)] == stamps
    assert any(w.endswith("9.9 s missing, from 10.0 s on, 200 messages") for w in log.warnings)


def test_flipped_bits_never_give_a_traceback_a_wrong_message_or_silence(tmp_path):
    path = write_log(tmp_path / "log.mcap", count=60, chunk_messages=20)
    content = path.read_bytes()
    whole = [(m.topic, m.log_time_ns, encode(m.record)) for m in read_log(path)]
    rng = random.Random(7)
    for _ in range(150):
        damaged = bytearray(content)
        damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        messages, error = outcome(lambda: [(m.topic, m.log_time_ns, encode(m.record)) for m in read_log(path)])
        assert "\n" not in error
        assert set(messages) <= set(whole)
        if len(messages) < len(whole) and not error:
            log = LogFile(path)
            list(log.messages())
            assert log.warnings


def test_damage_to_the_index_costs_no_message(tmp_path):
    path = write_log(tmp_path / "log.mcap", count=30, chunk_messages=10)
    content = path.read_bytes()
    whole = [(m.topic, m.log_time_ns, encode(m.record)) for m in read_log(path)]
    summary = struct.unpack("<BQQQI", content[-37:-8])[2]
    for place in range(summary, len(content), 7):
        path.write_bytes(content[:place] + bytes([content[place] ^ 0x04]) + content[place + 1 :])
        assert [(m.topic, m.log_time_ns, encode(m.record)) for m in read_log(path)] == whole


def test_a_record_that_claims_to_be_huge_is_not_believed(tmp_path):
    path = write_log(tmp_path / "log.mcap", count=10)
    path.write_bytes(path.read_bytes()[:200] + struct.pack("<BQ", 6, 2**62) + bytes(100))
    assert "cut off" in LogFile(path).warnings[0]


def test_a_log_is_read_as_it_is_needed(tmp_path, monkeypatch):
    path = write_log(tmp_path / "log.mcap", count=400, chunk_messages=20)
    read = []
    monkeypatch.setattr(mcap_container, "read_chunk", lambda *at, check: read.append(at) or chunks.read_chunk(*at))
    messages = LogFile(path).messages()
    for _ in range(45):  # the 41 of the first chunk (the map is in it) and 4 of the second
        next(messages)
    assert len(read) == 2
    assert len(list(messages)) == 801 - 45
    assert len(read) == 20
