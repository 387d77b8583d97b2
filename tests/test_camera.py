from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fieldloc.camera import Camera, load_camera
from fieldloc.covariance import central_difference
from fieldloc.errors import FieldlocError
from fieldloc.pose import FloatArray

PINHOLES = {
    "ideal": (),
    "barrel4": (-0.31, 0.11, 0.0012, -0.0021),
    "webcam5": (-0.31, 0.12, 0.0012, -0.0021, -0.015),
    "rational8": (0.21, -0.12, 0.001, -0.002, 0.011, 0.31, -0.05, 0.012),
    "prism12": (-0.3, 0.1, 0.001, -0.002, -0.01, 0.01, 0.02, 0.003, 0.002, -0.001, 0.003, 0.001),
    "flat14": (0.21, -0.12, 0.001, -0.002, 0.011, 0.31, -0.05, 0.012, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
}
FISHEYES = {"equidistant": (), "wide": (0.1, -0.03, 0.01, -0.002)}
MATRIX = np.array([[500.0, 0.0, 318.5], [0.0, 510.0, 241.25], [0.0, 0.0, 1.0]])
# a pixel of size ~1000 carries 1.1e-13 of rounding; projecting it takes about ten operations
ROUNDING_PX = 2e-12


def pinhole(name: str) -> Camera:
    return Camera("pinhole", 640, 480, 500.0, 510.0, 318.5, 241.25, PINHOLES[name])


def fisheye(name: str) -> Camera:
    # 160 px per radian: the corners look behind the camera
    return Camera("fisheye", 640, 480, 160.0, 165.0, 318.5, 241.25, FISHEYES[name])


CAMERAS = [pinhole(name) for name in PINHOLES] + [fisheye(name) for name in FISHEYES]


def pixels_on(camera: Camera, count: int = 500) -> FloatArray:
    rng = np.random.default_rng(3)
    return rng.uniform([0.0, 0.0], [camera.width_px - 1.0, camera.height_px - 1.0], (count, 2))


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_ray_projects_back_to_its_pixel_to_rounding(camera: Camera) -> None:
    pixels = pixels_on(camera)
    rays, exists = camera.ray(pixels)
    back, visible = camera.project(rays * np.linspace(0.1, 9.0, len(rays))[:, None])
    assert exists.mean() > 0.9  # all but the far corners of the widest lens
    np.testing.assert_allclose(np.linalg.norm(rays[exists], axis=-1), 1.0, rtol=1e-15 * 4)
    assert visible[exists].all()
    assert np.abs(back - pixels)[exists].max() < ROUNDING_PX


@pytest.mark.parametrize("name", PINHOLES)
def test_opencv_projects_our_rays_to_the_same_pixels(name: str) -> None:
    cv2 = pytest.importorskip("cv2")
    pixels = pixels_on(pinhole(name))
    rays, _ = pinhole(name).ray(pixels)
    theirs, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), MATRIX, np.array(PINHOLES[name]))
    assert np.abs(theirs[:, 0] - pixels).max() < ROUNDING_PX


@pytest.mark.parametrize("name", FISHEYES)
def test_opencv_fisheye_projects_our_rays_in_front_to_the_same_pixels(name: str) -> None:
    cv2 = pytest.importorskip("cv2")
    camera = fisheye(name)
    pixels = pixels_on(camera)
    rays, _ = camera.ray(pixels)
    front = rays[:, 2] > 0.0  # OpenCV folds what is behind the camera to the front
    matrix = np.diag([160.0, 165.0, 1.0])
    matrix[:2, 2] = 318.5, 241.25
    coefficients = np.array(camera.distortion or (0.0, 0.0, 0.0, 0.0))
    theirs, _ = cv2.fisheye.projectPoints(rays[front][:, None], np.zeros(3), np.zeros(3), matrix, coefficients)
    assert np.abs(theirs[:, 0] - pixels[front]).max() < ROUNDING_PX


def test_a_fisheye_sees_behind_itself() -> None:
    camera = fisheye("equidistant")
    angle = np.deg2rad(105.0)
    pixel, visible = camera.project(np.array([np.sin(angle), 0.0, np.cos(angle)]) * 7.0)
    np.testing.assert_allclose(pixel, [318.5 + 160.0 * angle, 241.25], rtol=1e-14)
    assert visible
    _, behind = camera.project(np.array([0.0, 0.0, -1.0]))
    assert not behind


rays_in_front = st.tuples(st.floats(-0.7, 0.7), st.floats(-0.5, 0.5), st.floats(0.5, 2.0)).map(
    lambda t: np.array([t[0] * t[2], t[1] * t[2], t[2]])
)


@settings(deadline=None, max_examples=40)
@given(ray=rays_in_front, index=st.integers(0, len(CAMERAS) - 1))
def test_jacobians_equal_central_differences(ray: FloatArray, index: int) -> None:
    camera = CAMERAS[index]
    numeric = central_difference(lambda r: camera.project(r)[0], ray)
    # the step of 1e-6 leaves rounding of 1e-13 px / 1e-6 and a third derivative of about 1e3 px times 1e-12
    np.testing.assert_allclose(camera.project_jacobian(ray), numeric, atol=2e-6)
    pixel, _ = camera.project(ray)
    numeric = central_difference(lambda p: camera.ray(p)[0], pixel, step=1e-3)
    np.testing.assert_allclose(camera.ray_and_jacobian(pixel)[1], numeric, atol=1e-11)


def test_jacobians_hold_on_the_axis_and_behind_a_fisheye() -> None:
    camera = fisheye("wide")
    for ray in np.array([[0.0, 0.0, 1.0], [0.0, 9.9e-324, 1.5], [1e-9, 0.0, 2.0], [1.0, 0.0, 0.0], [0.6, -0.7, -0.2]]):
        numeric = central_difference(lambda r: camera.project(r)[0], ray)
        np.testing.assert_allclose(camera.project_jacobian(ray), numeric, atol=2e-6)


def test_a_lens_that_turns_back_has_no_image_beyond_the_turn() -> None:
    camera = Camera("pinhole", 640, 480, 500.0, 500.0, 320.0, 240.0, (-0.4, 0.0, 0.0, 0.0))
    turn = np.sqrt(1.0 / 1.2)  # r (1 - 0.4 r^2) grows up to here
    pixels, visible = camera.project(np.array([[turn - 1e-3, 0, 1], [turn + 1e-3, 0, 1], [1.5, 0, 1], [2, 0, 1]]))
    assert np.isfinite(pixels[:, 0]).tolist() == [True, False, False, False]
    assert not visible[1:].any()
    outermost = 320.0 + 500.0 * turn * (1.0 - 0.4 * turn**2)
    _, exists = camera.ray(np.array([[outermost - 1.0, 240.0], [outermost + 1.0, 240.0]]))
    assert exists.tolist() == [True, False]


def test_a_decentred_lens_that_folds_has_no_image_beyond_the_fold() -> None:
    camera = Camera("pinhole", 640, 480, 500.0, 500.0, 320.0, 240.0, (0.0, 0.0, 0.4, 0.0))
    # on the axis y' = y + 1.2 y^2, which turns at y = -1 / 2.4, and x' = x (1 + 0.8 y)
    pixels, _ = camera.project(np.array([[0.0, -0.41, 1.0], [0.0, -0.42, 1.0], [0.0, -1.0, 1.0]]))
    assert np.isfinite(pixels[:, 0]).tolist() == [True, False, False]


def test_a_fisheye_that_turns_back_has_no_ray_beyond_the_turn() -> None:
    camera = Camera("fisheye", 640, 480, 160.0, 160.0, 320.0, 240.0, (-0.2, 0.0, 0.0, 0.0))
    turn = np.sqrt(1.0 / 0.6)
    outermost = 320.0 + 160.0 * turn * (1.0 - 0.2 * turn**2)
    rays, exists = camera.ray(np.array([[outermost - 1.0, 240.0], [outermost + 1.0, 240.0]]))
    assert exists.tolist() == [True, False]
    assert np.isnan(rays[1]).all()


@pytest.mark.parametrize("camera", [pinhole("webcam5"), pinhole("rational8"), fisheye("wide")])
def test_rays_and_pixels_that_are_nothing_are_masked_without_a_warning(camera: Camera) -> None:
    nothing = np.array([[0.0, 0.0, 0.0], [np.nan, 0.0, 1.0], [np.inf, 0.0, 1.0], [0.0, 0.0, -1.0]])
    pixels, visible = camera.project(nothing)
    assert not visible.any()
    assert np.isnan(pixels).all()
    _, exists = camera.ray(np.array([[np.nan, 0.0], [np.inf, 3.0]]))
    assert not exists.any()
    assert np.isnan(camera.ray_and_jacobian(np.array([np.nan, 1.0]))[1]).all()


def test_the_image_ends_half_a_pixel_beside_the_outer_centres() -> None:
    camera = pinhole("ideal")
    edges = np.array([[-0.5, 0.0], [-0.51, 0.0], [639.5, 479.5], [639.51, 0.0], [5.0, 479.6]])
    assert camera.contains(edges).tolist() == [True, False, True, False, False]
    pixels, visible = camera.project(np.array([2.0, 0.0, 1.0]))
    np.testing.assert_allclose(pixels, [1318.5, 241.25])
    assert not visible


GOOD = """
model = "pinhole"
width_px = 640
height_px = 480
fx_px = 500
fy_px = 501.5
cx_px = 319.5
cy_px = 239.5
distortion = [-0.3, 0.1, 0, 0]
"""


def test_a_camera_is_read_from_its_file(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(GOOD)
    assert load_camera(path) == Camera("pinhole", 640, 480, 500, 501.5, 319.5, 239.5, (-0.3, 0.1, 0.0, 0.0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD.replace("fx_px = 500\n", ""), "fx_px: missing"),
        (GOOD + "colour = 1", "colour: unknown key; known"),
        (GOOD.replace("pinhole", "mirror"), "'mirror', must be one of: pinhole, fisheye"),
        (GOOD.replace('"pinhole"', "3"), "model is 3"),
        (GOOD.replace('"pinhole"', '["pinhole"]'), "model is"),
        (GOOD.replace("501.5", '"501.5"'), "fy_px is '501.5', must be a number"),
        (GOOD.replace("501.5", "-501.5"), "must be positive"),
        (GOOD.replace("501.5", "nan"), "fy_px is nan"),
        (GOOD.replace("501.5", "true"), "fy_px is True"),
        (GOOD.replace("640", "640.5"), "width_px is 640.5, must be a positive whole number"),
        (GOOD.replace("640", "0"), "width_px is 0"),
        (GOOD.replace("[-0.3, 0.1, 0, 0]", "[1, 2, 3]"), "distortion has 3 coefficients, a pinhole takes"),
        (GOOD.replace("[-0.3, 0.1, 0, 0]", '["a"]'), "distortion is"),
        (GOOD.replace("[-0.3, 0.1, 0, 0]", '"none"'), "distortion is 'none'"),
        (GOOD.replace("[-0.3, 0.1, 0, 0]", f"{[0.0] * 13 + [0.01]}"), "tilted sensor"),
        (GOOD.replace("=", ":"), "not valid TOML"),
    ],
)
def test_a_mistake_in_a_camera_file_is_named_with_the_file(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(text)
    with pytest.raises(FieldlocError) as caught:
        load_camera(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_camera_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(FieldlocError, match="no such camera file"):
        load_camera(tmp_path / "absent.toml")
    with pytest.raises(FieldlocError, match="cannot be read"):
        load_camera(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FieldlocError, match="cannot be read"):
        load_camera(tmp_path / "binary.toml")
