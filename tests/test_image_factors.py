"""Posts and lines of an image become one factor that is right and knows how right."""

import numpy as np
import pytest
from image_scene import CAMERA, MOUNT, see

from estimators.base import Estimate
from estimators.config import Config
from estimators.ekf import Ekf
from fieldloc import pose as se2
from fieldloc.association import Belief
from fieldloc.covariance import squared_mahalanobis
from fieldloc.factor_builder import FactorBuilder
from fieldloc.factors import LandmarkFactor, LineFactor, PoseFactor
from fieldloc.field import load_field
from fieldloc.image_factors import image_factors
from fieldloc.measurements import ImageFeatures, Odometry
from fieldloc.pose import FloatArray

FIELD = load_field("kidsize")
TOWARDS_GOAL = np.array([0.5, 0.2, 0.05])
VAGUE = np.diag([0.3, 0.3, 0.15]) ** 2


def _parts(features: ImageFeatures, *, posts: int | None = None, lines: int | None = None) -> ImageFeatures:
    return ImageFeatures(features.stamp_ns, features.mount, features.posts[:posts], features.lines[:lines])


def _belief(truth: FloatArray, offset: tuple[float, float, float] = (0.2, -0.15, 0.08)) -> Belief:
    return Belief(se2.retract(truth, np.array(offset)), VAGUE)


def test_an_exact_image_gives_back_the_pose() -> None:
    features = see(FIELD, TOWARDS_GOAL, 7, np.random.default_rng(1), 0.0)
    assert len(features.posts) == 2
    assert len(features.lines) >= 3
    (factor,) = image_factors(features, CAMERA, FIELD, _belief(TOWARDS_GOAL))
    assert isinstance(factor, PoseFactor)
    assert factor.stamp_ns == 7
    np.testing.assert_allclose(factor.pose, TOWARDS_GOAL, atol=2e-3)  # ends of lines are sampled to a few millimetres


@pytest.mark.parametrize("kept", ["posts", "lines"])
def test_posts_alone_and_lines_alone_give_back_the_pose(kept: str) -> None:
    features = see(FIELD, TOWARDS_GOAL, 0, np.random.default_rng(1), 0.0)
    alone = _parts(features, lines=0) if kept == "posts" else _parts(features, posts=0)
    (factor,) = image_factors(alone, CAMERA, FIELD, _belief(TOWARDS_GOAL))
    assert isinstance(factor, PoseFactor)
    np.testing.assert_allclose(factor.pose, TOWARDS_GOAL, atol=5e-3)


def test_without_a_belief_a_symmetric_field_gives_no_factor() -> None:
    features = see(FIELD, TOWARDS_GOAL, 0, np.random.default_rng(1), 0.0)
    assert image_factors(features, CAMERA, FIELD, None) == ()


def test_a_belief_on_the_other_side_gives_the_mirror_image() -> None:
    features = see(FIELD, TOWARDS_GOAL, 0, np.random.default_rng(1), 0.0)
    mirrored = se2.compose(np.array([0.0, 0.0, np.pi]), TOWARDS_GOAL)
    (factor,) = image_factors(features, CAMERA, FIELD, _belief(mirrored))
    assert isinstance(factor, PoseFactor)
    np.testing.assert_allclose(factor.error(mirrored), np.zeros(3), atol=5e-3)


def test_one_post_ties_the_robot_to_a_circle() -> None:
    features = see(FIELD, TOWARDS_GOAL, 0, np.random.default_rng(1), 0.0)
    (factor,) = image_factors(_parts(features, posts=1, lines=0), CAMERA, FIELD, _belief(TOWARDS_GOAL))
    assert isinstance(factor, LandmarkFactor)
    np.testing.assert_allclose(factor.error(TOWARDS_GOAL), np.zeros(2), atol=5e-3)


def test_one_line_gives_heading_and_one_coordinate() -> None:
    pose = np.array([0.0, 2.0, np.pi / 2])  # the touch line ahead, nothing of the other family
    features = see(FIELD, pose, 0, np.random.default_rng(1), 0.0)
    touch_line = max(features.lines, key=lambda line: abs(line.ends_px[1, 0] - line.ends_px[0, 0]))
    only = ImageFeatures(0, MOUNT, (), (touch_line,))
    (factor,) = image_factors(only, CAMERA, FIELD, _belief(pose, (0.05, 0.05, 0.03)))
    assert isinstance(factor, LineFactor)
    np.testing.assert_allclose(factor.error(pose), np.zeros(2), atol=2e-3)


def test_an_empty_image_gives_no_factor() -> None:
    assert image_factors(ImageFeatures(0, MOUNT), CAMERA, FIELD, _belief(TOWARDS_GOAL)) == ()


def test_images_without_a_camera_are_counted() -> None:
    builder = FactorBuilder(FIELD)
    assert builder.build(ImageFeatures(0, MOUNT), None) == ()
    assert builder.warnings() == ("1 images left out: the log says nothing about the camera",)


def test_errors_match_the_covariance_over_many_noisy_images() -> None:
    random = np.random.default_rng(5)
    distances = []
    for _ in range(150):
        pose = np.array([*random.uniform([-1.0, -1.5], [2.5, 1.5]), random.uniform(-0.5, 0.5)])
        belief = Belief(se2.retract(pose, random.multivariate_normal(np.zeros(3), VAGUE / 9)), VAGUE / 9)
        for factor in image_factors(see(FIELD, pose, 0, random, 0.5), CAMERA, FIELD, belief):
            distances.append(float(squared_mahalanobis(factor.error(pose), factor.covariance)) / len(factor.covariance))
    assert len(distances) > 120  # few images leave a doubt
    # the belief's gate cuts a little; twice the mean's spread of sqrt(2 / (3 n)) around one
    assert np.mean(distances) == pytest.approx(1.0, abs=0.25)


def test_a_walk_on_a_soccer_field_is_followed_by_images_alone() -> None:
    random = np.random.default_rng(3)
    ekf = Ekf(Config())
    builder = FactorBuilder(FIELD, CAMERA)
    pose = np.array([-1.0, -0.5, 0.0])
    ekf.start(Estimate(0, pose + [0.05, -0.05, 0.03], np.diag([0.1, 0.1, 0.08]) ** 2))
    velocity = np.array([0.15, 0.0, 0.1])
    errors = []
    for step in range(1, 200):
        stamp_ns = step * 100_000_000
        ekf.predict(Odometry(stamp_ns - 100_000_000, velocity * [1.05, 1.0, 0.95]))
        pose = se2.retract(pose, velocity * 0.1)
        if step % 10 == 0:
            velocity = np.array([0.15, 0.0, random.uniform(-0.4, 0.4) - 0.3 * pose[2]])
        if step % 5 == 0:
            ekf.advance(stamp_ns)
            now = ekf.estimate()
            assert now is not None
            belief = Belief(now.pose, se2.rotate_covariance(now.covariance, -now.pose[2]))
            for factor in builder.build(see(FIELD, pose, stamp_ns, random, 0.5), belief):
                ekf.update(factor)
            now = ekf.estimate()
            assert now is not None
            errors.append(np.linalg.norm(now.pose[:2] - pose[:2]))
    assert np.sqrt(np.mean(np.square(errors))) < 0.08
