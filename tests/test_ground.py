import dataclasses

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fieldloc.camera import Camera
from fieldloc.covariance import central_difference
from fieldloc.ground import (
    ground_jacobians,
    project_points,
    robot_from_camera,
    robot_ground_points,
)
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray

CAMERA = Camera("pinhole", 640, 480, 500.0, 505.0, 319.5, 239.5, (-0.3, 0.1, 0.001, -0.002, -0.01))
FISHEYE = Camera("fisheye", 640, 480, 200.0, 200.0, 319.5, 239.5, (0.05, -0.01, 0.0, 0.0))
NOISE = np.diag([0.01, 0.01, 0.015, 0.008]) ** 2


def mount_at(parameters: FloatArray) -> CameraMount:
    """A mount of (height, pan, tilt, roll), beside the robot's axis."""
    height, pan, tilt, roll = (float(p) for p in parameters)
    return CameraMount(height, pan, tilt, roll, NOISE, x_m=0.05, y_m=-0.02)


mounts = st.tuples(st.floats(0.2, 1.5), st.floats(-3.1, 3.1), st.floats(0.2, 1.2), st.floats(-0.5, 0.5)).map(np.array)
# no pixel so high that it could see the horizon: it is at 240 - 500 tan(0.2) and lower
low_pixels = st.tuples(st.floats(100.0, 540.0), st.floats(330.0, 470.0)).map(np.array)


def test_pan_is_to_the_left_tilt_is_down_and_roll_takes_the_right_side_down() -> None:
    none = np.zeros((4, 4))
    forward, right = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(robot_from_camera(CameraMount(1, 0, 0, 0, none)) @ forward, [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(robot_from_camera(CameraMount(1, 0, 0, 0, none)) @ right, [0, -1, 0], atol=1e-15)
    assert (robot_from_camera(CameraMount(1, 0.1, 0, 0, none)) @ forward)[1] > 0
    assert (robot_from_camera(CameraMount(1, 0, 0.1, 0, none)) @ forward)[2] < 0
    assert (robot_from_camera(CameraMount(1, 0, 0, 0.1, none)) @ right)[2] < 0


def test_a_level_camera_sees_the_ground_where_the_papers_equations_14_and_15_say() -> None:
    h, f, theta = 0.6, 500.0, 0.3
    camera = Camera("pinhole", 640, 480, f, f, 320.0, 240.0)
    mount = CameraMount(h, -theta, 0.0, 0.0, NOISE)  # the paper pans to the right
    mu_x, mu_y = 85.0, -60.0  # the paper's sensor: y up, so the ground is at negative y
    point, mask = robot_ground_points(camera, mount, np.array([320.0 + mu_x, 240.0 - mu_y]))
    x_right = h * (mu_x * np.cos(theta) + f * np.sin(theta)) / -mu_y
    z_ahead = h * (-mu_x * np.sin(theta) + f * np.cos(theta)) / -mu_y
    assert mask
    np.testing.assert_allclose(point, [z_ahead, -x_right], rtol=1e-13)


@settings(deadline=None, max_examples=60)
@given(parameters=mounts, pixel=low_pixels, wide=st.booleans())
def test_a_ground_point_projects_back_to_its_pixel(parameters: FloatArray, pixel: FloatArray, wide: bool) -> None:
    camera, mount = FISHEYE if wide else CAMERA, mount_at(parameters)
    point, mask = robot_ground_points(camera, mount, pixel)
    if not mask:  # a roll can lift a low corner above the horizon
        assert np.isnan(point).all()
        return
    back, visible = project_points(camera, mount, np.append(point, 0.0))
    assert visible
    # far points magnify rounding: 1e-16 of the distance, seen under f / distance
    np.testing.assert_allclose(back, pixel, atol=1e-9)


@settings(deadline=None, max_examples=60)
@given(parameters=mounts, pixel=low_pixels, wide=st.booleans())
def test_jacobians_equal_central_differences(parameters: FloatArray, pixel: FloatArray, wide: bool) -> None:
    camera, mount = FISHEYE if wide else CAMERA, mount_at(parameters)
    point, mask = robot_ground_points(camera, mount, pixel)
    if not mask or np.linalg.norm(point) > 30.0 * mount.height_m:
        return
    to_pixel, to_mount = ground_jacobians(camera, mount, pixel)
    numeric = central_difference(lambda p: robot_ground_points(camera, mount, p)[0], pixel, step=1e-3)
    np.testing.assert_allclose(to_pixel, numeric, rtol=1e-5, atol=1e-7)
    numeric = central_difference(lambda m: robot_ground_points(camera, mount_at(m), pixel)[0], parameters)
    np.testing.assert_allclose(to_mount, numeric, rtol=1e-5, atol=1e-6)


def test_what_is_not_on_the_ground_is_masked() -> None:
    mount = mount_at(np.array([0.5, 0.0, 0.2, 0.0]))
    above = np.array([[320.0, 0.0], [320.0, 100.0], [np.nan, 300.0]])
    points, mask = robot_ground_points(CAMERA, mount, np.vstack([above, [[320.0, 300.0]]]))
    assert mask.tolist() == [False, False, False, True]
    assert np.isnan(points[:3]).all()
    assert np.isnan(ground_jacobians(CAMERA, mount, above)[0]).all()
    _, mask = robot_ground_points(CAMERA, dataclasses.replace(mount, height_m=0.0), np.array([320.0, 400.0]))
    assert not mask


def test_a_point_behind_the_camera_is_not_visible() -> None:
    mount = mount_at(np.array([0.5, 0.0, 0.2, 0.0]))
    _, visible = project_points(CAMERA, mount, np.array([[2.0, 0.0, 0.0], [-2.0, 0.0, 0.0]]))
    assert visible.tolist() == [True, False]
