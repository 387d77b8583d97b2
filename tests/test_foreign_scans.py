import numpy as np
import pytest
from foreign_parts import about, ns, surroundings, transform
from scipy.spatial.transform import Rotation

from fieldloc.ground import robot_from_camera
from fieldloc.measurements import CameraMount
from logs.foreign.parts import SpaceDetectionsPart
from logs.foreign.scans import ScanAdapter
from logs.foreign.settings import DetectionNoise, FrameNames, LogMapping, MountSettings
from logs.foreign.surroundings import Unusable

CAMERA_AT_HALF_A_METRE = transform(
    "base_footprint",
    "camera_optical_frame",
    [0.0, 0.0, 0.5],
    Rotation.from_matrix(robot_from_camera(CameraMount(1.0, 0.0, 0.2, 0.0, np.eye(4)))),
)


def posts(*points, frame="base_footprint", confidences=None):
    points = np.array(points, dtype=float).reshape(-1, 3)
    sure = np.full(len(points), np.nan) if confidences is None else np.array(confidences)
    return SpaceDetectionsPart(ns(1.0), frame, points, sure, np.zeros((0, 2, 3)), np.zeros(0))


def scan(part, *transforms, **options):
    (record,) = ScanAdapter(surroundings(*transforms, **options)).take("/posts", ns(1.0), part)
    return record


def test_posts_on_the_ground_are_ranges_and_bearings_of_nobody_in_particular():
    record = scan(posts((3.0, 4.0, 0.0), (2.0, -2.0, 0.7)))
    assert record.labels == (None, None)
    assert record.range_bearing == pytest.approx(np.array([[5.0, np.arctan2(4, 3)], [8**0.5, -np.pi / 4]]))
    assert record.robot_from_sensor.tolist() == [0.0, 0.0, 0.0]
    assert len(scan(posts()).labels) == 0


def test_posts_in_another_frame_of_the_robot_are_carried_to_the_robot_s():
    hip = transform("base_footprint", "base_link", [0.5, 0.0, 0.4], about("z", np.pi / 2))
    assert scan(posts((2.0, 0.0, 0.0), frame="base_link"), hip).range_bearing == pytest.approx(
        np.array([[np.hypot(0.5, 2.0), np.arctan2(2.0, 0.5)]])
    )


def test_with_a_camera_of_known_height_the_range_is_as_unsure_as_the_camera_s_tilt_makes_it():
    """Moved by the tilt's sigma, a pixel that showed the post's foot shows another range."""
    record = scan(posts((1.0, 0.0, 0.0), (4.0, 0.0, 0.0)), CAMERA_AT_HALF_A_METRE)
    sigma = np.sqrt(record.covariance[:, 0, 0] - 0.03**2)
    for range_m, found in zip((1.0, 4.0), sigma, strict=True):
        step = 1e-6
        moved = 0.5 / np.tan(np.arctan2(0.5, range_m) - step)
        assert found == pytest.approx((moved - range_m) / step * np.radians(1.0), rel=1e-4)
    assert np.sqrt(record.covariance[:, 1, 1]) == pytest.approx(np.radians(1.5))


def test_without_one_it_is_a_share_of_the_range():
    noise = DetectionNoise(range_sigma_m=0.1, range_sigma_relative=0.2, bearing_sigma_rad=0.3)
    record = scan(posts((2.0, 0.0, 0.0)), mapping=LogMapping(detections=noise))
    assert record.covariance == pytest.approx(np.diag([0.1**2 + 0.4**2, 0.09])[None])


def test_a_height_that_is_told_serves_too():
    told = LogMapping(mount=MountSettings(fixed=CameraMount(1.0, 0.0, 0.0, 0.0, np.eye(4)), tilt_sigma_rad=0.1))
    record = scan(posts((2.0, 0.0, 0.0)), mapping=told)
    assert record.covariance[0, 0, 0] == pytest.approx(0.03**2 + (5.0 * 0.1) ** 2)


def test_posts_that_are_none_and_those_in_nowhere():
    with pytest.raises(Unusable, match="not finite"):
        scan(posts((1.0, np.nan, 0.0)))
    with pytest.raises(Unusable, match="where gripper is on the robot is not said"):
        scan(posts((1.0, 0.0, 0.0), frame="gripper"))
    told = LogMapping(detections=DetectionNoise(min_confidence=0.5))
    assert scan(posts((1.0, 0.0, 0.0), (2.0, 0.0, 0.0), confidences=[0.4, 0.6]), mapping=told).range_bearing[
        :, 0
    ].tolist() == [2.0]
    assert scan(posts((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))).range_bearing[:, 0].tolist() == [1.0]


def test_a_robot_frame_that_is_told_is_the_robot():
    told = LogMapping(frames=FrameNames(robot="/trunk"))
    assert scan(posts((1.0, 0.0, 0.0), frame="trunk"), mapping=told).range_bearing[0, 0] == 1.0
    base = transform("trunk", "base_footprint", [1.0, 0.0, 0.0])
    assert scan(posts((1.0, 0.0, 0.0)), base, mapping=told).range_bearing[0, 0] == 2.0
