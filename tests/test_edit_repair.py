"""Whole files out of what is left of some."""

import random

import edit_logs
import mcap.reader
import pytest
from edit_logs import IMU, PLAIN, TF, S, contents, imu, write

from fieldloc.errors import FieldlocError
from logs.edit import repair
from logs.reader.container import open_container
from logs.source import Attachment, RawMessage

FILES = [Attachment("a.txt", "text/plain", 5, 6, b"abc")]
NOTES = [("fieldloc", {"version": "0.0.7"})]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    rng = random.Random(2)
    messages = sorted([*imu(6000, S // 100), *imu(500, S // 8, TF)], key=lambda message: message[1])
    messages = [(source, time, data + rng.randbytes(300), *rest) for source, time, data, *rest in messages]
    return write(tmp_path_factory.mktemp("logs") / "log.mcap", messages, NOTES, FILES)


def by_mcap(path):
    """What mcap's own reader, which wants a whole file, finds by the index, all checksums checked."""
    with path.open("rb") as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True)
        assert reader.get_summary().statistics is not None
        found = [(c.topic, m.log_time, m.publish_time, m.sequence, m.data) for _, c, m in reader.iter_messages()]
        assert reader.get_summary().statistics.message_count == len(found)
    return found


def test_a_whole_log_needs_no_repair_and_is_copied(log, tmp_path):
    summary = repair(log, tmp_path / "out.mcap")
    assert summary.lost == ()
    assert contents(tmp_path / "out.mcap") == contents(log)
    assert by_mcap(tmp_path / "out.mcap") == by_mcap(log)
    out = open_container(tmp_path / "out.mcap")
    assert (dict(out.metadata), [*out.attachments()]) == (dict(NOTES), FILES)


def test_of_a_log_that_was_cut_off_all_is_kept_that_can_be_read(log, tmp_path):
    whole = log.read_bytes()
    rng = random.Random(3)
    for size in [len(whole) - 1, len(whole) - 100, *(rng.randrange(3000, len(whole)) for _ in range(12))]:
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(whole[:size])
        summary = repair(cut, tmp_path / "out.mcap")
        assert cut.read_bytes() == whole[:size]
        assert contents(tmp_path / "out.mcap") == contents(cut)
        assert len(by_mcap(tmp_path / "out.mcap")) == summary.messages == len(contents(cut))
        assert summary.lost == open_container(cut).damage
        assert len(summary.lost) > 0
        assert open_container(tmp_path / "out.mcap").damage == ()


def test_what_is_in_a_broken_chunk_is_told_by_topic(log, tmp_path):
    data = bytearray(log.read_bytes())
    data[len(data) // 2] ^= 0xFF
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(data)
    summary = repair(broken, tmp_path / "out.mcap")
    told = " ".join(summary.lost)
    missing = len(contents(log)) - summary.messages
    assert 0 < missing < 2000
    assert f"/imu: {len(edit_logs.times(log, '/imu')) - summary.counts['/imu']} messages" in told
    assert len(by_mcap(tmp_path / "out.mcap")) == summary.messages
    assert set(contents(tmp_path / "out.mcap")) < set(contents(log))


def test_a_log_without_messages_is_repaired_too(tmp_path):
    log = write(tmp_path / "log.mcap", [], NOTES)
    summary = repair(log, tmp_path / "out.mcap")
    assert (summary.messages, summary.span_ns, summary.lost) == (0, None, ())
    assert dict(open_container(tmp_path / "out.mcap").metadata) == dict(NOTES)


def test_what_an_index_promised_and_the_file_does_not_hold_is_told(tmp_path):
    fake = edit_logs.Fake(tmp_path / "bag", [(IMU, RawMessage(3, i, i, i, b"")) for i in range(5)], ("a hole",))
    fake.promised = {3: 6}
    summary = repair(fake, tmp_path / "out.mcap")
    assert summary.lost == ("a hole", "/imu: 1 message in damaged records")


def test_what_is_no_log_cannot_be_repaired(tmp_path):
    (tmp_path / "x.mcap").write_bytes(b"hello there, I am a text")
    with pytest.raises(FieldlocError, match=r"x\.mcap: not an MCAP file"):
        repair(tmp_path / "x.mcap", tmp_path / "out.mcap")
    with pytest.raises(FieldlocError, match="no such file"):
        repair(tmp_path / "y.mcap", tmp_path / "out.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["x.mcap"]


def test_a_log_is_never_repaired_into_itself(tmp_path):
    log = write(tmp_path / "log.mcap", [(PLAIN, 1, b"x")])
    before = log.read_bytes()
    with pytest.raises(FieldlocError, match="is what is read"):
        repair(log, log)
    assert log.read_bytes() == before
