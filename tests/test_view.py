import numpy as np
import pytest

from fieldloc.camera import Camera
from fieldloc.ground import project_points
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray
from fieldloc.view import visible_parts

PINHOLE = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)
BARREL = Camera("pinhole", 640, 480, 500.0, 505.0, 319.5, 239.5, (-0.3, 0.1, 0.001, -0.002))
FISHEYE = Camera("fisheye", 640, 480, 400.0, 400.0, 319.5, 239.5)
MOUNT = CameraMount(0.5, 0.1, 0.3, 0.05, np.zeros((4, 4)))


def project(camera: Camera, points: FloatArray) -> FloatArray:
    return project_points(camera, MOUNT, np.pad(points, ((0, 0),) * (points.ndim - 1) + ((0, 1),)))[0]


@pytest.mark.parametrize("camera", [PINHOLE, BARREL, FISHEYE])
def test_cut_ends_lie_on_the_border_and_the_others_are_kept(camera: Camera) -> None:
    segments = np.array([[[3.0, -9.0], [3.0, 9.0]], [[1.5, 0.1], [1.5, -0.1]], [[-4.0, 0.3], [-1.0, 0.3]]])
    parts, index = visible_parts(camera, MOUNT, segments)
    assert index.tolist() == [0, 1]  # the third is behind
    u = project(camera, parts[0])[:, 0]
    np.testing.assert_allclose(u, [639.5, -0.5], atol=1e-9)  # from the robot's right to its left
    np.testing.assert_array_equal(parts[1], segments[1])


def test_a_line_that_leaves_through_the_lens_keeps_to_the_ground_it_is_on() -> None:
    parts, _ = visible_parts(FISHEYE, MOUNT, np.array([[[-1.0, -1.0], [5.0, 2.0]]]))
    start, along = np.array([-1.0, -1.0]), np.array([6.0, 3.0])
    across = (parts[0] - start) @ np.array([-along[1], along[0]])
    np.testing.assert_allclose(across, 0.0, atol=1e-12)


def test_nothing_to_see_is_empty() -> None:
    parts, index = visible_parts(PINHOLE, MOUNT, np.zeros((0, 2, 2)))
    assert parts.shape == (0, 2, 2)
    assert index.shape == (0,)
