import json
import subprocess
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import log_records
import mcap.reader
import numpy as np
import pytest
from foxglove_wire import strictly
from mcap_protobuf.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from two_minds import ambiguity

from estimators.base import Ambiguity, Estimate, Event
from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, load_field
from fieldloc.measurements import (
    CameraMount,
    ImageFeatures,
    LandmarkScan,
    LineObservation,
    Odometry,
    PostObservation,
    Truth,
)
from logs.estimates import read_estimates, read_truth, write_estimates
from logs.foreign.settings import LogMapping
from logs.foxglove import topics
from logs.reader import LogFile
from logs.reader.container import open_container
from logs.recording import Recording
from logs.replay import Replay
from logs.result_streams import clock_offset_ns
from logs.schema import TOPICS, topic_of
from logs.source import Attachment, Encoded, RawMessage, Source
from logs.writer import LogWriter

ROOT = Path(__file__).parents[1]
SECOND = 10**9
START_NS = 1_700_000_000 * SECOND
FIELD = load_field("kidsize")
COVARIANCE = np.diag([0.04, 0.02, 0.01])
MOUNT = CameraMount(0.55, 0.0, 0.4, 0.0, 1e-4 * np.eye(4))
CAMERA = Camera("pinhole", 640, 480, 500.0, 500.0, 320.0, 240.0)
POST = PostObservation(np.array([[300.0, 80.0], [310.0, 80.0]]), np.eye(4), np.array([305.0, 300.0]), np.eye(2), "p")
LINE = LineObservation(np.array([[100.0, 300.0], [500.0, 310.0]]), np.eye(4))


def ns(seconds):
    return START_NS + round(seconds * SECOND)


def measurements(duration_s=2.0):
    """Odometry at 20 Hz straight ahead, scans at 4 Hz, images at 15 Hz."""
    out = [Odometry(ns(t), np.array([0.5, 0.0, 0.2])) for t in np.arange(0.0, duration_s, 0.05)]
    scan = LandmarkScan(
        0, (FIELD.labels[0], None), np.array([[3.0, 0.1], [2.0, -0.4]]), np.tile(0.01 * np.eye(2), (2, 1, 1))
    )
    out += [replace(scan, stamp_ns=ns(t)) for t in np.arange(0.1, duration_s, 0.25)]
    out += [ImageFeatures(ns(t), MOUNT, (POST,), (LINE,)) for t in np.arange(0.1, duration_s, 1 / 15)]
    return tuple(sorted(out, key=lambda one: one.stamp_ns))


def estimates(duration_s=2.0):
    times = np.arange(0.1, duration_s, 1 / 30)
    return tuple(Estimate(ns(t), np.array([t, 1.0 - t, 0.3 * t]), COVARIANCE * (1 + t)) for t in times)


def recording(**changes):
    return replace(Recording("walk", FIELD, CAMERA, measurements()), **changes)


def done(of=None):
    return Replay(estimates() if of is None else tuple(of), np.zeros(0), 1.0, ())


def unsure():
    """A run with two hypotheses, then one, ten times a second."""
    said = [ambiguity(ns(t), {1: 0.7, 2: 0.295, 3: 0.005} if t < 1 else {1: 1.0}, 0.3) for t in np.arange(0.1, 2, 0.1)]
    events = (Event(ns(0.1), "start", "found"), Event(ns(1.0), "decision", "one is left \u2713"))
    return replace(done(), ambiguities=tuple(said), events=events)


def write(path, *, of=None, recorded=None, run=None, **options):
    return write_estimates(path, recorded or recording(), run or done(of), {"estimator": "ekf"}, **options)


def raw(path):
    container = open_container(path)
    return [(container.sources[m.channel].topic, m) for m in container.messages(list(container.sources))]


def on(path, topic):
    return [message for name, message in raw(path) if name == topic]


def counts(path):
    return {source.topic: count for source, count in LogFile(path).sources}


@dataclass
class Input:
    """A container in memory. messages: (channel, log time)."""

    sources: dict = field(default_factory=dict)
    logged: list = field(default_factory=list)
    metadata: dict = field(default_factory=dict)
    files: tuple = ()
    path: Path = Path("input.bag")
    damage: tuple = ()

    @property
    def counts(self):
        return {number: sum(m.channel == number for m in self.logged) for number in self.sources}

    @property
    def span_ns(self):
        times = [m.log_time_ns for m in self.logged]
        return (min(times), max(times)) if times else None

    def messages(self, channels, start_ns=None, end_ns=None):
        return (m for m in sorted(self.logged, key=lambda m: m.log_time_ns) if m.channel in channels)

    def attachments(self):
        return iter(self.files)


IMU = Source("/imu", "cdr", "sensor_msgs/msg/Imu", "ros2msg", b"float64 x", {"offered_qos_profiles": "- x"})
SILENT = Source("/silent", "", "", "", b"")


def own_log(path, records, offset_ns=0):
    """The map and the records, logged offset_ns after their stamps."""
    with LogWriter(path, {"source": "a robot"}) as log:
        log.write(topic_of(FieldMap), FIELD, START_NS + offset_ns)
        for record in records:
            log.write(topic_of(type(record)), record, record.stamp_ns + offset_ns)
    return LogFile(path)


def test_estimates_come_back_bit_by_bit(tmp_path):
    assert write(tmp_path / "out.mcap") == ()
    log = LogFile(tmp_path / "out.mcap")
    back = read_estimates(log)
    assert back.stamps_ns.tolist() == [e.stamp_ns for e in estimates()]
    assert np.array_equal(back.poses, [e.pose for e in estimates()])
    assert np.array_equal(back.covariances, [e.covariance for e in estimates()])
    assert log.field_map().name == FIELD.name
    assert log.metadata["fieldloc"]["estimator"] == "ekf"
    assert log.warnings == ()


def test_mcaps_own_reader_resolves_every_schema(tmp_path):
    write(tmp_path / "out.mcap")
    seen = {}
    with (tmp_path / "out.mcap").open("rb") as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        protobuf = [c.topic for c in reader.get_summary().channels.values() if c.message_encoding == "protobuf"]
        for schema, channel, message, decoded in reader.iter_decoded_messages(protobuf):
            assert decoded.DESCRIPTOR.full_name == schema.name
            assert decoded.SerializeToString(deterministic=True) == message.data
            seen.setdefault(channel.topic, set()).add(schema.name)
        for schema, channel, message in reader.iter_messages([TOPICS["estimate"], TOPICS["field"]]):
            assert set(json.loads(message.data)) == set(json.loads(schema.data)["properties"])
            seen.setdefault(channel.topic, set()).add(schema.name)
    assert seen == {
        "/field": {"fieldloc.FieldMap.v1"},
        "/estimate": {"fieldloc.Estimate.v1"},
        topics.FIELD: {"foxglove.SceneUpdate"},
        topics.POSE: {"foxglove.PoseInFrame"},
        topics.STATE: {"foxglove.Odometry"},
        topics.TRANSFORMS: {"foxglove.FrameTransforms"},
        topics.UNCERTAINTY: {"foxglove.SceneUpdate"},
        topics.TRAJECTORY: {"foxglove.PosesInFrame"},
        topics.SIGHTS: {"foxglove.SceneUpdate"},
        topics.ANNOTATIONS: {"foxglove.ImageAnnotations"},
    }


def test_every_foxglove_message_is_as_published(tmp_path):
    write(tmp_path / "out.mcap")
    container = open_container(tmp_path / "out.mcap")
    for message in container.messages([n for n, s in container.sources.items() if s.message_encoding == "protobuf"]):
        strictly(Encoded(container.sources[message.channel], message.log_time_ns, message.data))


def test_messages_stand_in_the_order_of_their_stamps(tmp_path):
    write(tmp_path / "out.mcap")
    with (tmp_path / "out.mcap").open("rb") as file:
        reader = mcap.reader.make_reader(file)
        times_ns = [message.log_time for _, _, message in reader.iter_messages(log_time_order=False)]
    assert times_ns == sorted(times_ns)
    assert [m.log_time_ns for m in on(tmp_path / "out.mcap", "/estimate")] == [e.stamp_ns for e in estimates()]
    assert {m.log_time_ns for m in on(tmp_path / "out.mcap", topics.TRAJECTORY)} == {
        START_NS
    }  # to be seen from the start


def test_what_is_big_comes_ten_times_a_second_at_most(tmp_path):
    write(tmp_path / "out.mcap")
    per_topic = counts(tmp_path / "out.mcap")
    assert per_topic[topics.POSE] == per_topic[topics.STATE] == per_topic[topics.TRANSFORMS] == len(estimates())
    assert per_topic[topics.ANNOTATIONS] == sum(isinstance(m, ImageFeatures) for m in measurements())
    for topic in (topics.UNCERTAINTY, topics.SIGHTS):
        assert 10 <= per_topic[topic] <= 20  # in 1.9 s, of 57 estimates, 29 images and 8 scans
        assert np.diff([m.log_time_ns for m in on(tmp_path / "out.mcap", topic)]).min() >= SECOND / 10


def test_sights_start_at_the_newest_estimate(tmp_path):
    late = [e for e in estimates() if e.stamp_ns > ns(1.0)]
    write(tmp_path / "out.mcap", of=late)
    shown = on(tmp_path / "out.mcap", topics.SIGHTS)
    assert shown[0].log_time_ns >= late[0].stamp_ns  # nobody knew before from where
    container = open_container(tmp_path / "out.mcap")
    for message in shown:
        update = strictly(Encoded(container.sources[message.channel], message.log_time_ns, message.data))
        eye = update.entities[0].lines[0].points[0]
        newest = [e for e in late if e.stamp_ns <= message.log_time_ns][-1]
        assert [eye.x, eye.y] == pytest.approx(newest.pose[:2], abs=1e-3)


def links(path):
    container = open_container(path)
    for message in on(path, topics.TRANSFORMS):
        update = strictly(Encoded(container.sources[message.channel], message.log_time_ns, message.data))
        yield [
            (
                link.parent_frame_id,
                link.child_frame_id,
                np.array([link.translation.x, link.translation.y, 2 * np.arctan2(link.rotation.z, link.rotation.w)]),
            )
            for link in update.transforms
        ]


def test_the_odom_frame_moves_as_the_odometry_says(tmp_path):
    write(tmp_path / "out.mcap")
    for estimate, (_, second) in zip(estimates(), links(tmp_path / "out.mcap"), strict=True):
        elapsed_s = (estimate.stamp_ns - START_NS) * 1e-9
        assert second[2] == pytest.approx(se2.exp(np.array([0.5, 0.0, 0.2]) * elapsed_s), abs=1e-9)


def test_merging_keeps_the_input_byte_by_byte(tmp_path):
    logged = [RawMessage(5, ns(t), ns(t) - 7, 1000 + i, bytes([i])) for i, t in enumerate([-1.0, 0.3, 0.1, 9.0])]
    files = (Attachment("notes.txt", "text/plain", 3, 4, b"mud"),)
    made = {"fieldloc": {"version": "0", "source": "a robot"}, "match": {"half": "2"}}
    write(tmp_path / "out.mcap", merge=Input({5: IMU, 9: SILENT}, logged, made, files))
    container = open_container(tmp_path / "out.mcap")
    numbers = {source.topic: number for number, source in container.sources.items()}
    assert container.sources[numbers["/imu"]] == IMU
    assert container.sources[numbers["/silent"]] == SILENT
    kept = list(container.messages([numbers["/imu"]]))
    assert [m[1:] for m in kept] == [m[1:] for m in sorted(logged, key=lambda m: m.log_time_ns)]
    assert list(container.attachments()) == list(files)
    assert container.metadata["fieldloc"]["estimator"] == "ekf"
    assert container.metadata["fieldloc (input.bag)"] == made["fieldloc"]
    assert container.metadata["match"] == made["match"]
    assert container.span_ns == (ns(-1.0), ns(9.0))
    assert on(tmp_path / "out.mcap", topics.FIELD)[0].log_time_ns == ns(-1.0)  # to be seen from the start
    assert len(read_estimates(LogFile(tmp_path / "out.mcap"))) == len(estimates())


def test_earlier_results_give_way(tmp_path):
    source = own_log(tmp_path / "in.mcap", [*measurements(), Truth(ns(1.0), np.ones(3))])
    write(tmp_path / "first.mcap", merge=source.container)
    other = replace(recording(), field=load_field("spl"))
    better = [replace(e, pose=e.pose + 1.0) for e in estimates()]
    write(tmp_path / "second.mcap", recorded=other, of=better, merge=open_container(tmp_path / "first.mcap"))
    assert counts(tmp_path / "second.mcap") == counts(tmp_path / "first.mcap")
    log = LogFile(tmp_path / "second.mcap")
    assert np.array_equal(read_estimates(log).poses, [e.pose for e in better])
    assert log.field_map().name == other.field.name
    assert len(read_truth(log)) == 1
    assert set(log.metadata) == {"fieldloc", "fieldloc (first.mcap)", "fieldloc (in.mcap)"}
    for topic in ("/odometry", "/landmarks", "/image_features", "/truth"):
        assert [m[1:] for m in on(tmp_path / "second.mcap", topic)] == [m[1:] for m in on(source.path, topic)]


def test_beside_someone_elses_transforms_frames_have_names_of_their_own(tmp_path):
    tf = Source("/tf", "cdr", "tf2_msgs/msg/TFMessage", "ros2msg", b"")
    write(tmp_path / "beside.mcap", merge=Input({1: tf}, [RawMessage(1, ns(1.0), ns(1.0), 0, b"")]))
    write(tmp_path / "alone.mcap", merge=Input({1: IMU}, [RawMessage(1, ns(1.0), ns(1.0), 0, b"")]))
    beside, alone = (
        {link[:2] for pair in links(tmp_path / name) for link in pair} for name in ("beside.mcap", "alone.mcap")
    )
    assert beside == {("field", "fieldloc/odom"), ("fieldloc/odom", "fieldloc/robot")}
    assert alone == {("field", "odom"), ("odom", "robot")}


def test_a_result_for_ros_2_holds_nothing_else_so_that_its_tools_open_it(tmp_path):
    assert write(tmp_path / "out.mcap", ros2=True) == ()
    per_topic = counts(tmp_path / "out.mcap")
    assert per_topic == dict.fromkeys(("/tf", "/fieldloc/pose_with_covariance", "/fieldloc/odometry"), len(estimates()))
    with AnyReader([tmp_path / "out.mcap"]) as bag:
        poses = [
            bag.deserialize(data, connection.msgtype).pose.pose.position
            for connection, _, data in bag.messages()
            if connection.topic == "/fieldloc/pose_with_covariance"
        ]
    assert [(pose.x, pose.y) for pose in poses] == [tuple(one.pose[:2]) for one in estimates()]


def test_a_result_for_ros_2_is_read_back_with_its_covariances(tmp_path):
    write(tmp_path / "out.mcap", ros2=True)
    back = read_estimates(LogFile(tmp_path / "out.mcap"))
    np.testing.assert_allclose(back.poses, [one.pose for one in estimates()], atol=1e-12)
    np.testing.assert_allclose(back.covariances, [one.covariance for one in estimates()], atol=1e-15)


def test_a_merged_log_that_ros_2_cannot_read_is_told(tmp_path):
    (told,) = write(tmp_path / "out.mcap", ros2=True, merge=Input({1: Source("/x", "json")}, []))
    assert "rosbags cannot open it, as /x of the merged log is not ROS 2" in told
    assert {"/estimate", "/fieldloc/pose", "/fieldloc/pose_with_covariance"} <= set(counts(tmp_path / "out.mcap"))
    # no frame has a parent in /tf and another one here
    assert {link[1] for pair in links(tmp_path / "out.mcap") for link in pair} == {"fieldloc/odom", "fieldloc/robot"}


def test_earlier_ros_2_results_give_way_and_a_robots_own_transforms_stay(tmp_path):
    tf = Source("/tf", "cdr", "tf2_msgs/msg/TFMessage", "ros2msg", b"", {"offered_qos_profiles": "- depth: 1"})
    write(tmp_path / "first.mcap", ros2=True, merge=Input({1: tf}, [RawMessage(1, ns(0.0), ns(0.0), 0, b"own")]))
    write(tmp_path / "second.mcap", ros2=True, merge=open_container(tmp_path / "first.mcap"))
    assert counts(tmp_path / "second.mcap") == counts(tmp_path / "first.mcap")
    assert [m.data for m in on(tmp_path / "second.mcap", "/tf")].count(b"own") == 1
    assert len(on(tmp_path / "second.mcap", "/tf")) == 1 + len(estimates())


def test_stamps_beyond_ros_2_are_an_error_that_says_so(tmp_path):
    late_ns = 2**31 * SECOND
    with pytest.raises(FieldlocError, match="2147483648 s"):
        write(tmp_path / "out.mcap", of=[Estimate(late_ns, np.zeros(3), COVARIANCE)], ros2=True)
    assert list(tmp_path.iterdir()) == []


def test_stamps_beyond_foxglove_leave_its_messages_out(tmp_path):
    late_ns = 2**32 * SECOND
    late = recording(measurements=(Odometry(late_ns, np.zeros(3)),))
    (warning,) = write(tmp_path / "out.mcap", recorded=late, of=[Estimate(late_ns, np.zeros(3), COVARIANCE)])
    assert "out.mcap" in warning
    assert "Foxglove" in warning
    assert counts(tmp_path / "out.mcap") == {"/estimate": 1, "/field": 1}


@pytest.mark.parametrize("covariance", [np.full((3, 3), np.nan), np.diag([1.0, -1.0, 1.0]), np.eye(2)])
def test_a_broken_estimate_is_an_error_and_no_file(tmp_path, covariance):
    broken = [*estimates()[:-1], replace(estimates()[-1], covariance=covariance)]
    with pytest.raises(FieldlocError, match=r"out\.mcap: not written: the estimator gave a broken estimate"):
        write(tmp_path / "out.mcap", of=broken)
    assert list(tmp_path.iterdir()) == []


def test_somebody_is_told_how_far_it_is(tmp_path):
    told = []
    logged = [RawMessage(1, ns(i / 1000), ns(i / 1000), i, b"") for i in range(2000)]
    merge = Input({1: IMU}, logged)
    write_estimates(tmp_path / "out.mcap", recording(), done(), {}, lambda *step: told.append(step), merge)
    assert told == [(i, 2000 + len(estimates()), "writing") for i in range(0, 2000 + len(estimates()), 500)]


def test_log_times_that_are_the_stamps_clock_need_no_offset(tmp_path):
    for late_s in (0.0, 0.3, -0.2):
        assert clock_offset_ns(own_log(tmp_path / f"{late_s}.mcap", measurements(), round(late_s * SECOND))) == 0


def test_log_times_of_another_clock_shift_the_results(tmp_path):
    offset_ns = 3600 * SECOND
    log = own_log(tmp_path / "in.mcap", measurements(), offset_ns)
    assert clock_offset_ns(log) == offset_ns
    write(tmp_path / "out.mcap", merge=log.container, offset_ns=clock_offset_ns(log))
    container = open_container(tmp_path / "out.mcap")
    assert container.span_ns == log.span_ns
    estimated = on(tmp_path / "out.mcap", "/estimate")
    assert [m.log_time_ns - offset_ns for m in estimated] == [e.stamp_ns for e in estimates()]
    back = read_estimates(LogFile(tmp_path / "out.mcap"))
    assert back.stamps_ns.tolist() == [e.stamp_ns for e in estimates()]  # measured when they were
    assert [m.log_time_ns for m in on(tmp_path / "out.mcap", topics.POSE)] == [m.log_time_ns for m in estimated]


def test_clocks_are_compared_on_all_topics_of_a_role(tmp_path):
    scans = [one for one in measurements() if isinstance(one, LandmarkScan)]
    with LogWriter(tmp_path / "in.mcap") as log:
        for i, scan in enumerate(scans):
            log.write(("/left", "/right")[i % 2], scan, scan.stamp_ns + 60 * SECOND)
    mapping = LogMapping(roles={"landmarks": ("/left", "/right")})
    assert clock_offset_ns(LogFile(tmp_path / "in.mcap", mapping)) == 60 * SECOND


def test_a_log_without_measurements_has_no_offset(tmp_path):
    assert clock_offset_ns(own_log(tmp_path / "in.mcap", [Truth(ns(1.0), np.ones(3))], 3600 * SECOND)) == 0


def test_reading_a_log_does_not_import_foxglove():
    code = (
        "import sys\n"
        "from logs.samples import sample_path\n"
        "from logs.reader import LogFile\n"
        "from fieldloc.measurements import Truth\n"
        "import logs.estimates\n"
        "log = LogFile(sample_path('woods'))\n"
        "assert len(logs.estimates.read_truth(log))\n"
        "print(sorted({'foxglove', 'google.protobuf', 'rosbags'} & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


# -- hypotheses --------------------------------------------------------------------------------------------------------


def test_hypotheses_and_events_come_back_bit_by_bit(tmp_path):
    assert write(tmp_path / "out.mcap", run=unsure()) == ()
    log = LogFile(tmp_path / "out.mcap")
    for kind, told in ((Ambiguity, unsure().ambiguities), (Event, unsure().events)):
        back = list(log.records(kind))
        assert len(back) == len(told)
        assert all(map(log_records.same, back, told))
    assert log.warnings == ()


def test_without_hypotheses_a_result_has_no_topic_for_them(tmp_path):
    write(tmp_path / "out.mcap")
    assert not {"/hypotheses", "/events", topics.HYPOTHESES, topics.WEIGHTS, topics.EVENTS} & set(
        counts(tmp_path / "out.mcap")
    )


def foxglove(path, topic):
    container = open_container(path)
    return [
        strictly(Encoded(container.sources[m.channel], m.log_time_ns, m.data))
        for m in container.messages([n for n, s in container.sources.items() if s.topic == topic])
    ]


def test_hypotheses_are_arrows_the_likeliest_first(tmp_path):
    write(tmp_path / "out.mcap", run=unsure(), offset_ns=5)
    path = tmp_path / "out.mcap"
    assert [m.log_time_ns for m in on(path, topics.HYPOTHESES)] == [a.stamp_ns + 5 for a in unsure().ambiguities]
    assert [m.log_time_ns for m in on(path, "/hypotheses")] == [a.stamp_ns + 5 for a in unsure().ambiguities]
    first = foxglove(path, topics.HYPOTHESES)[0]
    assert [pose.position.x for pose in first.poses] == [1.0, 2.0]  # not the one of 0.5 %
    arrows = foxglove(path, topics.WEIGHTS)[0].entities[0].arrows
    assert [arrow.color.a for arrow in arrows] == pytest.approx([1.0, 0.1 + 0.9 * 0.295 / 0.7])


def test_events_are_lines_of_a_log_panel(tmp_path):
    write(tmp_path / "out.mcap", run=unsure())
    lines = foxglove(tmp_path / "out.mcap", topics.EVENTS)
    assert [(line.name, line.message) for line in lines] == [("start", "found"), ("decision", "one is left \u2713")]
    assert [line.level == line.INFO for line in lines] == [False, True]


def test_earlier_hypotheses_give_way_and_what_others_call_so_stays(tmp_path):
    other = Source("/events", "json", "someone.Event", "jsonschema", b"{}")
    merge = Input({1: other}, [RawMessage(1, ns(0.5), ns(0.5), 0, b"{}")])
    write(tmp_path / "first.mcap", run=unsure(), merge=merge)
    write(tmp_path / "second.mcap", merge=open_container(tmp_path / "first.mcap"))
    per_topic = counts(tmp_path / "second.mcap")
    assert per_topic["/events"] == 1
    assert not {"/hypotheses", topics.HYPOTHESES, topics.WEIGHTS, topics.EVENTS} & set(per_topic)
    assert list(LogFile(tmp_path / "first.mcap").records(Event)) == list(unsure().events)


def test_for_ros_2_hypotheses_are_an_array_of_poses(tmp_path):
    write(tmp_path / "out.mcap", run=unsure(), ros2=True)
    with AnyReader([tmp_path / "out.mcap"]) as bag:
        arrays = [
            bag.deserialize(data, connection.msgtype)
            for connection, _, data in bag.messages()
            if connection.topic == "/fieldloc/hypotheses"
        ]
    assert [len(array.poses) for array in arrays] == [2] * 9 + [1] * 10
    for array, told in zip(arrays, unsure().ambiguities, strict=True):
        assert array.header.frame_id == "map"
        assert array.header.stamp.sec * SECOND + array.header.stamp.nanosec == told.stamp_ns
        for pose, one in zip(array.poses, told.hypotheses, strict=False):
            assert (pose.position.x, pose.position.y) == tuple(one.pose[:2])
            assert 2 * np.arctan2(pose.orientation.z, pose.orientation.w) == pytest.approx(one.pose[2])


def test_a_hypothesis_that_no_reader_would_accept_is_not_written(tmp_path):
    broken = replace(unsure(), ambiguities=(ambiguity(ns(1.0), {1: 1.5}),))
    with pytest.raises(FieldlocError, match=r"hypotheses\[0\]\.weight is 1\.5, must be from 0 to 1"):
        write(tmp_path / "out.mcap", run=broken)
    assert list(tmp_path.iterdir()) == []
