"""What we write for ROS 2, read back by two decoders that others wrote."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from estimators.base import Estimate
from fieldloc.pose import FloatArray, compose, inverse
from logs import ros
from logs.foreign.parts import OdometryPart, PosePart, Transform, Transforms
from logs.ros.results import Frames, ros2_messages, sources
from logs.source import Encoded
from logs.writer import LogWriter

STAMP_NS = 1_700_000_000_123_456_789
COVARIANCE = np.array([[0.04, 0.01, -0.002], [0.01, 0.09, 0.003], [-0.002, 0.003, 0.0025]])
IN_ROS = np.ix_([0, 1, 5], [0, 1, 5])


def estimate(pose: tuple[float, float, float] = (1.5, -2.25, 2.5), stamp_ns: int = STAMP_NS) -> Estimate:
    return Estimate(stamp_ns, np.array(pose), COVARIANCE)


def heading(rotation: FloatArray) -> float:
    """Of a quaternion (x, y, z, w) about the vertical."""
    x, y, z, w = rotation
    assert (x, y) == (0, 0)
    assert z**2 + w**2 == pytest.approx(1, abs=1e-15)
    return float(2 * np.arctan2(z, w))


def same_pose(translation: FloatArray, rotation: FloatArray, pose: FloatArray) -> None:
    np.testing.assert_allclose(translation, [pose[0], pose[1], 0], atol=1e-14)
    turn = heading(rotation) - pose[2]
    assert np.cos(turn) == pytest.approx(1, abs=1e-14)


def parts(messages: tuple[Encoded, ...]) -> tuple[PosePart, OdometryPart, tuple[Transform, ...]]:
    """As our own decoder reads them, from the definitions that go with them."""
    out = []
    for message in messages:
        decode = ros.decoder(message.source)
        assert decode is not None
        out.append(decode(message.data))
    pose, odometry, tree = out
    assert isinstance(pose, PosePart)
    assert isinstance(odometry, OdometryPart)
    assert isinstance(tree, Transforms)
    return pose, odometry, tree.transforms


@pytest.mark.parametrize("pose", [(1.5, -2.25, 2.5), (0.0, 0.0, 0.0), (-4.5, 3.0, -np.pi), (0.1, 0.2, 3 * np.pi)])
def test_pose_and_covariance_are_those_of_the_estimate(pose: tuple[float, float, float]) -> None:
    part, odometry, _ = parts(ros2_messages(estimate(pose), None))
    for each in (part, odometry.pose):
        assert (each.stamp_ns, each.frame) == (STAMP_NS, "map")
        same_pose(each.position, each.rotation, np.array(pose))
        assert each.covariance is not None
        np.testing.assert_array_equal(each.covariance[IN_ROS], COVARIANCE)
        assert np.count_nonzero(each.covariance) == 9
    assert odometry.twist.frame == "base_footprint"
    assert odometry.twist.covariance is None


def test_without_odometry_the_robot_is_in_the_map() -> None:
    _, _, (only,) = parts(ros2_messages(estimate(), None))
    assert (only.parent, only.child, only.stamp_ns) == ("map", "base_footprint", STAMP_NS)
    same_pose(only.translation, only.rotation, estimate().pose)


def test_with_odometry_the_two_transforms_make_the_estimate() -> None:
    random = np.random.default_rng(0)
    for _ in range(20):
        field_from_robot, odom_from_robot = random.normal(size=(2, 3)) * [3, 3, 2]
        message = ros2_messages(estimate(tuple(field_from_robot)), odom_from_robot)
        _, _, (map_to_odom, odom_to_robot) = parts(message)
        assert (map_to_odom.parent, map_to_odom.child) == ("map", "odom")
        assert (odom_to_robot.parent, odom_to_robot.child) == ("odom", "base_footprint")
        assert map_to_odom.stamp_ns == odom_to_robot.stamp_ns == STAMP_NS
        same_pose(odom_to_robot.translation, odom_to_robot.rotation, odom_from_robot)
        field_from_odom = compose(field_from_robot, inverse(odom_from_robot))
        same_pose(map_to_odom.translation, map_to_odom.rotation, field_from_odom)


def test_frames_have_the_names_they_are_given() -> None:
    """Of all lengths, since what stands behind a name is aligned."""
    for length in range(1, 10):
        frames = Frames("f" * length, "ö" * length, "r" * (11 - length))
        pose, odometry, (first, second) = parts(ros2_messages(estimate(), np.zeros(3), frames))
        assert (pose.frame, odometry.pose.frame, odometry.twist.frame) == (frames.field, frames.field, frames.robot)
        assert (first.parent, first.child, second.parent, second.child) == (
            frames.field,
            frames.odom,
            frames.odom,
            frames.robot,
        )
        same_pose(pose.position, pose.rotation, estimate().pose)
        same_pose(second.translation, second.rotation, np.zeros(3))


@pytest.mark.parametrize("stamp_ns", [0, 1, 999_999_999, 10**9, 2**31 * 10**9 - 1])
def test_stamps_are_kept_to_the_nanosecond(stamp_ns: int) -> None:
    messages = ros2_messages(estimate(stamp_ns=stamp_ns), np.zeros(3))
    pose, odometry, tree = parts(messages)
    assert {pose.stamp_ns, odometry.pose.stamp_ns, *(one.stamp_ns for one in tree)} == {stamp_ns}
    assert {message.log_time_ns for message in messages} == {stamp_ns}


@pytest.mark.parametrize("stamp_ns", [-1, 2**31 * 10**9, 2**63 - 1])
def test_stamps_that_ros_cannot_hold_are_refused(stamp_ns: int) -> None:
    with pytest.raises(ValueError, match=f"stamp {stamp_ns} ns is .* cannot hold"):
        ros2_messages(estimate(stamp_ns=stamp_ns), None)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "results.mcap"
    with LogWriter(path, profile="ros2") as writer:
        for number in range(5):
            one = estimate((number / 3, 1.0, 0.5), STAMP_NS + number * 10**8)
            for message in ros2_messages(one, np.array([0.25, number, -0.5])):
                writer.add_encoded(message)
    return path


def test_rosbags_reads_them_with_the_definitions_in_the_file(log: Path) -> None:
    """And finds, from them, the hashes of the types of a ROS installation."""
    counts: dict[str, int] = {}
    with AnyReader([log]) as reader:
        for connection in reader.connections:
            counts[connection.topic] = connection.msgcount
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/tf":
                first, second = message.transforms
                assert (first.header.frame_id, first.child_frame_id) == ("map", "odom")
                assert second.transform.translation.x == 0.25
                header = second.header
            else:
                header = message.header
                assert message.pose.pose.position.x == pytest.approx((time - STAMP_NS) / 3e8)
                np.testing.assert_array_equal(message.pose.covariance.reshape(6, 6)[IN_ROS], COVARIANCE)
            assert header.stamp.sec * 10**9 + header.stamp.nanosec == time
    assert counts == {"/fieldloc/odometry": 5, "/fieldloc/pose_with_covariance": 5, "/tf": 5}


def test_mcap_ros2_reads_them_with_the_definitions_in_the_file(log: Path) -> None:
    seen = []
    with log.open("rb") as file:
        for _, channel, message, decoded in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            seen.append(channel.topic)
            assert message.log_time >= STAMP_NS
            if channel.topic == "/tf":
                assert [one.child_frame_id for one in decoded.transforms] == ["odom", "base_footprint"]
                assert decoded.transforms[1].transform.translation.x == 0.25
            else:
                assert decoded.header.frame_id == "map"
                assert decoded.pose.pose.position.y == 1.0
                assert decoded.pose.covariance[35] == COVARIANCE[2, 2]
    assert sorted(set(seen)) == ["/fieldloc/odometry", "/fieldloc/pose_with_covariance", "/tf"]
    assert len(seen) == 15


def test_the_channels_are_as_rosbag2_makes_them() -> None:
    for source in sources():
        assert (source.message_encoding, source.schema_encoding) == ("cdr", "ros2msg")
        assert "offered_qos_profiles" in source.metadata
        assert source.schema_data.count(b"=" * 80 + b"\nMSG: ") == source.schema_data.count(b"MSG: ") > 4
    assert [message.source for message in ros2_messages(estimate(), None)] == list(sources())
