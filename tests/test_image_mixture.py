"""An image as a mixture: the place it was taken from is among its solutions, and the weights mean what they say."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from image_scene import CAMERA, MOUNT, see

from estimators.base import Estimate
from estimators.config import Config
from estimators.ekf import Ekf
from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.covariance import squared_mahalanobis
from fieldloc.detection import Detection
from fieldloc.factors import LandmarkFactor, LineFactor, PoseFactor
from fieldloc.field import FieldMap, Landmark, load_field
from fieldloc.image_mixture import image_mixture
from fieldloc.measurements import ImageFeatures, LineObservation, Odometry, PostObservation
from fieldloc.mixture import MixtureFactor
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.pose import FloatArray
from fieldloc.resolution import Belief, sure
from fieldloc.solution_mixture import SolutionMixture
from fieldloc.stacks import LandmarkStack, LineStack, PoseStack
from fieldloc.tempering import tempered

FIELD = load_field("kidsize")
HALF_TURN = FIELD.symmetries[0]
TOWARDS_GOAL = np.array([0.5, 0.2, 0.05])
TIGHT = np.diag([1e-3, 1e-3, 1e-3])[None]
CHI2_999 = 16.27  # of three degrees
SIGMA_PX = 0.7
NAMES = ("post_opponent_left", "post_opponent_right")


def mixture_of(features: ImageFeatures, field: FieldMap = FIELD, detection: Detection | None = None) -> SolutionMixture:
    found = image_mixture(features, CAMERA, field, detection or Detection())
    assert found is not None
    return found


def exact(pose: FloatArray = TOWARDS_GOAL, field: FieldMap = FIELD) -> ImageFeatures:
    return see(field, pose, 7, np.random.default_rng(1), 0.0)


def only(features: ImageFeatures, posts: int | None = None, lines: int | None = None) -> ImageFeatures:
    return replace(features, posts=features.posts[:posts], lines=features.lines[:lines])


def misfits(mixture: MixtureFactor, pose: FloatArray) -> FloatArray:
    """(k,) squared Mahalanobis distance of the pose from each whole solution, the likeliest first."""
    found = mixture.solutions()
    return squared_mahalanobis(se2.local(found.poses, pose), found.covariances)


def shares(mixture: MixtureFactor) -> FloatArray:
    weights = mixture.solutions().log_weights
    return np.asarray(np.exp(weights - np.logaddexp.reduce(weights)))


def random_pose(random: np.random.Generator) -> FloatArray:
    return np.array([*random.uniform([-4.0, -2.5], [4.0, 2.5]), random.uniform(-np.pi, np.pi)])


@cache
def views(posts: bool, lines: bool, count: int = 250) -> tuple[tuple[FloatArray, SolutionMixture], ...]:
    """Where the robot was and what it made of its image, for images that determine a pose."""
    random = np.random.default_rng(11)
    out = []
    for _ in range(count):
        pose = random_pose(random)
        features = see(FIELD, pose, 0, random, SIGMA_PX)
        features = only(features, posts=None if posts else 0, lines=None if lines else 0)
        found = image_mixture(features, CAMERA, FIELD, Detection())
        if isinstance(found, SolutionMixture) and len(found.solutions().poses):
            out.append((pose, found))
    return tuple(out)


def test_an_exact_image_has_the_pose_that_took_it_as_its_likeliest_solution() -> None:
    features = exact()
    assert len(features.posts) == 2
    assert len(features.lines) >= 3
    found = mixture_of(features)
    assert found.stamp_ns == 7
    best = found.solutions().poses[:2]
    nearest = np.abs(se2.local(best, TOWARDS_GOAL)).max(axis=1).min()
    assert nearest < 5e-3  # ends of lines are sampled to a few millimetres
    share = shares(found)
    assert share[:2].sum() > 0.99


@pytest.mark.parametrize("kept", ["posts", "lines"])
def test_posts_alone_and_lines_alone_find_the_pose(kept: str) -> None:
    alone = only(exact(), lines=0) if kept == "posts" else only(exact(), posts=0)
    found = mixture_of(alone).solutions()
    assert np.abs(se2.local(found.poses, TOWARDS_GOAL)).max(axis=1).min() < 2e-2


def test_solutions_of_unlabelled_images_come_in_twins_of_equal_weight() -> None:
    random = np.random.default_rng(2)
    for _ in range(10):
        found = mixture_of(see(FIELD, TOWARDS_GOAL + random.normal(0, 0.3, 3), 0, random, SIGMA_PX))
        assert found.symmetric
        solutions = found.solutions()
        turned = se2.compose(HALF_TURN, solutions.poses)
        apart = np.abs(se2.local(solutions.poses[:, None], turned)).max(axis=-1)
        unequal = solutions.log_weights[:, None] != solutions.log_weights
        assert np.where(unequal, np.inf, apart).min(axis=1).max() < 1e-12


def test_twins_are_as_likely_anywhere() -> None:
    random = np.random.default_rng(3)
    poses = np.array([random_pose(random) for _ in range(50)])
    for pose in (TOWARDS_GOAL, np.array([0.0, 2.0, 1.5]), np.array([-3.0, 1.0, 2.0])):
        found = mixture_of(see(FIELD, pose, 0, random, SIGMA_PX))
        here, there = found.log_likelihood(poses), found.log_likelihood(se2.compose(HALF_TURN, poses))
        np.testing.assert_allclose(here, there, rtol=1e-9, atol=1e-6)


# lines alone have tests of their own, in test_line_solutions
seen = pytest.mark.parametrize(
    ("posts", "lines"), [(True, True), (True, False), pytest.param(False, True, marks=pytest.mark.slow)]
)


@seen
def test_the_true_pose_is_among_the_solutions(posts: bool, lines: bool) -> None:
    found = [misfits(mixture, pose).min() < CHI2_999 for pose, mixture in views(posts, lines)]
    assert len(found) > 30
    assert np.mean(found) > 0.98  # of 250, one in a thousand by noise, and a few where lines are left out


@seen
def test_the_likeliest_solution_knows_how_right_it_is(posts: bool, lines: bool) -> None:
    """NEES of the top solution or its twin, where the image leaves no doubt."""
    errors = [
        misfits(mixture, pose)[:2].min() for pose, mixture in views(posts, lines) if shares(mixture)[:2].sum() > 0.9
    ]
    assert len(errors) > (80 if lines else 5)
    # mean of n chi-squares over 3, four of its standard deviations; bent likelihoods are given more
    assert np.mean(errors) / 3.0 == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / (3.0 * len(errors))) + 0.1)


@seen
def test_weights_are_as_often_right_as_they_say(posts: bool, lines: bool) -> None:
    """Expected calibration error of the share of the solutions that agree with the likeliest, twins taken together."""
    claimed, right = [], []
    for pose, mixture in views(posts, lines):
        found, share = mixture.solutions(), shares(mixture)
        pair = [se2.local(found.poses, at) for at in (found.poses[0], se2.compose(HALF_TURN, found.poses[0]))]
        near = [squared_mahalanobis(error, found.covariances + found.covariances[0]) for error in pair]
        claimed.append(share[np.minimum(*near) < CHI2_999].sum())
        there = [pose, se2.compose(HALF_TURN, pose)]
        to_truth = [squared_mahalanobis(se2.local(found.poses[0], at), found.covariances[0]) for at in there]
        right.append(min(to_truth) < CHI2_999)
    edges = np.array([0.0, 0.5, 0.8, 0.95, 1.01])
    bins = np.digitize(claimed, edges)
    error = sum(
        abs(np.sum(np.array(claimed)[bins == b]) - np.sum(np.array(right)[bins == b])) for b in range(1, len(edges))
    )
    assert error / len(right) < 0.05


def test_lines_of_two_directions_expand_at_the_true_pose() -> None:
    """How a filter that tracks sees them: more than 97 % of images."""
    near = [len(mixture.expand(pose[None], TIGHT).ids) > 0 for pose, mixture in views(True, True)]
    assert np.mean(near) > 0.97


def test_what_the_image_says_at_the_truth_beats_that_nothing_is_right() -> None:
    better = [mixture.log_likelihood(pose) > mixture.log_outlier + 3.0 for pose, mixture in views(True, True)]
    assert np.mean(better) > 0.97


def test_labelled_posts_tell_the_sides_apart() -> None:
    features = only(exact(), lines=0)
    seen_left = int(np.argmin([post.edges_px[0, 0] for post in features.posts]))
    posts = tuple(replace(post, label=NAMES[int(row != seen_left)]) for row, post in enumerate(features.posts))
    found = mixture_of(replace(features, posts=posts))
    assert not found.symmetric
    solutions = found.solutions()
    assert (solutions.poses[:, 0] > -1.0).all()  # nothing before the other goal
    assert np.abs(se2.local(solutions.poses, TOWARDS_GOAL)).max(axis=1).min() < 2e-2
    mirrored = se2.compose(HALF_TURN, TOWARDS_GOAL)
    assert found.log_likelihood(TOWARDS_GOAL) > found.log_likelihood(mirrored) + 5.0


def test_posts_of_unknown_name_are_left_out() -> None:
    features = exact()
    stranger = tuple(replace(post, label="flag") for post in features.posts)
    with_it, without = mixture_of(replace(features, posts=stranger)), mixture_of(only(features, posts=0))
    np.testing.assert_array_equal(with_it.solutions().log_weights, without.solutions().log_weights)
    assert with_it.symmetric


def test_a_false_post_is_explained_as_none_of_the_maps() -> None:
    features = exact()
    person = features.posts[0]
    shift = np.array([150.0, 0.0])
    assert person.foot_px is not None
    false = replace(person, edges_px=person.edges_px + shift, foot_px=person.foot_px + shift)
    found = mixture_of(replace(features, posts=(*features.posts, false)))
    nearest = np.abs(se2.local(found.solutions().poses[:2], TOWARDS_GOAL)).max(axis=1).min()
    assert nearest < 2e-2
    assert shares(found)[:2].sum() > 0.98


def test_a_false_line_is_explained_as_none_of_the_maps() -> None:
    features = exact()
    false = LineObservation(np.array([[100.0, 400.0], [560.0, 380.0]]), 0.01 * np.eye(4))
    found = mixture_of(replace(features, lines=(*features.lines, false)))
    nearest = np.abs(se2.local(found.solutions().poses[:2], TOWARDS_GOAL)).max(axis=1).min()
    assert nearest < 3e-2


def test_a_post_that_should_be_seen_but_is_not_counts_against_a_pose() -> None:
    """One post before the goal from near: that the other one is missing is rarer the surer posts are seen."""
    features = exact(np.array([1.5, 0.0, 0.0]))
    assert len(features.posts) == 2
    one = replace(features, posts=features.posts[:1])

    def at_truth(chance: float) -> float:
        found = mixture_of(one, detection=Detection(post=chance))
        return float(found.log_likelihood(np.array([1.5, 0.0, 0.0])) - np.log(chance))

    # nothing else changes: one post is seen with the chance, the other missed against it
    assert at_truth(0.5) - at_truth(0.9) == pytest.approx(np.log(0.5 / 0.1), abs=0.02)


def test_posts_beyond_the_range_are_not_missed() -> None:
    features = only(exact(np.array([-3.5, 0.0, 0.0])), posts=0)
    a, b = (
        mixture_of(features, detection=Detection(post=chance)).log_likelihood(np.array([-3.5, 0.0, 0.0]))
        for chance in (0.2, 0.9)
    )
    assert a == pytest.approx(b, abs=1e-9)


def test_one_post_ties_the_robot_to_a_circle_about_each_landmark() -> None:
    found = mixture_of(only(exact(np.array([2.0, 0.2, 0.05])), posts=1, lines=0))
    assert not len(found.solutions().poses)
    ((rings, weights),) = found.stacks
    assert isinstance(rings, LandmarkStack)
    np.testing.assert_allclose(rings.landmarks, FIELD.positions)
    assert np.ptp(weights) == 0.0
    near = found.expand(np.array([[2.0, 0.2, 0.05]]), TIGHT)
    (factor,) = found.chosen(int(near.ids[0]))
    assert isinstance(factor, LandmarkFactor)
    np.testing.assert_allclose(factor.error(np.array([2.0, 0.2, 0.05])), np.zeros(2), atol=5e-3)


def test_one_far_post_alone_says_nothing_of_a_place() -> None:
    """Its distance is no Gaussian, so it gives no circle."""
    features = only(exact(np.array([-3.9, 0.2, 0.05])), posts=1, lines=0)
    unsure = replace(features, mount=replace(MOUNT, covariance=25.0 * MOUNT.covariance))
    (post,) = unsure.posts
    blurred = replace(post, covariance_px2=9.0 * np.eye(4), foot_covariance_px2=100.0 * np.eye(2))
    assert mixture_of(replace(unsure, posts=(blurred,))).stacks == ()


def test_one_line_gives_heading_and_one_coordinate() -> None:
    pose = np.array([0.0, 2.0, np.pi / 2])  # the touch line ahead, nothing of the other family
    features = exact(pose)
    touch_line = max(features.lines, key=lambda line: abs(line.ends_px[1, 0] - line.ends_px[0, 0]))
    found = mixture_of(ImageFeatures(0, MOUNT, (), (touch_line,)))
    ((stack, _),) = found.stacks
    assert isinstance(stack, LineStack)
    near = found.expand(pose[None], TIGHT)
    errors = []
    for solution in near.ids:
        (factor,) = found.chosen(int(solution))
        assert isinstance(factor, LineFactor)
        errors.append(np.abs(factor.error(pose)).max())
    assert min(errors) < 5e-3


def test_one_line_and_one_post_are_a_pose() -> None:
    pose = np.array([2.0, 1.0, -0.1])
    features = exact(pose)
    for line in features.lines:
        found = mixture_of(ImageFeatures(0, MOUNT, features.posts[:1], (line,)))
        assert misfits(found, pose).min() < 1.0
        assert any(isinstance(stack, PoseStack) for stack, _ in found.stacks)


def test_an_image_of_nothing_is_no_mixture() -> None:
    assert image_mixture(ImageFeatures(0, MOUNT), CAMERA, FIELD, Detection()) is None
    in_the_sky = PostObservation(np.array([[300.0, -500.0], [290.0, -500.0]]), np.eye(4))
    assert image_mixture(ImageFeatures(0, MOUNT, (in_the_sky,)), CAMERA, FIELD, Detection()) is None
    bare = FieldMap("bare", np.zeros((0, 2, 2)), np.zeros((0, 3)), ())
    assert image_mixture(only(exact(), lines=0), CAMERA, bare, Detection()) is None


def test_a_foot_without_a_covariance_is_refused() -> None:
    features = only(exact(), lines=0)
    posts = (replace(features.posts[0], foot_covariance_px2=None),)
    with pytest.raises(ValueError, match="foot_px without"):
        image_mixture(replace(features, posts=posts), CAMERA, FIELD, Detection())


@pytest.mark.parametrize("wider", [2.0, 30.0])
def test_a_wider_image_is_the_same_likelihood_to_a_power(wider: float) -> None:
    """Repeated so many times it counts once, at every pose, against the outlier and between solutions."""
    random = np.random.default_rng(4)
    features = see(FIELD, TOWARDS_GOAL, 0, random, SIGMA_PX)
    once = mixture_of(features)
    again = tempered(once, wider)
    assert again.log_outlier == pytest.approx(once.log_outlier / wider)
    (poses, weights), (wide, less) = once.stacks[0], again.stacks[0]
    assert isinstance(poses, PoseStack)
    assert isinstance(wide, PoseStack)
    np.testing.assert_allclose(wide.covariances, wider * poses.covariances)
    for row in range(len(weights)):
        alone = SolutionMixture(0, ((poses.take(np.array([row])), weights[[row]]),), -np.inf, True, 1.0)
        powered = SolutionMixture(0, ((wide.take(np.array([row])), less[[row]]),), -np.inf, True, 1.0)
        at = se2.retract(poses.poses[row], np.array([0.05, -0.03, 0.02]))
        assert powered.log_likelihood(at) == pytest.approx(alone.log_likelihood(at) / wider)


def test_errors_that_lines_and_posts_share_are_not_taken_for_independent() -> None:
    """Against the mount's pan alone, neither posts nor lines help: the heading stays as unsure as the pan."""
    unsure = replace(MOUNT, covariance=np.diag([1e-4, 0.03, 1e-4, 1e-4]) ** 2)
    found = mixture_of(replace(exact(), mount=unsure)).solutions()
    best = np.sqrt(found.covariances[0, 2, 2])
    assert best == pytest.approx(0.03, rel=0.05)


def test_a_map_that_is_not_exact_makes_posts_less_sure() -> None:
    landmarks = tuple(Landmark(m.label, m.position, m.diameter_m, 0.05**2 * np.eye(2)) for m in FIELD.landmarks)
    rough = FieldMap("rough", FIELD.lines, FIELD.circles, landmarks)
    features = only(exact(TOWARDS_GOAL), lines=0)
    sure, unsure = mixture_of(features).solutions(), mixture_of(features, field=rough).solutions()
    assert np.linalg.det(unsure.covariances[0]) > 1.5 * np.linalg.det(sure.covariances[0])
    assert np.abs(se2.local(unsure.poses, TOWARDS_GOAL)).max(axis=1).min() < 2e-2


def test_a_fisheye_and_a_mount_taken_for_exact_work_as_well() -> None:
    features = replace(exact(), mount=replace(MOUNT, covariance=np.zeros((4, 4))))
    found = mixture_of(features)
    assert np.abs(se2.local(found.solutions().poses[:2], TOWARDS_GOAL)).max(axis=1).min() < 5e-3
    fisheye = Camera("fisheye", 640, 480, 500.0, 500.0, 319.5, 239.5, (0.0, 0.0, 0.0, 0.0))
    assert image_mixture(features, fisheye, FIELD, Detection()) is not None


def test_a_solution_is_given_out_as_one_factor() -> None:
    found = mixture_of(exact())
    solutions = found.solutions()
    (factor,) = found.chosen(int(solutions.ids[0]))
    assert isinstance(factor, PoseFactor)
    np.testing.assert_array_equal(factor.pose, solutions.poses[0])


def test_posts_without_a_foot_are_as_far_as_they_are_narrow() -> None:
    features = only(exact(), lines=0)
    posts = tuple(replace(post, foot_px=None, foot_covariance_px2=None) for post in features.posts)
    found = mixture_of(replace(features, posts=posts))
    assert misfits(found, TOWARDS_GOAL).min() < 1.0


def test_a_walk_on_a_soccer_field_is_followed_by_images_alone() -> None:
    """By an estimator that knows one place only, of what is sure."""
    random = np.random.default_rng(3)
    ekf, builder = Ekf(Config()), MixtureBuilder(FIELD, CAMERA)
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
            image = see(FIELD, pose, stamp_ns, random, 0.5)
            found = builder.build(image)
            if found is not None:
                belief = Belief(now.pose, se2.rotate_covariance(now.covariance, -now.pose[2]))
                for factor in sure(found, belief):
                    ekf.update(factor)
                builder.remember(image, found, now.pose)
            now = ekf.estimate()
            assert now is not None
            errors.append(np.linalg.norm(now.pose[:2] - pose[:2]))
    assert np.sqrt(np.mean(np.square(errors))) < 0.12


@pytest.mark.parametrize("name", ["post", "clutter", "nothing_right", "false_post", "false_line"])
@pytest.mark.parametrize("value", [0.0, 1.0, np.nan])
def test_detection_leaves_a_doubt(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Detection(**{name: value})


def test_detection_needs_a_range() -> None:
    with pytest.raises(ValueError, match="post_range_m"):
        Detection(post_range_m=0.0)


def test_a_mount_of_unknown_covariance_is_no_mixture() -> None:
    features = replace(exact(), mount=replace(MOUNT, covariance=np.full((4, 4), np.inf)))
    assert image_mixture(features, CAMERA, FIELD, Detection()) is None
