from dataclasses import replace

import numpy as np
import pytest
from foreign_parts import NAN3, about, feed, ns, odometry_part, pose_part, surroundings, transform
from hypothesis import given
from hypothesis import strategies as st

from fieldloc import pose as se2
from logs.foreign.odometry import OdometryAdapter
from logs.foreign.parts import OdometryPart, PosePart, Transforms, TwistPart
from logs.foreign.settings import LogMapping, OdometrySettings
from logs.foreign.surroundings import Unusable


def odometry(parts, **around):
    return feed(OdometryAdapter(surroundings(**around)), parts)


def walk(velocities, period_s=0.1, start=(0.3, -0.2, 1.0)):
    """Poses (n + 1, 3) of a robot that holds each velocity for a period."""
    poses = [np.array(start)]
    for velocity in velocities:
        poses.append(se2.retract(poses[-1], np.asarray(velocity) * period_s))
    return poses


speeds = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-3.0, 3.0))


@given(st.lists(speeds, min_size=1, max_size=8), st.lists(st.floats(0.01, 2.0), min_size=8, max_size=8))
def test_the_velocities_held_from_stamp_to_stamp_lead_from_pose_to_pose(velocities, periods_s):
    """Whatever the messages' rate is, and whatever velocity they state."""
    stamps_s = np.cumsum([1.0, *periods_s])
    poses = [np.zeros(3)]
    for velocity, period_s in zip(velocities, periods_s, strict=False):
        poses.append(se2.retract(poses[-1], np.array(velocity) * min(period_s, 1.0)))
    parts = [odometry_part(t, pose, (9.0, 9.0, 9.0)) for t, pose in zip(stamps_s, poses, strict=False)]
    records = odometry(parts)
    assert [record.stamp_ns for record in records] == [part.pose.stamp_ns for part in parts]
    at = poses[0]
    has_moved = False
    for record, after, pose, period_s in zip(records, poses[1:], poses, periods_s, strict=False):
        has_moved = has_moved or bool(np.abs(se2.local(pose, after)).max() > 1e-9)
        if has_moved:
            at = se2.retract(at, record.velocity * round(period_s * 1e9) * 1e-9)
            assert se2.local(after, at) == pytest.approx(np.zeros(3), abs=1e-6)


@pytest.mark.parametrize("poses", [[(0.0, 0.0, 0.0)] * 5, [None] * 5])
def test_a_driver_that_fills_only_the_velocity_is_believed(poses):
    twists = [(0.1 * i, 0.0, 0.2) for i in range(5)]
    records = odometry(
        [odometry_part(i, pose, twist) for i, (pose, twist) in enumerate(zip(poses, twists, strict=True))]
    )
    assert [record.velocity.tolist() for record in records] == pytest.approx(np.array(twists))


@pytest.mark.parametrize("twist", [None, (0.0, 0.0, 0.0)])
def test_a_driver_that_fills_only_the_poses_is_believed(twist):
    poses = walk([(0.5, 0.0, 0.1)] * 4)
    records = odometry([odometry_part(0.1 * i, pose, twist) for i, pose in enumerate(poses)])
    assert [record.velocity for record in records] == pytest.approx(np.array([(0.5, 0.0, 0.1)] * 5), abs=1e-9)


def test_a_robot_that_stands_after_it_has_moved_stands_whatever_its_noisy_velocity_says():
    poses = [*walk([(0.5, 0.0, 0.0)] * 2), *[walk([(0.5, 0.0, 0.0)] * 2)[-1]] * 3]
    records = odometry([odometry_part(0.1 * i, pose, (0.01, 0.02, 0.03)) for i, pose in enumerate(poses)])
    assert [record.velocity.any() for record in records] == [True, True, False, False, False, False]


@pytest.mark.parametrize("twist", [(0.5, 0.0, 0.1), None])
def test_a_pose_that_jumps_to_zero_is_no_motion(twist):
    poses = [*walk([(0.5, 0.0, 0.1)] * 3, start=(8.0, 3.0, 2.0)), *walk([(0.5, 0.0, 0.1)] * 3, start=(0.0, 0.0, 0.0))]
    adapter = OdometryAdapter(surroundings())
    records = feed(adapter, [odometry_part(0.1 * i, pose, twist) for i, pose in enumerate(poses)])
    assert [record.velocity for record in records] == pytest.approx(np.array([(0.5, 0.0, 0.1)] * 8), abs=1e-9)
    (sentence,) = adapter._around.notes.sentences({})
    assert "poses jump, the first time at 0.300 s" in sentence


def test_the_top_speed_can_be_told():
    fast = walk([(8.0, 0.0, 0.0)] * 3, period_s=1.0)
    parts = [odometry_part(float(i), pose) for i, pose in enumerate(fast)]
    assert max(record.velocity[0] for record in odometry(parts)) == 0.0
    mapping = LogMapping(odometry=OdometrySettings(max_speed_mps=10.0))
    assert odometry(parts, mapping=mapping)[0].velocity == pytest.approx([8.0, 0.0, 0.0])


def test_a_message_that_is_no_number_costs_nothing_but_itself():
    poses = walk([(0.5, 0.0, 0.0)] * 4)
    parts = [odometry_part(0.1 * i, pose) for i, pose in enumerate(poses)]
    adapter = OdometryAdapter(surroundings())
    records = []
    for i, part in enumerate(parts):
        if i == 2:
            with pytest.raises(Unusable, match="neither pose nor velocity is a number"):
                list(adapter.take("/odom", ns(0.2), odometry_part(0.2)))
        else:
            records += adapter.take("/odom", part.pose.stamp_ns, part)
    assert [record.velocity[0] for record in records] == pytest.approx([0.5, 0.5, 0.5])
    assert [record.stamp_ns for record in records] == [ns(0.0), ns(0.1), ns(0.3)]


def test_messages_that_come_twice_or_late_are_no_motion_and_a_clock_that_was_set_starts_anew():
    poses = walk([(0.5, 0.0, 0.0)] * 4)
    adapter = OdometryAdapter(surroundings())
    parts = [odometry_part(10.0 + 0.1 * i, pose) for i, pose in enumerate(poses)]
    records = [*adapter.take("/odom", ns(10.0), parts[0]), *adapter.take("/odom", ns(10.1), parts[1])]
    records += adapter.take("/odom", ns(10.1), parts[1])
    with pytest.raises(Unusable, match="before that of the message logged before it"):
        list(adapter.take("/odom", ns(10.0), parts[0]))
    records += adapter.take("/odom", ns(10.2), parts[2])
    records += adapter.take("/odom", ns(1.0), replace(parts[3]))
    records += adapter.take("/odom", ns(1.1), parts[4])
    assert [(r.stamp_ns, r.velocity[0]) for r in records] == [
        (ns(10.0), pytest.approx(0.5)),
        (ns(10.1), pytest.approx(0.5)),
        (ns(1.0), pytest.approx(0.5)),
    ]


def test_poses_in_space_are_seen_from_above():
    flat = walk([(0.5, 0.1, 0.3)] * 3)
    parts = [
        OdometryPart(
            pose_part(0.1 * i, *pose, z=0.3 + 0.01 * i, pitch=0.2), TwistPart(ns(0.1 * i), "base_footprint", NAN3, NAN3)
        )
        for i, pose in enumerate(flat)
    ]
    assert odometry(parts)[0].velocity == pytest.approx([0.5, 0.1, 0.3])


def test_the_motion_of_another_frame_of_the_robot_is_that_of_the_robot():
    """A hip 0.1 m ahead of the footprint, turned a quarter to the left and higher up."""
    hip = transform("base_footprint", "base_link", [0.1, 0.0, 0.4], about("z", np.pi / 2))
    velocity = np.array([0.4, 0.1, 0.5])
    robot = walk([velocity] * 3)
    hip_pose = np.array([0.1, 0.0, np.pi / 2])
    # the velocity of the hip's origin, along the hip's axes
    x, y = velocity[:2] + velocity[2] * np.array([0.0, 0.1])
    twist = (y, -x, 0.5)
    for poses in ([se2.compose(pose, hip_pose) for pose in robot], [None] * 4):
        parts = [odometry_part(0.1 * i, pose, twist, child="base_link") for i, pose in enumerate(poses)]
        records = feed(OdometryAdapter(surroundings(hip)), parts)
        assert records[0].velocity == pytest.approx(velocity)


def test_a_velocity_alone_is_odometry_too():
    twist = TwistPart(ns(1.0), "", np.array([0.3, 0.1, 0.0]), np.array([0.0, 0.0, 0.2]))
    first, last = odometry([twist, replace(twist, stamp_ns=ns(1.1), linear=np.zeros(3))])
    assert first.velocity == pytest.approx([0.3, 0.1, 0.2])
    assert last.velocity == pytest.approx([0.0, 0.0, 0.2])


def test_poses_alone_are_odometry_too():
    records = odometry([pose_part(0.1 * i, *pose) for i, pose in enumerate(walk([(0.5, 0.0, 0.1)] * 3))])
    assert records[1].velocity == pytest.approx([0.5, 0.0, 0.1])


def test_transforms_from_odom_to_a_frame_of_the_robot_are_odometry():
    hip = transform("base_link", "base_footprint", [0.0, 0.0, -0.4])
    adapter = OdometryAdapter(surroundings(hip))
    records = []
    for i, (x, y, yaw) in enumerate(walk([(0.5, 0.0, 0.1)] * 3)):
        stamp_s = 5.0 + 0.1 * i
        odom = transform("odom", "base_link", [x, y, 0.4], about("z", yaw), stamp_s)
        other = transform("base_link", "head", [float(i), 0.0, 0.0], None, stamp_s)
        records += adapter.take("/tf", ns(stamp_s + 0.01), Transforms((other, odom)))
    assert [record.stamp_ns for record in records] == [ns(5.0), ns(5.1), ns(5.2)]
    assert [record.velocity for record in records] == pytest.approx(np.array([(0.5, 0.0, 0.1)] * 3), abs=1e-9)


# Covariance


def with_covariance(matrix, settings=None):
    mapping = LogMapping(odometry=settings or OdometrySettings())
    (record,) = odometry([odometry_part(0.0, None, (0.1, 0.0, 0.0), covariance=matrix)], mapping=mapping)
    return record.covariance


def test_the_covariance_of_a_velocity_is_its_forward_left_and_turn_block():
    full = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    full[0, 1] = full[1, 0] = 0.5
    full[0, 5] = full[5, 0] = 0.25
    assert with_covariance(full) == pytest.approx(np.array([[1.0, 0.5, 0.25], [0.5, 2.0, 0.0], [0.25, 0.0, 6.0]]))
    assert with_covariance(full, OdometrySettings(use_covariance=False)) is None


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 0.0]),
        np.diag([1.0, 0.0, 0.0, 1.0, 1.0, 1.0]),
        np.diag([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
        np.diag([1e6, 1.0, 1.0, 1.0, 1.0, 1.0]),
        np.full((6, 6), np.nan),
        np.full((6, 6), 1.0),
    ],
)
def test_a_covariance_that_cannot_be_meant_is_none(matrix):
    assert with_covariance(matrix) is None


def test_the_covariance_of_a_turned_frame_is_turned():
    base = transform("base_footprint", "base_link", [0.0, 0.0, 0.4], about("z", np.pi / 2))
    part = odometry_part(
        0.0, None, (0.1, 0.0, 0.0), child="base_link", covariance=np.diag([1.0, 2.0, 1.0, 1.0, 1.0, 3.0])
    )
    (record,) = feed(OdometryAdapter(surroundings(base)), [part])
    assert record.covariance == pytest.approx(np.diag([2.0, 1.0, 3.0]))


def test_a_pose_part_of_nothing_is_refused():
    nothing = PosePart(0, "odom", NAN3, np.array([0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(Unusable):
        list(OdometryAdapter(surroundings()).take("/odom", 0, nothing))
