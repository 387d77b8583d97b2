"""Parts of logs, and what a part needs of what was said before it."""

import tracemalloc

import edit_logs
import mcap.reader
import numpy as np
import pytest
from edit_logs import IMU, INFO, PLAIN, ROBOT, TF, TF_STATIC, S, contents, datas, imu, times, write

from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.field import load_field
from fieldloc.measurements import Compass, InitialPose, Truth
from logs.edit import cut
from logs.reader import LogFile
from logs.reader.container import open_container
from logs.source import Attachment, RawMessage, Source
from logs.writer import LogWriter

FILES = [Attachment("a.txt", "text/plain", 5, 6, b"abc"), Attachment("b.bin", "", 7, 0, b"\x00" * 1000)]
NOTES = [("fieldloc", {"version": "0.0.7", "estimator": "ekf"}), ("of mine", {"who": "me"})]


@pytest.fixture
def log(tmp_path):
    messages = sorted([*imu(), *imu(20, S // 2, TF), *imu(10, S, PLAIN)], key=lambda message: message[1])
    return write(tmp_path / "log.mcap", messages, NOTES, FILES)


def test_a_cut_of_everything_is_a_copy(log, tmp_path):
    summary = cut(log, tmp_path / "out.mcap")
    assert contents(tmp_path / "out.mcap") == contents(log)
    out = open_container(tmp_path / "out.mcap")
    assert dict(out.metadata) == dict(NOTES)
    assert [*out.attachments()] == FILES
    assert summary.counts == {"/anything": 10, "/imu": 100, "/tf": 20}
    assert (summary.messages, summary.attachments, summary.lost, summary.notes) == (130, 2, (), ())
    assert summary.span_ns == (0, 99 * S // 10)


def test_a_cut_is_the_messages_from_its_start_to_before_its_end(log, tmp_path):
    summary = cut(log, tmp_path / "out.mcap", 2 * S, 4 * S)
    assert contents(tmp_path / "out.mcap") == [m for m in contents(log) if 2 * S <= m[1] < 4 * S]
    assert summary.span_ns == (2 * S, 39 * S // 10)
    assert times(tmp_path / "out.mcap", "/anything") == [2 * S, 3 * S]


@pytest.mark.parametrize(
    ("topics", "without", "kept"),
    [
        (["/imu"], [], {"/imu"}),
        (["/imu", "/tf"], [], {"/imu", "/tf"}),
        (["/t*"], [], {"/tf"}),
        (None, ["/imu"], {"/tf", "/anything"}),
        (None, ["/[it]*"], {"/anything"}),
        (["/imu", "/tf"], ["/tf"], {"/imu"}),
    ],
)
def test_topics_are_chosen_by_name_or_pattern(log, tmp_path, topics, without, kept):
    cut(log, tmp_path / "out.mcap", None, None, topics, without)
    assert contents(tmp_path / "out.mcap") == [m for m in contents(log) if m[0][0] in kept]


@pytest.mark.parametrize("options", [{"topics": ["/imu", "/odom"]}, {"without": ["/odom"]}, {"topics": ["/x/*"]}])
def test_a_topic_that_is_not_there_is_told_with_those_that_are(log, tmp_path, options):
    with pytest.raises(FieldlocError, match=r"log\.mcap: no topic /(odom|x/\*); there are: /anything, /imu, /tf$"):
        cut(log, tmp_path / "out.mcap", **options)
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize(
    ("start_ns", "end_ns", "said"),
    [
        (100 * S, None, "from 100.0 s on these topics; it goes from 0.0 s to 9.9 s"),
        (4 * S, 2 * S, "from 4.0 s before 2.0 s"),
        (None, 0, "before 0.0 s"),
    ],
)
def test_a_cut_with_nothing_in_it_says_what_there_is(log, tmp_path, start_ns, end_ns, said):
    with pytest.raises(FieldlocError, match=said):
        cut(log, tmp_path / "out.mcap", start_ns, end_ns)
    assert not (tmp_path / "out.mcap").exists()


def test_a_log_is_never_cut_into_itself(log, tmp_path):
    before = log.read_bytes()
    (tmp_path / "link.mcap").symlink_to(log)
    for out in (log, tmp_path / "link.mcap"):
        with pytest.raises(FieldlocError, match="is what is read"):
            cut(log, out)
    assert log.read_bytes() == before


def test_static_transforms_from_before_the_start_are_carried_over(tmp_path):
    static = [(TF_STATIC, 0, b"camera", 0, 1), (TF_STATIC, 1, b"imu", 1, 2), (TF_STATIC, S, b"camera", S, 3)]
    log = write(tmp_path / "log.mcap", sorted([*imu(), *static, (TF_STATIC, 6 * S, b"late")], key=lambda m: m[1]))
    summary = cut(log, tmp_path / "out.mcap", 5 * S)
    found = [m[1:] for m in contents(tmp_path / "out.mcap") if m[0][0] == "/tf_static"]
    assert found == [(5 * S, 1, 2, b"imu"), (5 * S, S, 3, b"camera"), (6 * S, 6 * S, 0, b"late")]
    assert contents(tmp_path / "out.mcap")[0][0][0] == "/tf_static"
    assert summary.notes == ("carried over from before the start: /tf_static",)


def test_what_was_left_out_is_not_carried_over(tmp_path):
    log = write(tmp_path / "log.mcap", [(TF_STATIC, 0, b"camera"), *imu()])
    for options in ({"topics": ["/imu"]}, {"without": ["/tf_static"]}):
        summary = cut(log, tmp_path / "out.mcap", 5 * S, **options)
        assert summary.counts == {"/imu": 50}
        assert summary.notes == ()


def test_nothing_is_carried_over_to_a_start_that_is_not_given(tmp_path):
    log = write(tmp_path / "log.mcap", [(TF_STATIC, 0, b"camera"), *imu()])
    cut(log, tmp_path / "out.mcap", None, 5 * S)
    assert times(tmp_path / "out.mcap", "/tf_static") == [0]


@pytest.mark.parametrize("source", [INFO, ROBOT, edit_logs.LATCHED], ids=lambda source: source.topic)
def test_the_last_of_what_is_said_once_is_carried_over(tmp_path, source):
    log = write(tmp_path / "log.mcap", [(source, 0, b"old"), (source, 1, b"new"), *imu()[1:], (source, 8 * S, b"next")])
    cut(log, tmp_path / "out.mcap", 5 * S)
    assert datas(tmp_path / "out.mcap", source.topic) == [b"new", b"next"]
    assert times(tmp_path / "out.mcap", source.topic) == [5 * S, 8 * S]


def test_what_is_said_again_and_again_needs_no_help(tmp_path):
    log = write(tmp_path / "log.mcap", sorted([*imu(), *imu(300, S // 30, INFO)], key=lambda m: m[1]))
    summary = cut(log, tmp_path / "out.mcap", 5 * S + 1)
    assert min(times(tmp_path / "out.mcap", INFO.topic)) > 5 * S + 1
    assert summary.notes == ()


def test_ordinary_topics_are_not_carried_over(tmp_path):
    log = write(tmp_path / "log.mcap", [(TF, 0, b"x"), (PLAIN, 0, b"x"), (IMU, 0, b"x"), *imu(10, first=5 * S)])
    cut(log, tmp_path / "out.mcap", 5 * S)
    assert {m[0][0] for m in contents(tmp_path / "out.mcap")} == {"/imu"}


def test_the_map_and_the_camera_in_force_are_carried_over_and_the_initial_pose_is_not(tmp_path):
    def camera(width_px):
        return Camera("pinhole", width_px, 480, 500.0, 500.0, 320.0, 240.0)

    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/field", load_field("kidsize"), 0)
        log.write("/initial_pose", InitialPose(0, np.zeros(3), np.eye(3)))
        log.write("/camera", camera(640), 0)
        log.write("/camera", camera(641), 2 * S)
        log.write("/camera", camera(642), 5 * S + S // 2)
        for i in range(100):
            log.write("/truth", Truth(i * S // 10, np.zeros(3)))
    summary = cut(tmp_path / "log.mcap", tmp_path / "out.mcap", 5 * S)
    out = LogFile(tmp_path / "out.mcap")
    assert out.field_map().name == load_field("kidsize").name
    assert [c.width_px for c in out.records(Camera)] == [641, 642]
    assert not out.has(InitialPose)
    assert len([*out.records(Truth)]) == 50
    assert summary.notes == ("carried over from before the start: /camera, /field",)
    cut(tmp_path / "log.mcap", tmp_path / "again.mcap", 5 * S + S // 2)
    assert [c.width_px for c in LogFile(tmp_path / "again.mcap").records(Camera)] == [642]


def test_endless_static_transforms_do_not_fill_the_memory(tmp_path):
    messages = [(TF_STATIC, i, b"%d" % i) for i in range(3000)]
    log = write(tmp_path / "log.mcap", [*messages, *imu(10, first=5000)])
    cut(log, tmp_path / "out.mcap", 4000)
    assert datas(tmp_path / "out.mcap", "/tf_static") == [b"%d" % i for i in range(2000, 3000)]


def test_messages_at_one_time_stay_in_their_order(tmp_path):
    messages = [
        (source, t, b"%d %d" % (t, i)) for t in (1, 2) for i, source in enumerate([TF, IMU, PLAIN, IMU, TF] * 9)
    ]
    log = write(tmp_path / "log.mcap", messages)
    cut(log, tmp_path / "out.mcap", 1, 3)
    assert [m[4] for m in contents(tmp_path / "out.mcap")] == [data for _, _, data in messages]


def test_a_log_of_another_format_becomes_mcap(tmp_path):
    told = [(IMU, RawMessage(3, 10 * i, 10 * i + 1, i, b"%d" % i)) for i in range(9)]
    fake = edit_logs.Fake(tmp_path / "bag", told, ("it was cut off",), {"m": {"a": "b"}})
    summary = cut(fake, tmp_path / "out.mcap", 20, 60)
    assert [m[1:] for m in contents(tmp_path / "out.mcap")] == [(10 * i, 10 * i + 1, i, b"%d" % i) for i in range(2, 6)]
    assert contents(tmp_path / "out.mcap")[0][0] == edit_logs.key(IMU)
    assert summary.lost == ("it was cut off",)
    assert summary.attachments == 1


def test_times_that_mcap_cannot_hold_are_told_with_their_topic(tmp_path):
    fake = edit_logs.Fake(tmp_path / "bag", [(IMU, RawMessage(3, -5, 0, 0, b""))])
    with pytest.raises(FieldlocError, match=r"bag: /imu: times -5, 0 .*leave the topic out"):
        cut(fake, tmp_path / "out.mcap")
    assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize(
    ("sources", "profile"),
    [
        ([IMU, TF], "ros2"),
        ([Source("/a", "cdr", "a/msg/A", "ros2idl", b"x"), IMU], "ros2"),
        ([edit_logs.LATCHED], "ros1"),
        ([IMU, edit_logs.LATCHED], ""),
        ([PLAIN], ""),
    ],
)
def test_the_profile_says_what_robots_the_whole_file_is_of(tmp_path, sources, profile):
    log = write(tmp_path / "log.mcap", [(source, 1, b"x") for source in sources])
    cut(log, tmp_path / "out.mcap")
    with (tmp_path / "out.mcap").open("rb") as file:
        assert mcap.reader.make_reader(file).get_header().profile == profile


def test_progress_goes_from_the_start_to_the_end(tmp_path):
    log = write(tmp_path / "log.mcap", imu(9000, S // 100))
    seen = []
    cut(log, tmp_path / "out.mcap", 10 * S, 80 * S, progress=lambda done, total, doing="": seen.append((done, total)))
    assert len(seen) >= 3
    assert seen == sorted(seen)
    assert all(0 <= done <= total == 70 * 1000 + 1 for done, total in seen)


def test_only_what_is_asked_for_fills_the_memory(tmp_path):
    """A hundred megabytes pass through; tracemalloc sees a few of them at once."""
    log = write(tmp_path / "log.mcap", ((IMU, i, bytes(200_000)) for i in range(500)))
    tracemalloc.start()
    try:
        cut(log, tmp_path / "out.mcap", 100)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


def test_compass_messages_are_copied_to_the_byte(tmp_path):
    with LogWriter(tmp_path / "log.mcap", {"source": "me"}) as log:
        log.write("/compass", Compass(3, 0.1, 0.2), 7)
    cut(tmp_path / "log.mcap", tmp_path / "out.mcap")
    assert contents(tmp_path / "log.mcap") == contents(tmp_path / "out.mcap")
    assert LogFile(tmp_path / "out.mcap").metadata == LogFile(tmp_path / "log.mcap").metadata
