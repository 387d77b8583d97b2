import cv2
import numpy as np
import pytest
from foreign_parts import about, camera_part, feed, surroundings, transform
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fieldloc.camera import Camera
from fieldloc.ground import project_points, robot_from_camera
from fieldloc.measurements import CameraMount
from logs.foreign.camera import CameraAdapter, camera_of
from logs.foreign.rotations import motion
from logs.foreign.settings import FrameNames, LogMapping, MountSettings
from logs.foreign.surroundings import Unusable, mount_of

K = np.array([[500.0, 0.0, 319.5], [0.0, 510.0, 239.5], [0.0, 0.0, 1.0]])
OPTICAL = robot_from_camera(CameraMount(1.0, 0.0, 0.0, 0.0, np.eye(4)))


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("plumb_bob", (-0.3, 0.1, 0.001, -0.002, 0.02)),
        ("plumb_bob", (-0.3, 0.1, 0.001, -0.002)),
        ("plumb_bob", (-0.3, 0.0, 0.0, 0.0, 0.0)),
        ("rational_polynomial", (0.4, -0.1, 0.001, 0.002, 0.01, 0.5, 0.05, 0.01)),
        ("rational_polynomial", (0.4, -0.1, 0.001, 0.002, 0.01, 0.5, 0.05, 0.01, *[0.0] * 6)),
        ("", (-0.2, 0.05, 0.0, 0.0, 0.0)),
        ("plumb_bob", ()),
        ("plumb_bob", (0.0,) * 5),
        ("none", (9.0, 9.0)),
    ],
)
def test_a_pinhole_camera_of_ros_is_the_camera_that_opencv_makes_of_it(model, coefficients):
    camera = camera_of(camera_part(model, coefficients, K))
    points = np.array([[0.1, 0.05, 1.0], [-0.3, 0.2, 1.0], [0.4, -0.3, 1.0]])
    given = np.array(coefficients) if model != "none" else np.zeros(4)
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, given if len(given) else None)
    assert camera.project(points)[0] == pytest.approx(expected.reshape(-1, 2), abs=1e-9)


@pytest.mark.parametrize("model", ["equidistant", "fisheye", "kannala_brandt4"])
@pytest.mark.parametrize("coefficients", [(0.1, -0.02, 0.003, -0.001), (0.0,) * 4, ()])
def test_a_fisheye_camera_is_one_even_where_its_coefficients_are_zero(model, coefficients):
    camera = camera_of(camera_part(model, coefficients, K))
    points = np.array([[0.5, 0.2, 1.0], [-1.0, 0.7, 1.0]])
    given = np.array(coefficients) if coefficients else np.zeros(4)
    expected, _ = cv2.fisheye.projectPoints(points[None], np.zeros(3), np.zeros(3), K, given)
    assert camera.project(points)[0] == pytest.approx(expected.reshape(-1, 2), abs=1e-9)


def test_of_rectified_pictures_the_lens_is_gone():
    assert camera_of(camera_part("plumb_bob", (-0.3, 0.1, 0.0, 0.0, 0.0)), rectified=True).distortion == ()
    assert camera_of(camera_part("equidistant", (0.1, 0.1, 0.0, 0.0)), rectified=True).model == "pinhole"


@pytest.mark.parametrize(
    ("part", "why"),
    [
        (camera_part(matrix=np.zeros((3, 3))), "not calibrated"),
        (camera_part(matrix=np.full((3, 3), np.nan)), "not calibrated"),
        (camera_part(size=(0, 0)), "how large"),
        (camera_part("omnidirectional", (0.1, 0.2, 0.0, 0.0)), "'omnidirectional' is not known; known are plumb_bob"),
        (camera_part("plumb_bob", (0.1, 0.2, np.nan, 0.0)), "refused"),
        (camera_part("plumb_bob", [0.1] * 20), "refused"),
        (camera_part("equidistant", [0.1] * 5), "refused"),
    ],
)
def test_what_is_no_camera_is_refused_with_the_reason(part, why):
    with pytest.raises(Unusable, match=why):
        camera_of(part)


def test_a_camera_is_told_once_and_again_when_it_changes():
    parts = [camera_part()] * 3 + [camera_part(distortion=(-0.1, 0.0, 0.0, 0.0, 0.0))] * 2
    assert [camera.distortion for camera in feed(CameraAdapter(surroundings()), parts)] == [(), (-0.1, 0.0, 0.0, 0.0)]


# The mount


@given(st.floats(-3.1, 3.1), st.floats(-1.4, 1.4), st.floats(-3.1, 3.1))
def test_pan_tilt_and_roll_of_a_mount_make_the_rotation_of_the_transform(pan, tilt, roll):
    rotation = about("ZYX", pan, tilt, roll).as_matrix() @ OPTICAL
    mount = mount_of(motion(np.array([0.1, 0.2, 0.6]), Rotation.from_matrix(rotation).as_quat()), MountSettings())
    assert robot_from_camera(mount) == pytest.approx(rotation, abs=1e-9)
    assert (mount.pan_rad, mount.tilt_rad, mount.roll_rad) == pytest.approx((pan, tilt, roll), abs=1e-6)
    assert (mount.x_m, mount.y_m, mount.height_m) == pytest.approx((0.1, 0.2, 0.6))


def test_what_the_mount_shows_is_what_the_transforms_show():
    """A head on a leaning body, and a camera frame made as ROS's URDFs make it."""
    body = transform("base_footprint", "base_link", [0.01, 0.02, 0.4], about("ZYX", 0.0, 0.1, -0.05))
    head = transform("base_link", "head", [0.0, 0.0, 0.2], about("ZY", 0.6, 0.3))
    optical = transform("head", "camera_optical_frame", [0.05, 0.0, 0.03], about("ZYX", -np.pi / 2, 0.0, -np.pi / 2))
    around = surroundings(body, head, optical)
    mount = around.mount("camera_optical_frame", 0)
    points = np.array([[1.5, 0.8, 0.0], [2.0, 1.5, 0.4], [1.2, 0.6, 0.1]])
    rotation, place = around.frames.lookup("base_footprint", "camera_optical_frame", 0)
    camera = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)
    expected = camera.project((points - place) @ rotation)[0]
    assert project_points(camera, mount, points)[0] == pytest.approx(expected, abs=1e-9)
    assert mount.pan_rad == pytest.approx(0.6, abs=0.1)
    assert mount.tilt_rad > 0.2
    sigmas = np.sqrt(np.diag(mount.covariance))
    assert sigmas == pytest.approx([0.01, *np.radians([1.0, 1.0, 1.0])])


def level_camera(height_m=0.5, frame="camera_optical_frame"):
    return transform("base_footprint", frame, [0.0, 0.0, height_m], Rotation.from_matrix(OPTICAL))


def test_the_frame_of_the_picture_is_asked_first_then_that_of_the_camera():
    both = (level_camera(0.5, "left"), level_camera(0.7, "camera_optical_frame"))
    assert surroundings(*both).mount("left", 0).height_m == 0.5
    assert surroundings(*both).mount("", 0).height_m == 0.7
    assert surroundings(*both).mount("unheard_of", 0).height_m == 0.7
    told = LogMapping(frames=FrameNames(camera="/camera_optical_frame"))
    assert surroundings(*both, mapping=told).mount("left", 0).height_m == 0.7


def test_a_robot_frame_above_the_ground_can_be_told():
    hip = transform("base_link", "camera_optical_frame", [0.0, 0.0, 0.2], Rotation.from_matrix(OPTICAL))
    mapping = LogMapping(frames=FrameNames(robot_height_m=0.4))
    assert surroundings(hip, mapping=mapping).mount("", 0).height_m == pytest.approx(0.6)


def test_a_mount_that_is_told_needs_no_transforms():
    fixed = CameraMount(0.6, 0.0, 0.3, 0.0, np.eye(4))
    assert surroundings(mapping=LogMapping(mount=MountSettings(fixed=fixed))).mount("any", 0) is fixed


@pytest.mark.parametrize(
    ("transforms", "mapping", "why"),
    [
        ((), LogMapping(), r"where camera is on the robot is not said: the log has no transforms; give \[mount\]"),
        ((transform("trunk", "camera", [0, 0, 1]),), LogMapping(), "none of the transforms names base_footprint"),
        ((transform("base_link", "arm", [0, 0, 1]),), LogMapping(), "no transform ever leads from base_link to camera"),
        (
            (level_camera(-0.5, "camera"),),
            LogMapping(),
            "is -0.50 m above frame base_footprint, which must be the ground",
        ),
        (
            (level_camera(0.5, "camera"),),
            LogMapping(frames=FrameNames(robot="torso")),
            "no transform ever leads from torso to camera",
        ),
    ],
)
def test_where_nothing_tells_of_the_camera_the_way_out_is_named(transforms, mapping, why):
    with pytest.raises(Unusable, match=why):
        surroundings(*transforms, mapping=mapping, camera_frame="").mount("camera", 0)


def test_a_frame_that_is_no_optical_one_is_noticed():
    around = surroundings(transform("base_footprint", "camera", [0.0, 0.0, 0.5]), camera_frame="")
    around.mount("camera", 0)
    assert "must be" not in str(around.notes.sentences({}))
    sideways = surroundings(transform("base_footprint", "camera", [0.0, 0.0, 0.5], about("y", 0.3)), camera_frame="")
    sideways.mount("camera", 0)
    assert "optical frame" in sideways.notes.sentences({})[0]
