"""A camera that sits askew, told image by image while the robot goes about."""

from dataclasses import replace

import askew_camera
import numpy as np
import pytest
from askew_camera import FIELD, KNOWN
from image_scene import CAMERA, MOUNT

from fieldloc.measurements import CameraMount, ImageFeatures
from fieldloc.mount_learning import LearnedMount
from fieldloc.pose import FloatArray

SIGMAS, WOBBLE = askew_camera.SIGMAS[:3], askew_camera.WOBBLE[:3]
CLAIMED = replace(MOUNT, covariance=np.diag([SIGMAS[0], 0.02, *SIGMAS[1:]]) ** 2)
ROWS = [0, 2, 3]


def walk(rng: np.random.Generator, error: FloatArray, count: int) -> tuple[list[ImageFeatures], FloatArray]:
    """Of a camera whose focal length is known."""
    return askew_camera.walk(rng, np.append(error, 0.0), count)


def learned(images: list[ImageFeatures], poses: FloatArray, mount: CameraMount = CLAIMED) -> LearnedMount:
    out = LearnedMount(CAMERA, FIELD, 0.2)
    for image, pose in zip(images, poses, strict=True):
        out.learn(replace(image, mount=mount), pose, KNOWN)
    return out


def error_and_sigmas(out: LearnedMount) -> tuple[FloatArray, FloatArray]:
    mount = out.applied(CLAIMED)
    error = [mount.height_m - MOUNT.height_m, mount.tilt_rad - MOUNT.tilt_rad, mount.roll_rad - MOUNT.roll_rad]
    return np.array(error), np.sqrt(np.diagonal(mount.covariance)[ROWS])


def test_the_constant_error_is_found_and_what_is_left_is_little_more_than_the_wobble() -> None:
    rng = np.random.default_rng(5)
    for _ in range(6):
        error = SIGMAS * rng.uniform(-1.0, 1.0, 3)
        found, left = error_and_sigmas(learned(*walk(rng, error, 40)))
        # of 18 numbers none is off by three sigmas of what is left, which the wobble is the larger part of
        assert (np.abs(found - error) < 3.0 * left).all()
        assert (np.abs(found - error)[1:] < 0.4 * SIGMAS[1:]).all()
        assert (left[1:] > 0.7 * WOBBLE[1:]).all()
        assert (left[1:] < 0.6 * SIGMAS[1:]).all()


def test_what_is_left_is_never_more_than_is_claimed() -> None:
    rng = np.random.default_rng(6)
    images, poses = walk(rng, 3.0 * SIGMAS, 15)
    found, left = error_and_sigmas(learned(images, poses))
    assert (left <= SIGMAS * (1.0 + 1e-9)).all()
    assert (found[1:] > SIGMAS[1:]).all()


def test_a_mount_that_is_claimed_to_be_exact_stays_as_it_is() -> None:
    images, poses = walk(np.random.default_rng(7), SIGMAS, 10)
    exact = replace(MOUNT, covariance=np.zeros((4, 4)))
    out = learned(images, poses, exact)
    assert out.applied(exact).tilt_rad == exact.tilt_rad
    np.testing.assert_array_equal(out.applied(exact).covariance, exact.covariance)


@pytest.mark.parametrize("covariance", [0.0, np.nan, np.inf])
def test_an_image_that_no_arithmetic_can_use_is_left_out(covariance: float) -> None:
    images, poses = walk(np.random.default_rng(7), SIGMAS, 4)
    odd = [
        replace(
            image, lines=tuple(replace(line, covariance_px2=np.diag(np.full(4, covariance))) for line in image.lines)
        )
        for image in images
    ]
    with np.errstate(all="ignore"):
        found, left = error_and_sigmas(learned(odd, poses))
    assert np.isfinite(found).all()
    assert (left > 0.0).all()


def test_before_the_first_image_nothing_is_learned() -> None:
    assert LearnedMount(CAMERA, FIELD, 0.2).applied(CLAIMED) is CLAIMED


@pytest.mark.parametrize("every_ns", [10_000_000, 0])
def test_a_robot_that_stands_has_not_seen_a_hundred_images(every_ns: int) -> None:
    images, poses = walk(np.random.default_rng(8), np.array([0.0, 0.02, 0.0]), 1)
    still = [replace(images[0], stamp_ns=k * every_ns) for k in range(100)]
    _, many = error_and_sigmas(learned(still, np.repeat(poses, 100, axis=0)))
    _, few = error_and_sigmas(
        learned([replace(images[0], stamp_ns=k * 10**10) for k in range(5)], np.repeat(poses, 5, axis=0))
    )
    assert (many > 0.98 * few).all()


def test_a_neck_that_is_bent_by_a_fall_is_in_doubt_first_and_then_found_again() -> None:
    rng = np.random.default_rng(9)
    images, poses = walk(rng, np.array([0.0, 0.02, 0.0]), 30)
    bent, poses_bent = walk(rng, np.array([0.0, -0.02, 0.0]), 120)
    later = [replace(image, stamp_ns=image.stamp_ns + 60 * 10**9) for image in bent]
    for count, within in ((40, 0.04), (120, 0.015)):
        every = np.concatenate([poses, poses_bent[:count]])
        found, left = error_and_sigmas(learned([*images, *later[:count]], every))
        assert abs(found[1] + 0.02) < min(3.0 * left[1], within)
