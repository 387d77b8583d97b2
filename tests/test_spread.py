"""How honest the covariance of a two-post fix is: against sampling, near, far, and where geometry is special."""

import numpy as np
import pytest
from goal_views import GOAL, edge_noise, pose_error, poses_in_front_of_the_goal, view

from fieldloc.covariance import squared_mahalanobis
from fieldloc.fixes.spread import is_first_order_honest
from fieldloc.fixes.two_posts import covariance_of_two_posts, fix_two_posts, poses_from_two_posts
from fieldloc.pose import FloatArray


def pose_of(inputs: FloatArray) -> FloatArray:
    return poses_from_two_posts(inputs[..., :2], inputs[..., 2:], GOAL).pose


def whitened(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    roots = np.linalg.cholesky(covariances)
    return np.asarray(np.linalg.solve(roots, errors[..., None])[..., 0])


def test_the_covariance_of_ten_thousand_random_fixes_is_their_sampled_spread() -> None:
    """Focal length 600 px, 0.2 px noise per edge, robots within 4.5 m; each error whitened by its own fix."""
    rng = np.random.default_rng(11)
    truth = poses_in_front_of_the_goal(rng, 10_000, 1.0, 4.5)
    noise = edge_noise(600.0, 0.2)
    seen = view(truth) + rng.normal(size=(10_000, 4)) * np.sqrt(np.diag(noise))
    covariances = covariance_of_two_posts(seen[:, :2], seen[:, 2:], noise, GOAL)
    assert np.all(np.isfinite(covariances))
    white = whitened(pose_error(pose_of(seen), truth), covariances)
    second_moment = white.T @ white / len(white)
    # 10,000 samples leave 2 % of their own
    assert np.linalg.norm(second_moment - np.eye(3)) / np.sqrt(3) < 0.04
    assert np.trace(second_moment) / 3 == pytest.approx(1.0, abs=0.03)


def test_first_order_alone_misses_that_spread_by_an_order_of_magnitude() -> None:
    """The reason for the second moment: a tenth of a milliradian across the circle, centimetres along its bend."""
    rng = np.random.default_rng(12)
    truth = poses_in_front_of_the_goal(rng, 2_000, 1.0, 4.5)
    noise = edge_noise(600.0, 0.2)
    seen = view(truth) + rng.normal(size=(2_000, 4)) * np.sqrt(np.diag(noise))
    found = poses_from_two_posts(seen[:, :2], seen[:, 2:], GOAL)
    first_order = found.first_order_covariance(noise)
    nees = squared_mahalanobis(pose_error(found.pose, truth), first_order)
    assert nees.mean() / 3 > 5
    spread = covariance_of_two_posts(seen[:, :2], seen[:, 2:], noise, GOAL)
    assert is_first_order_honest(first_order, spread).mean() < 0.2


@pytest.mark.parametrize("sigma_px", [0.001, 0.01])
def test_with_little_noise_the_fix_carries_the_first_order_covariance_itself(sigma_px: float) -> None:
    noise = edge_noise(600.0, sigma_px)
    inputs = view(np.array([2.5, 0.4, 0.1]))
    (fix,) = fix_two_posts(inputs[:2], inputs[2:], noise, GOAL)
    first_order = poses_from_two_posts(inputs[:2], inputs[2:], GOAL).first_order_covariance(noise)
    np.testing.assert_array_equal(fix.covariance, first_order)


@pytest.mark.parametrize(
    ("pose", "sigma_px"),
    [
        ([1.0, 1.0, -0.3], 0.3),  # posts of 13 px
        ([0.0, 0.0, 0.1], 0.3),
        ([-1.5, 2.0, -0.4], 0.3),  # 9 px
        ([1.5, 4.0, -0.8], 0.5),
        ([1.0, 1.0, -0.3], 1.0),
        ([0.0, 1.0, -0.3], 0.5),
    ],
)
def test_a_far_fix_is_not_overconfident(pose: list[float], sigma_px: float) -> None:
    rng = np.random.default_rng(13)
    truth, noise = np.array(pose), edge_noise(600.0, sigma_px)
    seen = view(truth) + rng.normal(size=(4_000, 4)) * np.sqrt(np.diag(noise))
    covariances = covariance_of_two_posts(seen[:, :2], seen[:, 2:], noise, GOAL)
    usable = np.isfinite(covariances).all((-1, -2))
    assert usable.mean() > 0.99
    nees = squared_mahalanobis(pose_error(pose_of(seen), truth)[usable], covariances[usable])
    assert nees.mean() / 3 < 1.3


def test_the_covariance_does_not_depend_on_where_the_robot_looks() -> None:
    """Not even where its heading is about to jump from pi to -pi."""
    noise = edge_noise(600.0, 0.5)
    ahead, astern = (view(np.array([0.0, 1.0, heading])) for heading in (0.0, np.pi))
    expected = covariance_of_two_posts(ahead[:2], ahead[2:], noise, GOAL)
    np.testing.assert_allclose(covariance_of_two_posts(astern[:2], astern[2:], noise, GOAL), expected, rtol=1e-9)


def test_a_picture_that_could_be_of_a_robot_infinitely_far_away_gives_no_fix() -> None:
    inputs = view(np.array([-40.0, 1.0, 0.0]))  # posts of a pixel and a half, 58 mrad apart
    assert fix_two_posts(inputs[:2], inputs[2:], edge_noise(600.0, 0.01), GOAL) != ()
    loose = np.diag([0.02, 0.02, 1e-4, 1e-4]) ** 2
    assert fix_two_posts(inputs[:2], inputs[2:], loose, GOAL) == ()
    assert fix_two_posts(inputs[:2], inputs[2:], edge_noise(600.0, 1.0), GOAL) == ()  # sizes that could be zero


def test_a_robot_in_line_with_the_posts_gets_an_honest_covariance() -> None:
    """Nothing is singular there, alpha = 0 outside and alpha = 180 degrees between: the sizes tell where."""
    rng = np.random.default_rng(14)
    for place in ([4.5, 2.4, 1.0], [4.5, 0.4, 1.0]):
        truth, noise = np.array(place), np.diag([1e-3, 1e-3, 2e-4, 2e-4]) ** 2
        seen = view(truth) + rng.normal(size=(4_000, 4)) * np.sqrt(np.diag(noise))
        covariances = covariance_of_two_posts(seen[:, :2], seen[:, 2:], noise, GOAL)
        white = whitened(pose_error(pose_of(seen), truth), covariances)
        assert np.linalg.norm(white.T @ white / len(white) - np.eye(3)) / np.sqrt(3) < 0.06
