"""An MCAP file that is whole, against mcap's own reader."""

import itertools
import json
import random
import struct
import tarfile

import mcap.writer
import mcap_files
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_files import DEFINED, END, SHARED, chunk, chunk_of, message, metadata, put, schema, written

from fieldloc.errors import FieldlocError
from fieldloc.measurements import Odometry
from logs.reader import mcap_container
from logs.reader.chunks import read_chunk
from logs.reader.container import open_container
from logs.reader.mcap_container import McapContainer
from logs.writer import LogWriter

needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason=f"{SHARED} is missing: other people's MCAP files")
NONE = mcap.writer.IndexType.NONE
WRITERS = [
    {},
    {"use_chunking": False},
    {"index_types": NONE},
    {"repeat_channels": False},
    {"repeat_schemas": False},
    {"use_statistics": False},
    {"use_statistics": False, "index_types": NONE, "repeat_channels": False, "repeat_schemas": False},
    {"use_summary_offsets": False},
    {"compression": mcap.writer.CompressionType.NONE},
    {"compression": mcap.writer.CompressionType.LZ4},
    {"enable_crcs": False},
    {"enable_data_crcs": True},
]


@pytest.fixture
def chunks_read(monkeypatch):
    """Where each chunk begins that is unpacked for its messages."""
    places = []

    def read(file, start, end, check):
        places.append(start)
        return read_chunk(file, start, end, check=check)

    monkeypatch.setattr(mcap_container, "read_chunk", read)
    return places


@pytest.mark.parametrize("options", WRITERS, ids=str)
@pytest.mark.parametrize("seed", range(3))
def test_messages_are_those_that_mcap_reads_in_the_order_of_log_time(tmp_path, options, seed):
    rng = random.Random(seed)
    path = written(tmp_path / "log.mcap", rng, chunk_size=rng.choice([1, 300, 2000]), **options)
    container = McapContainer(path)
    expected = mcap_files.by_mcap(path)
    assert list(container.messages(container.sources)) == expected
    assert container.span_ns == (expected[0].log_time_ns, expected[-1].log_time_ns)
    assert container.counts == {n: sum(raw.channel == n for raw in expected) for n in container.sources}
    assert container.damage == ()
    channels, schemas, records, attachments = mcap_files.definitions_by_mcap(path)
    assert container.metadata == records == {"m": {"a": "b"}}
    assert [a.data for a in container.attachments()] == [a.data for a in attachments] == [b"data"]
    for number, source in container.sources.items():
        found = schemas.get(channels[number].schema_id)
        assert (source.topic, source.message_encoding) == (channels[number].topic, "json")
        assert (source.schema_name, source.schema_data) == ((found.name, found.data) if found else ("", b""))


@given(data=st.data())
@settings(deadline=None, max_examples=60)
def test_a_span_of_some_channels_is_what_mcap_reads_of_it(tmp_path_factory, data):
    instants = data.draw(st.sampled_from([st.integers(0, 20), st.just(7), st.integers(2**64 - 5, 2**64 - 1)]))
    times = data.draw(st.lists(instants, min_size=1, max_size=60))
    path = written(
        tmp_path_factory.mktemp("log") / "log.mcap",
        random.Random(0),
        count=len(times),
        times=times.__getitem__,
        chunk_size=data.draw(st.integers(50, 2000)),
        use_chunking=data.draw(st.booleans()),
    )
    container = McapContainer(path)
    channels = data.draw(st.sets(st.sampled_from([1, 2, 3, 4])))
    start, end = (data.draw(st.none() | instants | st.just(-1) | st.just(2**64)) for _ in range(2))
    expected = [
        raw
        for raw in mcap_files.by_mcap(path, channels)
        if (start is None or start <= raw.log_time_ns) and (end is None or raw.log_time_ns < end)
    ]
    assert list(container.messages(channels, start, end)) == expected


@needs_shared
def test_every_official_conformance_file_is_read_in_full(tmp_path):
    with tarfile.open(SHARED / "mcap_conformance.tar.gz") as archive:
        archive.extractall(tmp_path, filter="data")
    paths = sorted(tmp_path.rglob("*.mcap"))
    assert len(paths) == 416
    for path in paths:
        kinds = [record["type"] for record in json.loads(path.with_suffix(".json").read_text())["records"]]
        container = open_container(path)
        read = list(container.messages(container.sources))
        assert len(read) == sum(container.counts.values()) == kinds.count("Message"), path.name
        assert read == mcap_files.by_mcap(path), path.name
        assert len(container.metadata) == kinds.count("Metadata"), path.name
        assert len(list(container.attachments())) == kinds.count("Attachment"), path.name
        assert container.damage == (), path.name


@needs_shared
@pytest.mark.parametrize("path", sorted(SHARED.glob("*.mcap")), ids=lambda path: path.name)
def test_ros_2_bags_are_read_as_mcap_reads_them(path):
    read, damage = mcap_files.messages(path)
    assert read == mcap_files.by_mcap(path)
    assert damage == ()


def test_only_the_chunks_of_a_span_are_unpacked(tmp_path, chunks_read):
    parts = [chunk_of(range(100 * i, 100 * i + 100)) for i in range(10)]
    path = put(tmp_path / "log.mcap", DEFINED, *parts, END)
    assert mcap_files.times(path, 250, 420) == list(range(250, 420))
    assert len(chunks_read) == 3
    chunks_read.clear()
    assert mcap_files.times(path, 300, 400) == list(range(300, 400))
    assert len(chunks_read) == 1


@pytest.mark.parametrize("options", [{}, {"use_statistics": False}], ids=["by the summary", "without one"])
def test_only_the_chunks_of_the_wanted_channels_are_unpacked(tmp_path, chunks_read, options):
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        log = mcap.writer.Writer(file, **options)
        log.start()
        numbers = [log.register_channel(f"/t{i}", "json", 0) for i in range(5)]
        for i, number in enumerate(numbers * 2):
            log.add_message(number, i, b"", i)
            log.flush()
        log.finish()
    container = McapContainer(path)
    assert [raw.log_time_ns for raw in container.messages([numbers[3]])] == [3, 8]
    assert len(chunks_read) == 2


def test_chunks_are_unpacked_when_they_are_due(tmp_path, chunks_read):
    path = put(tmp_path / "log.mcap", DEFINED, *(chunk_of(range(10 * i, 10 * i + 10)) for i in range(20)), END)
    container = McapContainer(path)
    read = container.messages(container.sources)
    assert [raw.log_time_ns for raw in itertools.islice(read, 12)] == list(range(12))
    assert len(chunks_read) == 2
    assert len(list(read)) == 188
    assert len(chunks_read) == 20


def test_publish_time_sequence_and_data_are_kept(tmp_path):
    content = message(5, data=b"", sequence=2**32 - 1, publish_time_ns=2**64 - 1) + message(2**64 - 1, data=b"\0\xff")
    path = put(tmp_path / "log.mcap", DEFINED, chunk(content), END)
    assert mcap_files.messages(path) == ([(1, 5, 2**64 - 1, 2**32 - 1, b""), (1, 2**64 - 1, 0, 0, b"\0\xff")], ())


def test_a_message_outside_chunks_is_found_in_a_file_that_has_an_index_of_chunks(tmp_path):
    path = written(tmp_path / "log.mcap", random.Random(0), times=lambda i: i)
    content = path.read_bytes()
    opcode, length, summary, offsets, _ = struct.unpack("<BQQQI", content[-37:-8])
    at = summary - 13  # before DataEnd
    loose = message(1000)
    footer = struct.pack("<BQQQI", opcode, length, summary + len(loose), offsets + len(loose), 0)
    path.write_bytes(content[:at] + loose + content[at:-37] + footer + content[-8:])
    assert mcap_files.times(path) == [*range(200), 1000]


def test_messages_larger_than_a_piece_of_the_file_are_read_whole(tmp_path):
    big = random.Random(0).randbytes(700_000)
    path = put(tmp_path / "log.mcap", DEFINED, message(1), message(2, data=big), message(3, data=big), END)
    read, damage = mcap_files.messages(path)
    assert [(raw.log_time_ns, len(raw.data)) for raw in read] == [(1, 0), (2, 700_000), (3, 700_000)]
    assert damage == ()


def test_a_chunk_may_end_in_padding_and_other_programs_records_are_passed_over(tmp_path):
    private = mcap_files.record(200, b"anything")
    content = message(1) + private + message(2)
    path = put(tmp_path / "log.mcap", DEFINED, private, chunk(content), private, metadata("m", a="b"), message(3), END)
    assert mcap_files.times(path) == [1, 2, 3]
    assert McapContainer(path).metadata == {"m": {"a": "b"}}
    assert McapContainer(path).damage == ()


def test_a_number_that_is_given_twice_means_what_it_meant_first(tmp_path):
    again = mcap_files.channel(1, topic="/other")
    path = put(tmp_path / "log.mcap", DEFINED, message(1), again, schema(1, "other"), message(2), END)
    container = McapContainer(path)
    assert [(source.topic, source.schema_name) for source in container.sources.values()] == [("/t", "s")]
    assert len(list(container.messages([1]))) == 2
    assert container.damage == ("1 channel defined in two ways: the first holds",)
    assert McapContainer(put(path, DEFINED, DEFINED[len(mcap_files.HEADER) :], message(1), END)).damage == ()


def test_messages_that_no_channel_is_defined_for_are_counted_and_left_out(tmp_path):
    path = put(tmp_path / "log.mcap", DEFINED, message(1), message(2, number=7), message(3, number=7), END)
    container = McapContainer(path)
    assert [raw.log_time_ns for raw in container.messages([1, 7])] == [1]
    assert container.counts == {1: 1}
    assert container.damage == ("2 messages left out: no channel that can be read is theirs",)


def test_a_disk_that_cannot_be_read_is_one_line(tmp_path, monkeypatch):
    def fail(*arguments):
        raise OSError(5, "Input/output error")

    container = McapContainer(put(tmp_path / "log.mcap", DEFINED, message(1), END))
    monkeypatch.setattr(mcap_container, "walk", fail)
    with pytest.raises(FieldlocError, match=r"log.mcap: cannot be read: Input/output error"):
        list(container.messages([1]))


def test_nothing_is_kept_open_between_calls(tmp_path):
    path = put(tmp_path / "log.mcap", DEFINED, chunk_of(range(50)), END)
    container = McapContainer(path)
    next(container.messages([1]))  # warnings are errors: an open file would fail this test
    path.unlink()
    with pytest.raises(FieldlocError, match="cannot be read: No such file"):
        list(container.messages([1]))


def test_a_folder_without_rosbag2_s_index_is_a_bag_if_it_holds_one_recording(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    for part in (0, 1):
        with LogWriter(folder / f"match_{part}.mcap") as log:
            log.write("/odometry", Odometry(10**9 * (part + 1), np.zeros(3)))
    assert sum(open_container(folder).counts.values()) == 2
    with LogWriter(folder / "other_0.mcap") as log:
        log.write("/odometry", Odometry(10**9, np.zeros(3)))
    with pytest.raises(FieldlocError, match="is a directory"):
        open_container(folder)
