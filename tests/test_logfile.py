import json
import subprocess
import sys
from pathlib import Path

import mcap.writer
import numpy as np
import pytest
from foreign_parts import ns
from ros_messages import message, packed
from soccer_bag import SOURCES, header, ros_source, transform, turn, write_messages, xyz

from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import CameraMount, Compass, ImageFeatures, InitialPose, LandmarkScan, Odometry, Truth
from logs.foreign.mapping import with_roles
from logs.foreign.settings import CompassSettings, FrameNames, LogMapping, MountSettings
from logs.reader import LogFile
from logs.schema import encode
from logs.writer import LogWriter

RAZOR = Path(__file__).parents[2] / "shared" / "data" / "mcap" / "sparkfun_razor.bag"
FIELD = FieldMap("empty", np.zeros((0, 2, 2)), np.zeros((0, 3)), ())
CAMERA = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)


def truth(second):
    return Truth(ns(second), np.array([second, 0.0, 0.0]))


def odometry(second):
    return Odometry(ns(second), np.array([0.1, 0.0, 0.0]))


def own_log(path, seconds, *, field=False):
    with LogWriter(path) as log:
        if field:
            log.write("/field", FIELD, ns(seconds[0]))
            log.write("/camera", CAMERA, ns(seconds[0]))
        for second in seconds:
            log.write("/truth", truth(second))
            log.write("/odometry", odometry(second))
    return path


def stamps(records):
    return [record.stamp_ns / 1e9 for record in records]


def odom(second, x=0.0, stamp=True, frame="odom"):
    head = header(ns(second) if stamp else 0, frame)
    return {
        "header": head,
        "child_frame_id": "base_footprint",
        "pose": {"pose": {"position": xyz([x, 0, 0]), "orientation": {"w": 1.0}}},
    }


def pose(second, x=0.0):
    return {"header": header(ns(second), "map"), "pose": {"position": xyz([x, 0, 0]), "orientation": {"w": 1.0}}}


# Own messages


def test_many_messages_come_as_they_were_written_on_all_topics_and_on_one(tmp_path):
    """More than are decoded together."""
    log = LogFile(own_log(tmp_path / "log.mcap", range(1500), field=True))
    messages = list(log.messages())
    assert len(messages) == 3002
    assert [m.log_time_ns for m in messages] == sorted(m.log_time_ns for m in messages)
    assert [m.topic for m in messages[:5]] == ["/field", "/camera", "/truth", "/odometry", "/truth"]
    assert all(isinstance(m.record, Truth if m.topic == "/truth" else Odometry) for m in messages[2:])
    assert stamps(log.records(Truth)) == list(range(1500))
    assert stamps(log.records(Odometry)) == list(range(1500))


def test_one_bad_message_among_many_costs_only_itself(tmp_path):
    good = encode(truth(1.0))
    bad = json.dumps({**json.loads(good), "x_m": float("nan")}).encode()
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/truth", truth(0.0))
        source = log._own["/truth"][1]
        for i in range(1000):
            log.write_raw(source, ns(1.0), bad if i == 700 else good)
            log.write("/odometry", odometry(1.0))
    log = LogFile(tmp_path / "log.mcap")
    for read in (lambda: list(log.records(Truth)), lambda: [m for m in log.messages() if m.topic == "/truth"]):
        assert len(read()) == 1000
        (warning,) = log.warnings
        assert "1 of 1001 messages left out, the first: /truth at 1.0 s: x_m is NaN" in warning


def test_plain_logs_are_read_without_a_word_of_ros_foxglove_or_pictures(tmp_path):
    path = own_log(tmp_path / "log.mcap", range(3))
    code = (
        "import sys; from logs.reader import LogFile; "
        f"assert len(list(LogFile({str(path)!r}).messages())) == 6; "
        "heavy = 'rosbags', 'foxglove', 'google.protobuf', 'matplotlib', 'logs.ros'; "
        "print([name for name in heavy if name in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


# Parts of logs, several logs


def test_a_part_of_a_log_is_read_by_seconds_since_its_first_message(tmp_path):
    path = own_log(tmp_path / "log.mcap", range(100, 110), field=True)
    assert stamps(LogFile(path, start_s=3.0).records(Truth)) == list(range(103, 110))
    assert stamps(LogFile(path, end_s=3.0).records(Truth)) == [100, 101, 102]
    part = LogFile(path, start_s=2.5, end_s=5.0)
    assert stamps(part.records(Truth)) == [103, 104]
    assert {m.topic for m in part.messages()} == {"/truth", "/odometry"}


def test_the_map_and_the_camera_hold_from_before_the_part_that_is_read(tmp_path):
    log = LogFile(own_log(tmp_path / "log.mcap", range(10), field=True), start_s=5.0)
    assert log.field_map().name == "empty"
    assert list(log.records(Camera)) == [CAMERA]


@pytest.mark.parametrize(
    ("part", "complaint"),
    [
        ({"start_s": 20.0}, "nothing from 20 s on: the log is 9.0 s long"),
        ({"start_s": 5.0, "end_s": 5.0}, "nothing between 5 s and 5 s"),
        ({"end_s": -1.0}, "nothing between 0 s and -1 s"),
    ],
)
def test_a_part_that_is_none_is_one_line(tmp_path, part, complaint):
    path = own_log(tmp_path / "log.mcap", range(10))
    with pytest.raises(FieldlocError, match=complaint):
        LogFile(path, **part)


def test_several_files_are_one_log(tmp_path):
    first = own_log(tmp_path / "a.mcap", [1, 3, 5], field=True)
    second = own_log(tmp_path / "b.mcap", [2, 4, 6])
    log = LogFile([first, second])
    assert stamps(log.records(Truth)) == [1, 2, 3, 4, 5, 6]
    assert log.path == first
    assert {s.topic: n for s, n in log.sources} == {"/camera": 1, "/field": 1, "/odometry": 6, "/truth": 6}
    assert stamps(LogFile([first, second], start_s=2.0).records(Truth)) == [3, 4, 5, 6]


# Roles


def test_a_role_told_on_the_command_line_must_be_there(tmp_path):
    path = own_log(tmp_path / "log.mcap", range(3))
    with pytest.raises(FieldlocError, match=r"--role truth=/mocap: no such topic; there is /odometry, /truth"):
        LogFile(path, with_roles(LogMapping(), ["truth=/mocap"]))
    log = LogFile(path, LogMapping(roles={"truth": ("/mocap",)}))
    assert list(log.records(Truth)) == []
    assert log.warnings == (f"{path}: no topic /mocap, which is to be truth",)
    assert log.roles["truth"] == "/mocap"


def test_a_role_that_nobody_shall_play_is_empty(tmp_path):
    log = LogFile(own_log(tmp_path / "log.mcap", range(3)), with_roles(LogMapping(), ["truth="]))
    assert list(log.records(Truth)) == []
    assert not log.has(Truth)
    assert len(list(log.records(Odometry))) == 3


def test_a_topic_of_another_type_than_its_role_needs_is_refused(tmp_path):
    path = write_messages(
        tmp_path / "log.mcap",
        [("/odom", ns(1), odom(1)), ("/chatter", ns(1), {"data": "x"})],
        chatter="std_msgs/msg/String",
    )
    for topic, carried in (("/chatter", "std_msgs/msg/String"), ("/odom", "nav_msgs/msg/Odometry")):
        log = LogFile(path, with_roles(LogMapping(), [f"compass={topic}"]))
        with pytest.raises(FieldlocError, match=f"topic {topic} carries {carried}.*needs fieldloc.Compass.v1"):
            log.records(Compass)


def test_someone_else_s_message_on_a_usual_topic_is_nobody_s_and_stops_nothing(tmp_path):
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        log.write("/truth", truth(1.0))
        log.write_raw(
            ros_source("/compass", "std_msgs/msg/Float64"),
            ns(1),
            packed(message("std_msgs/msg/Float64", {}), "std_msgs/msg/Float64"),
        )
        log.write_raw(
            ros_source("/camera", "sensor_msgs/msg/Image"),
            ns(1),
            packed(message("sensor_msgs/msg/Image", {}), "sensor_msgs/msg/Image"),
        )
    log = LogFile(path)
    assert [m.topic for m in log.messages()] == ["/truth"]
    assert list(log.records(Camera)) == []
    assert log.warnings == ()
    assert list(log.records(Compass)) == []
    assert "topic /compass carries std_msgs/msg/Float64 (cdr), needs fieldloc.Compass.v1" in log.warnings[0]
    by_topic = {source.topic: source for source, _ in log.sources}
    assert "needs fieldloc.Compass.v1" in log.problem(by_topic["/compass"])
    assert log.problem(by_topic["/camera"]) is None
    assert log.role(by_topic["/camera"]) == "image"


def test_the_usual_topic_may_carry_a_ros_message(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        for i in range(3):
            log.write_raw(
                ros_source("/odometry", "nav_msgs/msg/Odometry"),
                ns(i + 1),
                packed(message("nav_msgs/msg/Odometry", odom(i + 1, 0.5 * i)), "nav_msgs/msg/Odometry"),
            )
    assert [record.velocity[0] for record in LogFile(tmp_path / "log.mcap").records(Odometry)] == [0.5, 0.5, 0.5]


def test_a_camera_that_is_told_counts_before_that_of_the_log(tmp_path):
    other = Camera("pinhole", 100, 100, 50.0, 50.0, 50.0, 50.0)
    log = LogFile(own_log(tmp_path / "log.mcap", range(3), field=True), LogMapping(camera=other))
    assert log.has(Camera)
    assert list(log.records(Camera)) == [other]


# Other people's messages


def test_messages_of_others_are_records_in_between_own_ones(tmp_path):
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        for i in range(1, 5):
            log.write("/truth", truth(i))
            log.write_raw(
                SOURCES["/odom"],
                ns(i + 0.5),
                packed(message("nav_msgs/msg/Odometry", odom(i, 0.1 * i)), "nav_msgs/msg/Odometry"),
            )
    log = LogFile(path)
    messages = list(log.messages())
    assert [m.log_time_ns for m in messages] == sorted(m.log_time_ns for m in messages)
    others = [(m.log_time_ns / 1e9, m.record.stamp_ns / 1e9) for m in messages if m.topic == "/odom"]
    assert others == [(2.5, 1), (3.5, 2), (4.5, 3), (4.5, 4)]  # known when the next one is
    assert [m.topic for m in messages][:4] == ["/truth", "/truth", "/odom", "/truth"]
    assert [m.topic for m in log.messages(["/odom"])] == ["/odom"] * 4
    assert log.roles["odometry"] == "/odom"
    assert log.warnings == ()


def test_stamps_are_those_of_the_header_and_the_log_time_where_it_has_none(tmp_path):
    path = write_messages(tmp_path / "log.mcap", [("/odom", ns(i + 7), odom(i, i, stamp=False)) for i in range(3)])
    log = LogFile(path)
    assert stamps(log.records(Odometry)) == [7, 8, 9]
    assert log.warnings == (f"{path}: /odom: messages without a stamp are taken as measured when they were logged",)


def test_stamps_of_different_clocks_are_noticed(tmp_path):
    since_boot = [("/odom", ns(1000 + i), odom(i)) for i in range(1, 4)]
    path = write_messages(
        tmp_path / "log.mcap", [*since_boot, *(("/mocap/robot", ns(1000 + i), pose(1000 + i)) for i in range(3))]
    )
    log = LogFile(path)
    list(log.records(Odometry))
    assert log.warnings == ()
    list(log.records(Truth))
    assert (
        "stamps of different clocks: those of /mocap/robot are 0.0 s before their log time, those of /odom 1000.0 s"
        in log.warnings[0]
    )


def test_broken_messages_of_others_are_left_out_and_counted(tmp_path):
    path = tmp_path / "log.mcap"
    good = packed(message("nav_msgs/msg/Odometry", odom(1)), "nav_msgs/msg/Odometry")
    nan = packed(
        message("nav_msgs/msg/Odometry", odom(2, np.nan) | {"twist": {"twist": {"linear": xyz([np.nan] * 3)}}}),
        "nav_msgs/msg/Odometry",
    )
    with LogWriter(path) as log:
        for i, data in enumerate(
            [good, good[:100], nan, b"", packed(message("nav_msgs/msg/Odometry", odom(3)), "nav_msgs/msg/Odometry")]
        ):
            log.write_raw(SOURCES["/odom"], ns(i), data)
    log = LogFile(path)
    for _ in range(2):
        assert stamps(log.records(Odometry)) == [1, 3]
        (warning,) = log.warnings
        assert (
            "3 of 5 messages left out, the first: /odom at 1.0 s: nav_msgs/Odometry: 100 bytes that do not fit"
            in warning
        )


@pytest.mark.parametrize("value", [1e300, -1e308, 1e-320, np.inf])
def test_numbers_beyond_all_reason_are_left_out_and_the_rest_is_read(tmp_path, value):
    def start(x, variance):
        pose = {"position": xyz([x, 0, 0]), "orientation": {"w": 1.0}}
        covariance = np.diag([variance] * 6).ravel()
        return {"header": header(ns(1), "map"), "pose": {"pose": pose, "covariance": covariance}}

    def mag(x):
        return {"header": header(ns(1), "base_footprint"), "magnetic_field": xyz([x, x, x])}

    messages = [("/initialpose", ns(1), start(x, v)) for x, v in ((value, 1.0), (2.0, value), (3.0, 1.0))]
    messages += [("/imu/mag", ns(1), mag(x)) for x in (value, 1e-5)]
    messages += [("/odom", ns(i), odom(i, x)) for i, x in ((1, 1.0), (2, value), (3, 1.5))]
    log = LogFile(write_messages(tmp_path / "log.mcap", messages), LogMapping(compass=CompassSettings(north_rad=0.0)))
    tiny = abs(value) < 1.0
    starts = list(log.records(InitialPose))
    assert [record.pose[0] for record in starts] == ([value] if tiny else []) + [2.0, 3.0]
    assert all(np.linalg.eigvalsh(record.covariance)[0] > 0.0 for record in starts)
    assert len(list(log.records(Compass))) == (1 if tiny or np.isinf(value) else 2)
    assert all(abs(record.velocity).max() < 2.0 for record in log.records(Odometry))


def test_a_log_time_later_than_any_stamp_makes_no_stamp_that_is_none(tmp_path):
    path = write_messages(
        tmp_path / "log.mcap", [("/cmd_vel", 2**64 - 1 - i, {"linear": xyz([0.3, 0, 0])}) for i in (2, 1)]
    )
    assert all(record.stamp_ns == 2**63 - 1 for record in LogFile(path).records(Odometry))


def test_a_commanded_velocity_is_odometry_with_a_warning(tmp_path):
    path = write_messages(
        tmp_path / "log.mcap", [("/cmd_vel", ns(i), {"linear": xyz([0.3, 0, 0])}) for i in range(1, 4)]
    )
    log = LogFile(path)
    assert [record.velocity[0] for record in log.records(Odometry)] == [0.3] * 3
    assert "odometry is guessed to be /cmd_vel, which is what the robot was told" in log.warnings[0]
    told = LogFile(path, with_roles(LogMapping(), ["odometry=/cmd_vel"]))
    assert len(list(told.records(Odometry))) == 3
    assert "guessed" not in str(told.warnings)


def test_transforms_are_odometry_where_nothing_else_is(tmp_path):
    def moved(i):
        return {
            "transforms": [transform(ns(i), "odom", "base_footprint", np.array([0.2 * i, 0.0, 0.0]), turn("z", 0.0))]
        }

    log = LogFile(write_messages(tmp_path / "log.mcap", [("/tf", ns(i), moved(i)) for i in range(1, 6)]))
    assert [record.velocity[0] for record in log.records(Odometry)] == pytest.approx([0.2] * 5)
    (source,) = [source for source, _ in log.sources]
    assert log.plays(source) == ("odometry", "tf")
    assert log.role(source) == "odometry"


def test_transforms_of_long_ago_serve_a_part_of_the_log_if_they_are_static(tmp_path):
    def mag(i):
        return {"header": header(ns(i), "imu"), "magnetic_field": xyz([1e-5, 0, 0])}

    static = {"transforms": [transform(0, "base_footprint", "imu", np.zeros(3), turn("z", 0.5))]}
    messages = [("/tf_static", ns(1), static), *(("/imu/mag", ns(i), mag(i)) for i in range(1, 30))]
    path = write_messages(tmp_path / "log.mcap", messages)
    log = LogFile(path, LogMapping(compass=CompassSettings(north_rad=0.0)), start_s=20.0)
    assert {round(record.heading_rad, 9) for record in log.records(Compass)} == {-0.5}


def test_what_is_seen_without_camera_or_place_is_counted_with_the_way_out(tmp_path):
    seen = {
        "header": header(ns(1), "camera"),
        "posts": [{"bb": {"center": {"position": {"x": 320.0, "y": 200.0}}, "size_x": 20.0, "size_y": 90.0}}],
    }
    info = {
        "header": header(ns(1), "camera"),
        "width": 640,
        "height": 480,
        "k": [500, 0, 319.5, 0, 500, 239.5, 0, 0, 1],
    }
    path = write_messages(tmp_path / "log.mcap", [("/goal_posts_in_image", ns(1), seen)])
    log = LogFile(path)
    assert list(log.records(ImageFeatures)) == []
    assert "no camera intrinsics" in log.warnings[0]
    assert "--mapping" in log.warnings[0]
    path = write_messages(
        tmp_path / "log.mcap", [("/goal_posts_in_image", ns(1), seen), ("/camera/camera_info", ns(1), info)]
    )
    log = LogFile(path)
    assert list(log.records(ImageFeatures)) == []
    assert "the log has no transforms; give [mount] in a --mapping" in log.warnings[0]
    mount = CameraMount(0.6, 0.0, 0.3, 0.0, np.eye(4))
    (features,) = LogFile(path, LogMapping(mount=MountSettings(fixed=mount))).records(ImageFeatures)
    assert features.posts[0].edges_px[:, 0] == pytest.approx([310.0, 330.0], abs=0.1)


def test_a_start_and_scans_come_from_others_too(tmp_path):
    start = {
        "header": header(ns(1), "map"),
        "pose": {"pose": {"position": xyz([1.0, 2.0, 0.0]), "orientation": {"z": 1.0}}},
    }
    seen = {
        "header": header(ns(2), "base_footprint"),
        "posts": [{"bb": {"center": {"position": xyz([3.0, 4.0, 0.0])}}}],
    }
    path = write_messages(
        tmp_path / "log.mcap", [("/initialpose", ns(1), start), ("/goal_posts_relative", ns(2), seen)]
    )
    mapping = LogMapping(frames=FrameNames(field_from_map=(1.0, 0.0, 0.0)))
    log = LogFile(path, mapping)
    (told,) = log.records(InitialPose)
    assert told.pose == pytest.approx([2.0, 2.0, -np.pi])
    assert np.sqrt(np.diag(told.covariance)) == pytest.approx([0.5, 0.5, np.radians(15.0)])
    (scan,) = log.records(LandmarkScan)
    assert scan.range_bearing[0, 0] == pytest.approx(5.0)


# Pictures


def picture(second, data):
    return {"header": header(ns(second), "camera"), "format": "jpeg", "data": np.frombuffer(data, np.uint8)}


def test_pictures_come_as_they_were_logged(tmp_path):
    topic = "/camera/image_raw/compressed"
    path = write_messages(tmp_path / "log.mcap", [(topic, ns(i), picture(i, b"\xff" * i)) for i in range(1, 4)])
    log = LogFile(path)
    assert [(p.stamp_ns, p.format, bytes(p.data)) for p in log.images()] == [
        (ns(i), "jpeg", b"\xff" * i) for i in (1, 2, 3)
    ]
    assert len(list(log.images(topic))) == 3
    assert [p.stamp_ns for p in LogFile(path, start_s=1.5).images()] == [ns(3)]
    with pytest.raises(FieldlocError, match=f"no images on /rear; there are some on {topic}"):
        log.images("/rear")
    unstamped = write_messages(tmp_path / "log.mcap", [(topic, ns(7), {"format": "png"})])
    assert [p.stamp_ns for p in LogFile(unstamped).images()] == [ns(7)]


def test_a_log_without_pictures_says_so_and_video_is_refused_with_the_way_out(tmp_path):
    with pytest.raises(FieldlocError, match=r"holds no images$"):
        LogFile(own_log(tmp_path / "own.mcap", range(3))).images()
    path = tmp_path / "video.mcap"
    with path.open("wb") as file:
        log = mcap.writer.Writer(file)
        log.start()
        schema = log.register_schema("foxglove.CompressedVideo", "protobuf", b"")
        log.add_message(log.register_channel("/video", "protobuf", schema), 1, b"", 1)
        log.finish()
    with pytest.raises(FieldlocError, match=r"/video is compressed video .*: record CompressedImage instead"):
        LogFile(path).images()


@pytest.mark.skipif(not RAZOR.exists(), reason=f"{RAZOR} is missing: other people's recordings")
def test_a_ros_1_bag_is_read_as_it_is():
    log = LogFile(RAZOR, LogMapping(compass=CompassSettings(north_rad=0.0)))
    headings = [record.heading_rad for record in log.records(Compass)]
    assert len(headings) == 2144
    assert np.isfinite(headings).all()
    assert "frame" in str(log.warnings)
