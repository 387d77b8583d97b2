"""Figure 6 and Table 1 of the paper, in the paper's frame (x right, y up, z forward, centimetres, pan to the right)."""

import numpy as np
import pytest

from fieldloc.camera import Camera
from fieldloc.field import load_field
from fieldloc.fixes.vanishing import bearing_of_vanishing_point, vanishing_points, vanishing_ray
from fieldloc.ground import project_points, robot_ground_points
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray, apply, inverse
from fieldloc.view import visible_parts

# f = 0.428 and a half-width of 0.227, a thousand pixels to the paper's unit: the borders are half a pixel beside
# the outer centres. The paper prints no height; every cut end of Table 1 is one at the image's left or right border.
UNIT_PX = 1000.0
CAMERA = Camera("pinhole", 454, 454, 428.0, 428.0, 226.5, 226.5)
MOUNT = CameraMount(0.60, 0.0, 0.0, 0.0, np.zeros((4, 4)))
PAN_RIGHT_RAD = np.deg2rad(30.0)
# x right, z forward is our y left, x forward; at (-200, -200) cm, 30 degrees to the right of z
FIELD_FROM_ROBOT = np.array([-2.0, 2.0, -PAN_RIGHT_RAD])

# Table 1: vanishing point, theta in degrees, the two end points in cm
TABLE = [
    ("-0.247106", -30, ("400", "500"), ("400", "250.528")),  # right touch line
    ("0.741318", 60, ("-500", "400"), ("-500", "17.9819")),  # far goal line
    ("0.741318", 60, ("-200", "319.326"), ("-200", "7.19278")),  # halfway line
    ("-0.247106", -30, ("310", "500"), ("310", "440")),  # right side of the far goal area
    ("0.741318", 60, ("-440", "310"), ("-440", "90")),  # its front
    ("-0.247106", -30, ("90", "440"), ("90", "500")),  # its left side
]


def significant(value: float, digits: int = 6) -> str:
    return f"{value:.{digits}g}"


@pytest.fixture(scope="module")
def seen_ends_px() -> FloatArray:
    """(6, 2, 2): the image of the six lines in the table's order, cut at the image's border."""
    lines = load_field("kidsize-2014").lines
    segments = apply(inverse(FIELD_FROM_ROBOT), lines)
    parts, index = visible_parts(CAMERA, MOUNT, segments)
    in_field = apply(FIELD_FROM_ROBOT, parts)
    assert len(index) == len(TABLE)  # the figure shows these six and nothing else
    ordered = []
    for _, theta, first, second in TABLE:
        expected = 0.01 * np.array([paper_axes(theta, first), paper_axes(theta, second)])
        gaps = np.abs(np.concatenate([in_field, in_field[:, ::-1]]) - expected).max(axis=(1, 2))
        ordered.append(np.concatenate([parts, parts[:, ::-1]])[np.argmin(gaps)])
    pixels, _ = project_points(CAMERA, MOUNT, np.pad(np.array(ordered), ((0, 0), (0, 0), (0, 1))))
    return pixels


def paper_axes(theta_deg: int, printed: tuple[str, str]) -> tuple[float, float]:
    """Table entry -> our field axes (forward, left) relative to the camera's foot, cm, plus where the foot stands."""
    u, v = float(printed[0]), float(printed[1])
    right, ahead = (u, v) if theta_deg == -30 else (v, -u)
    return ahead - 200.0, -right + 200.0


def test_the_lines_of_the_figure_vanish_where_table_1_says(seen_ends_px: FloatArray) -> None:
    rays, _ = CAMERA.ray(seen_ends_px)
    for family in ([0, 3, 5], [1, 2, 4]):
        meeting = vanishing_ray(rays[family])
        assert meeting is not None
        x = 0.428 * meeting[0] / meeting[2]
        pixel, _ = CAMERA.project(meeting)
        bearing = bearing_of_vanishing_point(CAMERA, MOUNT, pixel)
        assert bearing is not None
        printed, theta_deg = TABLE[family[0]][:2]
        assert significant(x) == printed
        np.testing.assert_allclose(-np.rad2deg(bearing[0]), theta_deg, atol=1e-9)  # the paper counts to the right


def test_the_pose_alone_gives_the_same_vanishing_points() -> None:
    along_z, along_x = PAN_RIGHT_RAD, PAN_RIGHT_RAD - np.pi / 2
    pixels, on_image = vanishing_points(CAMERA, MOUNT, np.array([along_z, along_x]))
    x = (pixels[:, 0] - CAMERA.cx_px) / UNIT_PX
    assert [significant(v) for v in x] == ["-0.247106", "0.741318"]
    assert not on_image.any()  # both lie beside the sensor's 0.227
    np.testing.assert_allclose(pixels[:, 1], CAMERA.cy_px, atol=1e-9)  # level camera: the horizon is the middle row


def test_the_end_points_of_table_1_come_out_to_all_printed_digits(seen_ends_px: FloatArray) -> None:
    ground, mask = robot_ground_points(CAMERA, MOUNT, seen_ends_px)
    assert mask.all()
    for ends, (_, theta_deg, *printed) in zip(ground, TABLE, strict=True):
        theta = np.deg2rad(theta_deg)
        # eqs. 14-15: turn by the line's own relative bearing; x to the right of the line's direction, z along it
        turned = apply(np.array([0.0, 0.0, theta]), ends)
        x, z = -100.0 * turned[:, 1], 100.0 * turned[:, 0]
        for i in range(2):
            assert (significant(x[i]), significant(z[i])) == printed[i]
