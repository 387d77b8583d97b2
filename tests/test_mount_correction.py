"""A mount as it is known to be."""

import numpy as np

from fieldloc.camera import Camera
from fieldloc.measurements import CameraMount
from fieldloc.mount_correction import MountCorrection

MOUNT = CameraMount(0.5, 0.1, 0.3, -0.02, 0.01 * np.eye(4) + 0.001, 0.03, 0.01)


def test_what_is_known_is_added() -> None:
    found = MountCorrection(0.01, 0.02, -0.03).applied(MOUNT)
    assert (found.height_m, found.pan_rad, found.tilt_rad, found.roll_rad) == (0.51, 0.1, 0.32, -0.05)
    assert (found.x_m, found.y_m) == (0.03, 0.01)
    np.testing.assert_array_equal(found.covariance, MOUNT.covariance)


def test_what_is_left_takes_the_place_of_what_the_log_claims() -> None:
    found = MountCorrection(tilt_sigma_rad=0.005).applied(MOUNT)
    assert found.covariance[2].tolist() == [0.0, 0.0, 0.005**2, 0.0]
    rest = [0, 1, 3]
    np.testing.assert_array_equal(found.covariance[np.ix_(rest, rest)], MOUNT.covariance[np.ix_(rest, rest)])


def test_where_nothing_is_known_the_log_is_right() -> None:
    assert MountCorrection().applied(MOUNT) is MOUNT


def test_a_longer_focal_length_magnifies_about_the_middle() -> None:
    camera = Camera("pinhole", 640, 480, 500.0, 510.0, 319.5, 239.5, (-0.1, 0.01, 0.0, 0.0))
    longer = MountCorrection(log_focal=0.02).camera(camera)
    middle = np.array([319.5, 239.5])
    ray = np.array([0.2, -0.1, 1.0])
    pixels = [one.project(ray)[0] - middle for one in (camera, longer)]
    np.testing.assert_allclose(pixels[1], np.exp(0.02) * pixels[0])
    assert MountCorrection(tilt_rad=0.1).camera(camera) is camera
