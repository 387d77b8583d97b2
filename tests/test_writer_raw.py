"""Messages as they are, files and metadata; and what of an unfinished file is readable when."""

import random

import mcap.reader
import mcap.writer
import numpy as np
import pytest
from edit_logs import IMU, PLAIN, TF, contents, key

from fieldloc.errors import FieldlocError
from fieldloc.measurements import Truth
from logs.reader.container import open_container
from logs.source import Attachment, Encoded, Source
from logs.writer import LogWriter, stream

FILE = Attachment("a.txt", "text/plain", 5, 6, b"abc")


@pytest.fixture
def clock(monkeypatch):
    """Seconds, which a test sets."""
    now = [100.0]
    monkeypatch.setattr(stream, "monotonic", lambda: now[0])
    return now


def some_messages(count=4000, seed=0):
    rng = random.Random(seed)
    return [
        (rng.choice([IMU, TF, PLAIN]), i * 10, rng.randbytes(rng.randrange(300)), i * 10 - 1, i)
        for i in range(1, count)
    ]


def partial(folder):
    (path,) = folder.glob(".*.partial")
    return path


def test_a_raw_message_comes_back_with_all_that_belongs_to_it(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write_raw(IMU, 10, b"\x00\xff", 7, 3)
        log.write_raw(PLAIN, 11, b"")
        log.add_encoded(Encoded(IMU, 12, b"x"))
    assert contents(tmp_path / "log.mcap") == [
        (key(IMU), 10, 7, 3, b"\x00\xff"),
        (key(PLAIN), 11, 11, 0, b""),
        (key(IMU), 12, 12, 0, b"x"),
    ]


def test_sources_that_say_the_same_are_one_channel_and_others_are_not(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        for i in range(5000):  # more than it remembers by their identity
            log.write_raw(Source("/a", "json", "A", "jsonschema", b"{}", {"who": "me"}), i, b"{}")
        log.write_raw(Source("/a", "json", "A", "jsonschema", b"{}", {"who": "you"}), 5000, b"{}")
        log.write_raw(Source("/a", "json", "A", "jsonschema", b"{ }"), 5001, b"{}")
    container = open_container(tmp_path / "log.mcap")
    assert sorted(container.counts.values()) == [1, 1, 5000]
    with (tmp_path / "log.mcap").open("rb") as file:
        summary = mcap.reader.make_reader(file).get_summary()
    assert len(summary.schemas) == 2
    assert [m[3] for m in contents(tmp_path / "log.mcap")] == [*range(5000), 0, 0]  # each channel counts its own


def test_records_and_raw_messages_of_one_source_are_one_channel(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/truth", Truth(1, np.zeros(3)))
    (source,) = open_container(tmp_path / "log.mcap").sources.values()
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write_raw(source, 0, b"{}")
        log.write("/truth", Truth(1, np.zeros(3)))
        log.write_raw(source, 2, b"{}")
    assert [*open_container(tmp_path / "log.mcap").counts.values()] == [3]


def test_files_and_metadata_come_back(tmp_path):
    with LogWriter(tmp_path / "log.mcap", {"a": "b"}) as log:
        log.write_raw(IMU, 1, b"x")
        log.attach(FILE)
        log.add_metadata("mine", {"k": "ä"})
        log.write_raw(IMU, 2, b"y")
        log.attach(Attachment("b", "", 0, 0, b""))
    container = open_container(tmp_path / "log.mcap")
    assert [*container.attachments()] == [FILE, Attachment("b", "", 0, 0, b"")]
    assert container.metadata["mine"] == {"k": "ä"}
    assert container.metadata["fieldloc"]["a"] == "b"
    with (tmp_path / "log.mcap").open("rb") as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True)
        assert [(a.name, a.data) for a in reader.iter_attachments()] == [("a.txt", b"abc"), ("b", b"")]
        assert [m.name for m in reader.iter_metadata()] == ["fieldloc", "mine"]


def test_a_log_that_is_not_signed_says_nothing_of_its_own(tmp_path):
    with LogWriter(tmp_path / "log.mcap", signed=False):
        pass
    assert open_container(tmp_path / "log.mcap").metadata == {}


def test_a_channel_without_messages_is_in_the_file(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        log.add_source(TF)
        log.write_raw(IMU, 1, b"")
    assert [source.topic for source in open_container(tmp_path / "log.mcap").sources.values()] == ["/tf", "/imu"]


def test_the_file_is_byte_by_byte_what_mcap_s_own_writer_writes(tmp_path):
    with LogWriter(tmp_path / "ours.mcap", {"a": "b"}, profile="ros2") as log:
        log.attach(FILE)
        for message in some_messages():
            log.write_raw(*message)
    container = open_container(tmp_path / "ours.mcap")
    with (tmp_path / "ours.mcap").open("rb") as file:
        header = mcap.reader.make_reader(file).get_header()
    with (tmp_path / "theirs.mcap").open("wb") as file:
        writer = mcap.writer.Writer(file, chunk_size=256 * 1024)
        writer.start(header.profile, header.library)
        writer.add_metadata("fieldloc", dict(container.metadata["fieldloc"]))
        writer.add_attachment(FILE.create_time_ns, FILE.log_time_ns, FILE.name, FILE.media_type, FILE.data)
        schemas, channels = {}, {}
        for source, time, data, published, sequence in some_messages():
            schema = source.schema_name, source.schema_encoding, source.schema_data
            if source.topic not in channels:
                if schema not in schemas:
                    schemas[schema] = writer.register_schema(*schema) if any(schema) else 0
                channels[source.topic] = writer.register_channel(
                    source.topic, source.message_encoding, schemas[schema], dict(source.metadata)
                )
            writer.add_message(channels[source.topic], time, data, published, sequence)
        writer.finish()
    assert (tmp_path / "ours.mcap").read_bytes() == (tmp_path / "theirs.mcap").read_bytes()


def test_its_index_leads_mcap_s_reader_to_every_message(tmp_path):
    messages = some_messages()
    with LogWriter(tmp_path / "log.mcap") as log:
        for message in messages:
            log.write_raw(*message)
    with (tmp_path / "log.mcap").open("rb") as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True)
        assert len(reader.get_summary().chunk_indexes) > 1
        found = [m.data for _, _, m in reader.iter_messages(["/imu"], starting_at=1000, ending_before=30_000)]
    assert found == [data for source, time, data, *_ in messages if source is IMU and 1000 <= time < 30_000]


@pytest.mark.parametrize("seed", range(4))
def test_the_same_calls_give_the_same_bytes_whatever_the_clock_says(tmp_path, clock, seed):
    rng = random.Random(seed)
    for name in ("calm.mcap", "hasty.mcap"):
        with LogWriter(tmp_path / name) as log:
            for i, message in enumerate(some_messages()):
                log.write_raw(*message)
                if i % 1000 == 0:
                    log.attach(FILE)
                if name == "hasty.mcap":
                    clock[0] += rng.choice([0.0, 0.0, 0.1, 2.0]) if i < 3000 else 0.0
                    if i % 777 == 0 or i == 3998:
                        log.keep()
    assert (tmp_path / "calm.mcap").read_bytes() == (tmp_path / "hasty.mcap").read_bytes()


def test_what_is_older_than_a_second_can_be_read_before_the_file_is_finished(tmp_path, clock):
    with LogWriter(tmp_path / "log.mcap") as log:
        for i in range(500):
            log.write_raw(IMU, i, b"%d" % i)
            clock[0] += 0.01
            if i % 50 == 49:
                found = contents(partial(tmp_path))
                assert [m[1] for m in found] == [*range(len(found))]
                assert i - 101 <= len(found) <= i + 1
        log.attach(FILE)  # takes the place of what was kept
        assert len(contents(partial(tmp_path))) == 500
        log.write_raw(IMU, 500, b"")
        log.keep()
        assert len(contents(partial(tmp_path))) == 501
        assert not (tmp_path / "log.mcap").exists()
    assert len(contents(tmp_path / "log.mcap")) == 501


def test_what_is_kept_may_be_longer_than_what_comes_instead(tmp_path):
    """A chunk packs better the longer it is: it may be shorter on disk than its own beginning was."""
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write_raw(IMU, 1, random.Random(1).randbytes(100_000))
        log.keep()
        log._stream._open.parts[-1] = b"\0" * 100_000  # nothing that a caller could do, but nothing to rely on
        log.keep()
    assert contents(tmp_path / "log.mcap")[0][4] == b"\0" * 100_000
    assert open_container(tmp_path / "log.mcap").damage == ()


@pytest.mark.parametrize(
    ("times", "sequence"), [((-1, 0), 0), ((0, -1), 0), ((2**64, 0), 0), ((0, 2**64), 0), ((0, 0), -1), ((0, 0), 2**32)]
)
def test_times_that_an_mcap_file_cannot_hold_are_a_caller_s_mistake(tmp_path, times, sequence):
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write_raw(IMU, 1, b"before")
        with pytest.raises(ValueError, match="MCAP"):
            log.write_raw(IMU, times[0], b"", times[1], sequence)
        log.write_raw(IMU, 2**64 - 1, b"after", 2**64 - 1, 2**32 - 1)
    assert [m[4] for m in contents(tmp_path / "log.mcap")] == [b"before", b"after"]


def test_more_channels_than_mcap_can_number_are_refused(tmp_path, monkeypatch):
    with LogWriter(tmp_path / "log.mcap") as log:
        log._stream._channels = [None] * 0xFFFF
        with pytest.raises(ValueError, match="65535 channels"):
            log.add_source(IMU)
        log._stream._channels = []


def test_a_disk_that_fills_up_while_keeping_is_the_user_s_error(tmp_path, monkeypatch):
    def full(self):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(stream.McapStream, "keep", full)
    with LogWriter(tmp_path / "log.mcap") as log, pytest.raises(FieldlocError, match=r"log\.mcap: .*: No space left"):
        log.keep()
