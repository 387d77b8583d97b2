"""The posts of an image as numbers: their changes with pixels, mount and pose, and what they say together."""

from dataclasses import replace

import numpy as np
import pytest
from image_scene import CAMERA, MOUNT, see
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.covariance import central_difference
from fieldloc.detection import Detection
from fieldloc.field import load_field
from fieldloc.fixes.post_feet import sight_posts
from fieldloc.image_anchors import Anchors, joined, nothing, whole_poses
from fieldloc.image_map import image_map
from fieldloc.image_post_numbers import NUMBERS, post_numbers
from fieldloc.image_posts import PostsSeen, posts_seen, seen_together
from fieldloc.image_states import Readings, solve
from fieldloc.measurements import PostObservation
from fieldloc.pose import FloatArray
from fieldloc.visibility import in_clear_sight

FIELD = load_field("kidsize")
TILTED = replace(MOUNT, pan_rad=0.3, roll_rad=0.05, covariance=np.diag([0.01, 0.02, 0.03, 0.02]) ** 2)
POSE = np.array([0.5, 0.2, -0.25])
RADIUS_M = 0.05
ROOT = np.sqrt(TILTED.covariance)


def two_posts(sigma_px: float = 0.5) -> tuple[PostObservation, ...]:
    posts = see(FIELD, POSE, 0, np.random.default_rng(0), sigma_px, TILTED).posts
    assert len(posts) == 2
    return posts


def seen(posts: tuple[PostObservation, ...]) -> PostsSeen:
    return posts_seen(posts, CAMERA, TILTED, ROOT, FIELD, Detection())


@pytest.mark.parametrize("column", range(4), ids=["height", "pan", "tilt", "roll"])
def test_numbers_change_with_the_mount_as_their_jacobian_says(column: int) -> None:
    posts = list(two_posts())
    name = ("height_m", "pan_rad", "tilt_rad", "roll_rad")[column]

    def at(change: FloatArray) -> FloatArray:
        moved = replace(TILTED, **{name: getattr(TILTED, name) + float(change[0])})
        return post_numbers(posts, CAMERA, moved, RADIUS_M).values.ravel()

    expected = central_difference(at, np.zeros(1)).reshape(2, NUMBERS)
    by_mount = post_numbers(posts, CAMERA, TILTED, RADIUS_M).by_mount
    np.testing.assert_allclose(by_mount[..., column], expected, atol=1e-7)


def test_the_numbers_covariance_is_that_of_the_pixels() -> None:
    (post, _) = two_posts()
    foot = post.foot_px
    assert foot is not None

    def at(change: FloatArray) -> FloatArray:
        moved = replace(post, edges_px=post.edges_px + change[:4].reshape(2, 2), foot_px=foot + change[4:])
        return np.asarray(post_numbers([moved], CAMERA, TILTED, RADIUS_M).values[0])

    jacobian = central_difference(at, np.zeros(6), 1e-3)
    noise = np.zeros((6, 6))
    noise[:4, :4], noise[4:, 4:] = 4.0 * np.eye(4), 9.0 * np.eye(2)
    sized = replace(post, covariance_px2=noise[:4, :4], foot_covariance_px2=noise[4:, 4:])
    found = post_numbers([sized], CAMERA, TILTED, RADIUS_M).covariance[0]
    np.testing.assert_allclose(found, jacobian @ noise @ jacobian.T, rtol=1e-4, atol=1e-12)


def test_what_is_not_seen_has_no_say() -> None:
    whole, _ = two_posts()
    footless = replace(whole, foot_px=None, foot_covariance_px2=None)
    swapped = replace(whole, edges_px=whole.edges_px[::-1])
    numbers = post_numbers([footless, swapped], CAMERA, TILTED, RADIUS_M)
    np.testing.assert_array_equal(numbers.seen, [[False, False, True, True], [True, True, False, False]])
    assert not numbers.values[~numbers.seen].any()
    assert not numbers.covariance[0, :2].any()
    assert not post_numbers([whole], CAMERA, TILTED, 0.0).seen[0, 2:].any()  # edges of a post of unknown width


def test_one_post_is_fused_as_by_the_solver_of_single_sights() -> None:
    for post in two_posts():
        expected = sight_posts(CAMERA, TILTED, (post,), RADIUS_M)
        found = seen((post,))
        # but for the least noise of a pixel
        np.testing.assert_allclose(found.fused, expected.bearing_inverse_range, atol=1e-5)
        np.testing.assert_allclose(found.fused_covariance[0], expected.covariance, rtol=2e-3, atol=1e-8)


def test_two_posts_are_fused_as_by_the_solver_of_joint_sights() -> None:
    posts = two_posts()
    expected = sight_posts(CAMERA, TILTED, posts, RADIUS_M)
    values, covariance = seen_together(seen(posts), np.array([0]), np.array([1]))
    np.testing.assert_allclose(values[0], expected.bearing_inverse_range.ravel(), atol=1e-5)
    np.testing.assert_allclose(covariance[0], expected.covariance, rtol=5e-3, atol=1e-7)


def test_predicted_posts_change_with_the_pose_as_their_jacobian_says() -> None:
    posts = seen(two_posts())
    random = np.random.default_rng(5)
    for _ in range(5):
        pose = np.array([*random.uniform(-2.0, 2.0, 2), random.uniform(-3.0, 3.0)])
        landmark = random.uniform(-4.0, 4.0, 2)

        def at(change: FloatArray, pose: FloatArray = pose, landmark: FloatArray = landmark) -> FloatArray:
            return posts.predicted(se2.retract(pose, change), landmark)[:, 3]

        found = posts.predicted(pose, landmark)
        np.testing.assert_allclose(found[:, :3], central_difference(at, np.zeros(3)), atol=1e-6)


def lines_at(pose: FloatArray) -> Anchors:
    pixel = np.diag([0.03, 0.04, 0.01]) ** 2
    by_mount = np.array([[0.5, 0.0, 1.0, 0.2], [0.1, 0.3, -0.5, 0.9], [0.0, -1.0, 0.1, 0.0]])
    return joined([whole_poses(pose[None], pixel[None], by_mount[None], ROOT, np.zeros(1)), nothing(0.0)])


def test_posts_beside_lines_weigh_as_the_joint_normal_density_says() -> None:
    """The same integral by the textbook: predicted posts under one covariance of pose, mount and pixels."""
    posts_in_image = two_posts()
    posts, lines = seen(posts_in_image), lines_at(se2.retract(POSE, np.array([0.03, -0.02, 0.01])))
    numbers = post_numbers(list(posts_in_image), CAMERA, TILTED, RADIUS_M)
    matched = opponent_posts(posts)
    found = solve(Readings(np.zeros(1, dtype=np.intp), matched, lines.poses[:1]), lines, posts, image_map(FIELD), 1)

    pose = lines.poses[0]
    predicted = np.array([posts.predicted(pose, FIELD.positions[m]) for m in matched[0]])
    doubled = np.concatenate([predicted, predicted], axis=1)
    error = (doubled[..., 3] - numbers.values).ravel()
    slope = doubled[..., :3].reshape(-1, 3)
    by_mount = numbers.by_mount.reshape(-1, 4)
    of_lines = np.array([[0.5, 0.0, 1.0, 0.2], [0.1, 0.3, -0.5, 0.9], [0.0, -1.0, 0.1, 0.0]])
    pixels = np.zeros((8, 8))
    pixels[:4, :4], pixels[4:, 4:] = numbers.covariance
    pose_pixels = np.diag([0.03, 0.04, 0.01]) ** 2
    # error = slope (pose - true pose) + by_mount e + noise, and the lines' pose is off by -(of_lines e + noise)
    shared = by_mount - slope @ of_lines
    expected = slope @ pose_pixels @ slope.T + shared @ TILTED.covariance @ shared.T + pixels
    log_density = -0.5 * (error @ np.linalg.solve(expected, error) + np.linalg.slogdet(2 * np.pi * expected)[1])
    odds = float(np.sum(posts.log_norm - odds_free_norm(numbers.covariance)))
    assert found.log_integrals[0] == pytest.approx(log_density + odds, abs=1e-6)

    cross = -(pose_pixels @ slope.T - of_lines @ TILTED.covariance @ shared.T)
    full = pose_pixels + of_lines @ TILTED.covariance @ of_lines.T
    posterior = full - cross @ np.linalg.solve(expected, cross.T)
    np.testing.assert_allclose(found.covariances[0], posterior, rtol=1e-6, atol=1e-12)


def opponent_posts(posts: PostsSeen) -> NDArray[np.intp]:
    """(1, 2) which landmark each of the two is."""
    bearings = posts.predicted(POSE, FIELD.positions[:2])[:, 0, 3]
    return np.asarray(np.argmin(np.abs(bearings - posts.fused[:, :1]), axis=1)[None])


def odds_free_norm(covariances: FloatArray) -> FloatArray:
    """Log densities at zero of the pixels' noise alone."""
    return np.asarray(-0.5 * np.linalg.slogdet(2 * np.pi * covariances)[1])


def test_a_solved_reading_stays_where_it_is() -> None:
    posts, lines = seen(two_posts()), lines_at(POSE)
    start = Readings(np.zeros(1, dtype=np.intp), opponent_posts(posts), lines.poses[:1])
    once = solve(start, lines, posts, image_map(FIELD), 6)
    again = solve(once.readings, lines, posts, image_map(FIELD), 1)
    np.testing.assert_allclose(again.readings.poses, once.readings.poses, atol=1e-6)


def test_a_reading_that_fits_nowhere_is_ruled_out() -> None:
    posts, lines = seen(two_posts()), lines_at(POSE)
    for matched in ([[2, 3]], [[3, 2]]):
        start = Readings(np.zeros(1, dtype=np.intp), np.array(matched), lines.poses[:1])
        assert solve(start, lines, posts, image_map(FIELD), 2).log_integrals[0] == -np.inf


def sight(x: float, heading: float = 0.0, tilt_rad: float = MOUNT.tilt_rad) -> FloatArray:
    pose, mount = np.array([[x, 0.0, heading]]), replace(MOUNT, tilt_rad=tilt_rad)
    return np.asarray(in_clear_sight(pose, CAMERA, mount, FIELD.positions, Detection())[0])


def test_posts_ahead_and_near_are_in_clear_sight_and_others_are_not() -> None:
    opponent = np.array([mark.label.startswith("post_opponent") for mark in FIELD.landmarks])
    np.testing.assert_array_equal(sight(1.0), opponent.astype(float))
    assert not sight(1.0, 0.5 * np.pi).any()
    assert not sight(4.4).any()  # to either side
    assert not sight(-4.0, tilt_rad=0.8).any()  # the feet are above the image
    assert not sight(-4.0)[opponent].any()  # too far to be sure of
    faint = sight(-1.0)[opponent]
    assert ((faint > 0.0) & (faint < 1.0)).all()
