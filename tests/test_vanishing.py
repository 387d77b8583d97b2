import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fieldloc.camera import Camera
from fieldloc.covariance import central_difference
from fieldloc.fixes.vanishing import bearing_of_vanishing_point, vanishing_points, vanishing_ray
from fieldloc.ground import project_points
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray, wrap

IDEAL = Camera("pinhole", 640, 480, 500.0, 500.0, 320.0, 240.0)
LENS = Camera("pinhole", 640, 480, 500.0, 505.0, 319.5, 239.5, (-0.3, 0.1, 0.001, -0.002, -0.01))
FISHEYE = Camera("fisheye", 640, 480, 200.0, 200.0, 319.5, 239.5, (0.05, -0.01, 0.0, 0.0))


def mount_at(parameters: FloatArray) -> CameraMount:
    height, pan, tilt, roll = (float(p) for p in parameters)
    return CameraMount(height, pan, tilt, roll, np.zeros((4, 4)), x_m=0.1)


mounts = st.tuples(st.floats(0.2, 1.5), st.floats(-3.1, 3.1), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)).map(np.array)


@pytest.mark.parametrize("tilt", [0.0, 0.35, -0.2])
@pytest.mark.parametrize("theta", [-1.2, -0.3, 0.4, 1.0])
def test_both_families_vanish_where_the_papers_limits_say(theta: float, tilt: float) -> None:
    """The limits for vz and vx to infinity; theta is how far to the right of the camera the lines along z run."""
    mount = mount_at(np.array([0.6, theta, tilt, 0.0]))  # lines along z have bearing 0, the camera looks left of them
    x_in_front = np.copysign(np.pi / 2, theta)  # the end of the lines along x that is before the camera
    pixels, _ = vanishing_points(IDEAL, mount, np.array([0.0, x_in_front]))
    x, y_up = (pixels[:, 0] - 320.0) / 500.0, -(pixels[:, 1] - 240.0) / 500.0
    np.testing.assert_allclose(x, np.array([np.tan(theta), -1 / np.tan(theta)]) / np.cos(tilt), rtol=1e-12)
    np.testing.assert_allclose(y_up, np.tan(tilt), atol=1e-12)


@settings(deadline=None, max_examples=60)
@given(parameters=mounts, offset=st.floats(-0.5, 0.5), camera=st.sampled_from([IDEAL, LENS, FISHEYE]))
def test_a_vanishing_point_gives_back_its_bearing(parameters: FloatArray, offset: float, camera: Camera) -> None:
    mount = mount_at(parameters)
    bearing = mount.pan_rad + offset
    pixel, visible = vanishing_points(camera, mount, np.array(bearing))
    assume(bool(visible))
    found = bearing_of_vanishing_point(camera, mount, pixel)
    assert found is not None
    np.testing.assert_allclose(wrap(found[0] - bearing), 0.0, atol=1e-12)


@settings(deadline=None, max_examples=60)
@given(parameters=mounts, u=st.floats(50.0, 590.0), v=st.floats(50.0, 430.0), camera=st.sampled_from([LENS, FISHEYE]))
def test_the_jacobians_of_the_bearing_equal_central_differences(
    parameters: FloatArray, u: float, v: float, camera: Camera
) -> None:
    pixel = np.array([u, v])

    def bearing(p: FloatArray, m: FloatArray) -> FloatArray:
        found = bearing_of_vanishing_point(camera, mount_at(m), p)
        assert found is not None
        return np.array([wrap(found[0] - reference)])

    reference = 0.0
    reference = float(bearing(pixel, parameters)[0])
    found = bearing_of_vanishing_point(camera, mount_at(parameters), pixel)
    assert found is not None
    numeric = central_difference(lambda p: bearing(p, parameters), pixel, step=1e-3)[0]
    np.testing.assert_allclose(found[1], numeric, rtol=1e-5, atol=1e-9)
    numeric = central_difference(lambda m: bearing(pixel, m), parameters)[0]
    np.testing.assert_allclose(found[2], numeric, rtol=1e-5, atol=1e-8)


def test_image_lines_of_one_family_meet_in_its_vanishing_point_without_any_attitude() -> None:
    mount = mount_at(np.array([0.6, 0.3, 0.4, 0.1]))
    along, left = np.array([np.cos(0.5), np.sin(0.5)]), np.array([-np.sin(0.5), np.cos(0.5)])
    ends = np.array([[d * left + s * along for s in (1.2, 3.0)] for d in (-0.5, 0.1, 0.5)])
    pixels, visible = project_points(LENS, mount, np.pad(ends, ((0, 0), (0, 0), (0, 1))))
    assert visible.all()
    meeting = vanishing_ray(LENS.ray(pixels)[0])
    assert meeting is not None
    expected, _ = vanishing_points(LENS, mount, np.array(0.5))
    np.testing.assert_allclose(LENS.project(meeting)[0], expected, atol=1e-8)


def test_lines_that_do_not_determine_a_vanishing_point_give_none() -> None:
    rays, _ = IDEAL.ray(np.array([[[100.0, 300.0], [200.0, 400.0]], [[150.0, 350.0], [250.0, 450.0]]]))
    assert vanishing_ray(rays) is None  # one image line, seen twice
    assert vanishing_ray(rays[:1]) is None
    assert vanishing_ray(np.zeros((0, 2, 3))) is None
    assert vanishing_ray(rays[:, [0, 0]]) is None  # segments without length
    assert vanishing_ray(np.full((2, 2, 3), np.nan)) is None


def test_straight_down_has_no_bearing_and_neither_has_a_pixel_without_a_ray() -> None:
    down = mount_at(np.array([0.6, 0.0, np.pi / 2, 0.0]))
    assert bearing_of_vanishing_point(IDEAL, down, np.array([320.0, 240.0])) is None
    assert bearing_of_vanishing_point(IDEAL, down, np.array([np.nan, 240.0])) is None
