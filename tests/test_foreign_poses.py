import numpy as np
import pytest
from foreign_parts import NAN3, NAN4, about, ns, odometry_part, pose_part, surroundings, transform
from hypothesis import given
from hypothesis import strategies as st

from fieldloc.pose import rotation3
from logs.foreign.compass import CompassAdapter
from logs.foreign.parts import ImuPart, MagneticPart, OdometryPart, PosePart
from logs.foreign.poses import PoseAdapter, estimate, initial_pose, truth
from logs.foreign.settings import CompassSettings, FrameNames, InitialPoseSettings, LogMapping
from logs.foreign.surroundings import Unusable

COVARIANCE = np.diag([0.04, 0.09, 5.0, 6.0, 7.0, 0.01])


def one(adapter, part, stamp_s=1.0):
    (record,) = adapter.take("/pose", ns(stamp_s), part)
    return record


def test_a_pose_of_a_map_is_one_on_the_field():
    record = one(PoseAdapter(surroundings(), truth), pose_part(1.0, 2.0, -1.0, 0.5, frame="map", z=0.3, pitch=0.1))
    assert record.stamp_ns == ns(1.0)
    assert record.pose == pytest.approx([2.0, -1.0, 0.5])


def test_a_map_of_another_origin_is_carried_to_the_field_with_its_covariance():
    mapping = LogMapping(frames=FrameNames(field_from_map=(4.5, 3.0, np.pi / 2)))
    part = pose_part(1.0, 2.0, -1.0, 0.5, frame="map", covariance=COVARIANCE)
    record = one(PoseAdapter(surroundings(mapping=mapping), estimate), part)
    assert record.pose == pytest.approx([4.5 + 1.0, 3.0 + 2.0, 0.5 + np.pi / 2])
    assert record.covariance == pytest.approx(np.diag([0.09, 0.04, 0.01]))
    turn = rotation3(np.pi / 2)
    assert record.covariance == pytest.approx(turn @ np.diag([0.04, 0.09, 0.01]) @ turn.T)


def test_an_estimate_in_odom_is_carried_to_the_map_and_truth_is_not_touched_by_estimated_transforms():
    odom = transform("map", "odom", [1.0, 0.0, 0.0], about("z", np.pi / 2))
    part = pose_part(1.0, 2.0, 0.0, 0.0, frame="odom")
    assert one(PoseAdapter(surroundings(odom), estimate), part).pose == pytest.approx([1.0, 2.0, np.pi / 2])
    assert one(PoseAdapter(surroundings(odom), truth, False), part).pose == pytest.approx([2.0, 0.0, 0.0])
    assert one(PoseAdapter(surroundings(), estimate), part).pose == pytest.approx([2.0, 0.0, 0.0])


def test_the_pose_of_a_hip_is_that_of_the_robot_below_it():
    hip = transform("base_footprint", "base_link", [0.2, 0.0, 0.4])
    part = odometry_part(1.0, (1.0, 0.0, np.pi / 2), child="base_link")
    assert one(PoseAdapter(surroundings(hip), truth), part).pose == pytest.approx([1.0, -0.2, np.pi / 2])


@pytest.mark.parametrize("part", [PosePart(0, "map", NAN3, NAN4), PosePart(0, "map", np.zeros(3), np.zeros(4))])
def test_a_pose_that_is_no_number_is_refused(part):
    with pytest.raises(Unusable, match="not a number"):
        one(PoseAdapter(surroundings(), truth), part)


@pytest.mark.parametrize("covariance", [None, np.zeros((6, 6)), np.full((6, 6), np.nan), -COVARIANCE, np.ones((6, 6))])
def test_where_no_covariance_is_stated_a_start_has_the_usual_one_and_an_estimate_none(covariance):
    part = pose_part(1.0, 2.0, -1.0, 0.5, frame="map", covariance=covariance)
    usual = initial_pose(InitialPoseSettings(sigma_m=0.2, heading_sigma_rad=0.3))
    assert one(PoseAdapter(surroundings(), usual), part).covariance == pytest.approx(np.diag([0.04, 0.04, 0.09]))
    assert one(PoseAdapter(surroundings(), estimate), part).covariance.any() == np.False_


def test_a_covariance_that_is_stated_counts():
    part = pose_part(1.0, 2.0, -1.0, 0.5, frame="map", covariance=COVARIANCE)
    expected = pytest.approx(np.diag([0.04, 0.09, 0.01]))
    assert one(PoseAdapter(surroundings(), initial_pose(InitialPoseSettings())), part).covariance == expected
    whole = OdometryPart(part, odometry_part(1.0).twist)
    assert one(PoseAdapter(surroundings(), estimate), whole).covariance == expected


# Compass


def magnetic(field, frame="imu"):
    return MagneticPart(ns(1.0), frame, np.asarray(field, dtype=float))


def compass(part, *transforms, **settings):
    mapping = LogMapping(compass=CompassSettings(**settings))
    (record,) = CompassAdapter(surroundings(*transforms, mapping=mapping)).take("/mag", ns(1.0), part)
    return record


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-3.0, 3.0))
def test_a_leaning_magnetometer_gives_the_robot_s_heading(heading, north, pitch, roll, yaw):
    robot_from_imu = about("ZYX", yaw, pitch, roll)
    in_field = about("z", north).apply([2e-5, 0.0, -4e-5])  # the earth's field dips
    in_imu = (about("z", heading) * robot_from_imu).inv().apply(in_field)
    record = compass(
        magnetic(in_imu),
        transform("base_footprint", "imu", [0, 0, 0.4], robot_from_imu),
        north_rad=north,
        sigma_rad=0.2,
    )
    assert np.angle(np.exp(1j * (record.heading_rad - heading))) == pytest.approx(0.0, abs=1e-9)
    assert record.sigma_rad == 0.2


def test_a_magnetometer_of_which_no_transform_tells_is_taken_as_turned_like_the_robot_and_that_is_said():
    adapter = CompassAdapter(surroundings(mapping=LogMapping(compass=CompassSettings(north_rad=0.0))))
    (record,) = adapter.take("/mag", 0, magnetic([0.0, -1e-5, 0.0]))
    assert record.heading_rad == pytest.approx(np.pi / 2)
    assert "its axes are taken for the robot's" in adapter._around.notes.sentences({})[0]


@given(st.floats(-3.0, 3.0), st.floats(-0.4, 0.4), st.floats(-3.0, 3.0))
def test_an_imu_that_knows_its_heading_is_a_compass_if_its_zero_is_told(heading, pitch, zero):
    robot_from_imu = about("ZY", 0.7, pitch)
    world_from_imu = about("z", heading - zero) * robot_from_imu
    part = ImuPart(ns(1.0), "imu", world_from_imu.as_quat(), None, None)
    record = compass(part, transform("base_footprint", "imu", [0, 0, 0], robot_from_imu), imu_heading_rad=zero)
    assert np.angle(np.exp(1j * (record.heading_rad - heading))) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("part", "settings", "why"),
    [
        (magnetic([1e-5, 0, 0]), {}, "north_deg"),
        (magnetic([np.nan, 0, 0]), {"north_rad": 0.0}, "not a number"),
        (magnetic([0.0, 0, 5e-5]), {"north_rad": 0.0}, "no direction"),
        (ImuPart(0, "imu", np.array([0, 0, 0, 1.0]), None, None), {"north_rad": 0.0}, "imu_heading_deg"),
        (ImuPart(0, "imu", None, None, None), {"imu_heading_rad": 0.0}, "no orientation"),
        (ImuPart(0, "imu", np.zeros(4), None, None), {"imu_heading_rad": 0.0}, "no orientation"),
    ],
)
def test_what_tells_no_heading_is_refused_with_the_reason(part, settings, why):
    with pytest.raises(Unusable, match=why):
        compass(part, **settings)
