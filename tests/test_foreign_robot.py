"""A KidSize robot's recording in the forms in which teams have it, from file to pose."""

from pathlib import Path

import numpy as np
import pytest
from foxglove.messages import (
    CameraCalibration,
    FrameTransform,
    FrameTransforms,
    PoseInFrame,
    Quaternion,
    Timestamp,
    Vector3,
)
from foxglove.messages import Odometry as FoxgloveOdometry
from foxglove.messages import Pose as FoxglovePose
from foxglove_wire import of_sdk
from soccer_bag import CAMERA, IMAGE_HZ, ODOM_HZ, START, USUAL, Moment, boxes, write_bag

from estimators.config import Config
from estimators.registry import ALL
from fieldloc.errors import FieldlocError
from fieldloc.field import load_field
from fieldloc.measurements import Compass, ImageFeatures, InitialPose, LandmarkScan, Odometry, Truth
from logs.estimates import read_estimates, read_truth
from logs.evaluate import evaluate
from logs.foreign.mapping import with_roles
from logs.foreign.settings import CompassSettings, LogMapping
from logs.info import summarize
from logs.info_text import format_summary
from logs.reader import LogFile
from logs.recording import load_recording
from logs.replay import replay
from logs.trajectory import from_estimates
from logs.writer import LogWriter

FIELD = load_field("kidsize")
SECONDS = 8.0


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bag") / "game.mcap", FIELD, SECONDS)


def errors_m(
    log: LogFile, estimator: str = "ekf", start=START, log_truth: LogFile | None = None
) -> tuple[float, float]:
    """RMSE and largest error of the position."""
    recording = load_recording(log, FIELD)
    done = replay(recording, ALL[estimator](Config()), start)
    assert done.warnings == ()
    metrics = evaluate(from_estimates(done.estimates), read_truth(log_truth or log))
    return metrics.ate_m.rmse, metrics.ate_m.max


def test_a_ros_2_recording_lands_within_centimetres_of_the_truth(bag):
    log = LogFile(bag)
    assert errors_m(log)[0] < 0.04
    assert errors_m(log)[1] < 0.10
    assert log.warnings == ()
    assert errors_m(log, "dead-reckoning")[1] > 0.15  # which odometry alone does not reach


def test_its_table_shows_who_plays_what(bag):
    rows = {row.topic: (row.role, row.candidate, row.count) for row in summarize(LogFile(bag)).rows}
    images = round(SECONDS * IMAGE_HZ) + 1
    assert rows == {
        "/camera/camera_info": ("camera", None, images),
        "/camera/image_raw/compressed": ("image", None, images),
        "/cmd_vel": (None, "odometry", images),
        "/goal_posts_in_image": ("image_features", None, images),
        "/markings_in_image": ("image_features", None, images),
        "/mocap/robot": ("truth", None, images),
        "/odom": ("odometry", None, round(SECONDS * ODOM_HZ) + 1),
        "/tf": ("tf", None, round(SECONDS * ODOM_HZ) + 1),
        "/tf_static": ("tf", None, 1),
    }
    text = format_summary(summarize(LogFile(bag)))
    row = next(line for line in text.splitlines() if line.startswith("/odom ")).split()
    assert row == ["/odom", "nav_msgs/msg/Odometry", "odometry", "401", "50.00", "0.020"]
    assert next(line for line in text.splitlines() if line.startswith("/cmd_vel")).split()[2] == "odometry?"


def test_of_an_image_on_two_topics_there_is_one_record(bag):
    stamps = [features.stamp_ns for features in LogFile(bag).records(ImageFeatures)]
    assert len(stamps) == len(set(stamps))
    with_posts = [f for f in LogFile(bag).records(ImageFeatures) if f.posts and f.lines]
    assert with_posts
    moment = Moment((with_posts[0].stamp_ns - Moment(0.0).stamp_ns) / 1e9)
    assert len(with_posts[0].posts) <= len(boxes(moment, FIELD))
    place, _ = moment.footprint_from_camera
    mount = with_posts[0].mount
    assert (mount.x_m, mount.y_m, mount.height_m) == pytest.approx(tuple(place))


def test_detections_in_metres_do_where_there_are_none_in_pixels(tmp_path):
    """Posts as scans; lines by way of the camera that saw them."""
    topics = [topic for topic in USUAL if "in_image" not in topic]
    path = write_bag(tmp_path / "game.mcap", FIELD, 4.0, [*topics, "/goal_posts_relative", "/markings_relative"])
    log = LogFile(path)
    assert {type(m) for m in load_recording(log, FIELD).measurements} == {Odometry, LandmarkScan, ImageFeatures}
    assert errors_m(log)[0] < 0.05


def test_without_odometry_the_transforms_are_odometry(tmp_path):
    path = write_bag(
        tmp_path / "game.mcap", FIELD, 4.0, [topic for topic in USUAL if topic not in ("/odom", "/cmd_vel")]
    )
    log = LogFile(path)
    assert len(list(log.records(Odometry))) == round(4.0 * ODOM_HZ) + 1
    assert errors_m(log)[0] < 0.04


def test_a_start_an_estimate_and_headings_in_a_recording_are_used(tmp_path):
    topics = [
        topic for topic in (*USUAL, "/initialpose", "/amcl_pose", "/imu/mag", "/imu/data") if "image" not in topic
    ]
    path = write_bag(tmp_path / "game.mcap", FIELD, 3.0, topics)
    log = LogFile(path, LogMapping(compass=CompassSettings(north_rad=np.pi / 2)))
    (start,) = log.records(InitialPose)
    assert start.pose == pytest.approx(START, abs=1e-9)
    assert errors_m(log, start=None)[0] < 0.5
    headings = {record.stamp_ns: record.heading_rad for record in log.records(Compass)}
    truths = {record.stamp_ns: record.pose[2] for record in log.records(Truth)}
    assert len(truths) == 31
    assert [headings[stamp] for stamp in truths] == pytest.approx(list(truths.values()), abs=1e-6)
    metrics = evaluate(read_estimates(log), read_truth(log))
    assert metrics.ate_m.max < 1e-9
    assert metrics.consistency is not None


def test_half_a_recording_starts_where_the_robot_is_then(bag):
    log = LogFile(bag, start_s=4.0)
    assert errors_m(log, start=Moment(4.0).pose)[0] < 0.04


def test_a_recording_in_which_nothing_was_seen_says_what_is_missing(tmp_path):
    path = write_bag(tmp_path / "game.mcap", FIELD, 1.0, ["/odom"])
    with pytest.raises(
        FieldlocError, match="nothing to localize with: no usable message on /landmarks, /image_features"
    ):
        load_recording(LogFile(path), FIELD)
    path = write_bag(tmp_path / "game.mcap", FIELD, 1.0, ["/odom", "/markings_in_image"])
    log = LogFile(path)
    with pytest.raises(FieldlocError, match="no usable message on /landmarks, /markings_in_image"):
        load_recording(log, FIELD)
    assert "no camera intrinsics" in log.warnings[0]


# Foxglove's form


def foxglove_transform(stamp, parent, child, position, rotation):
    x, y, z, w = rotation.as_quat().tolist()
    return FrameTransform(
        timestamp=stamp,
        parent_frame_id=parent,
        child_frame_id=child,
        translation=Vector3(x=position[0], y=position[1], z=position[2]),
        rotation=Quaternion(x=x, y=y, z=z, w=w),
    )


def foxglove_pose(pose):
    turn = Quaternion(z=float(np.sin(pose[2] / 2)), w=float(np.cos(pose[2] / 2)))
    return FoxglovePose(position=Vector3(x=float(pose[0]), y=float(pose[1])), orientation=turn)


def write_foxglove(path: Path, bag: Path, seconds: float) -> Path:
    """Camera, transforms, odometry and truth as Foxglove has them; what was seen in fieldloc's own words."""
    seen = {features.stamp_ns: features for features in LogFile(bag).records(ImageFeatures)}
    with LogWriter(path) as log:
        for tick in range(round(seconds * ODOM_HZ) + 1):
            moment = Moment(tick / ODOM_HZ)
            stamp_ns = moment.stamp_ns
            stamp = Timestamp(*divmod(stamp_ns, 10**9))
            hip = moment.footprint_from_hip
            messages = {
                "/state": FoxgloveOdometry(
                    timestamp=stamp, frame_id="odom", body_frame_id="base_footprint", pose=foxglove_pose(moment.odom)
                ),
                "/transforms": FrameTransforms(
                    transforms=[foxglove_transform(stamp, "base_footprint", "base_link", *hip)]
                ),
            }
            if tick % (ODOM_HZ // IMAGE_HZ) == 0:
                messages["/vicon"] = PoseInFrame(timestamp=stamp, frame_id="world", pose=foxglove_pose(moment.pose))
                messages["/calibration"] = CameraCalibration(
                    timestamp=stamp,
                    frame_id="camera_optical_frame",
                    width=640,
                    height=480,
                    distortion_model="plumb_bob",
                    D=[0.0] * 5,
                    K=[500.0, 0.0, 319.5, 0.0, 500.0, 239.5, 0.0, 0.0, 1.0],
                )
            for topic, one in messages.items():
                source, data = of_sdk(one, topic)
                log.write_raw(source, stamp_ns, data)
            if stamp_ns in seen:
                log.write("/image_features", seen[stamp_ns])
    return path


def test_a_foxglove_recording_lands_there_too(tmp_path, bag):
    log = LogFile(write_foxglove(tmp_path / "game.mcap", bag, SECONDS))
    assert {role: log.roles[role] for role in ("odometry", "camera", "truth", "image_features")} == {
        "odometry": "/state",
        "camera": "/calibration",
        "truth": "/vicon",
        "image_features": "/image_features",
    }
    assert load_recording(log, FIELD).camera == CAMERA
    assert errors_m(log)[0] < 0.04
    assert log.warnings == ()


def test_a_topic_can_be_told_where_the_guess_is_wrong(bag):
    log = LogFile(bag, with_roles(LogMapping(), ["odometry=/cmd_vel"]))
    assert {record.velocity[0] for record in log.records(Odometry)} == {9.0}
