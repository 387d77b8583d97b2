"""Mixtures of solutions that have been found: densities, quadratics, evidence, against sums over plain factors."""

import numpy as np
import pytest

from fieldloc import pose as se2
from fieldloc.covariance import central_difference
from fieldloc.pose import FloatArray
from fieldloc.resolution import Belief, sure
from fieldloc.solution_mixture import SolutionMixture
from fieldloc.stacks import FactorStack, HeadingStack, LandmarkStack, LineStack, PoseStack

RANDOM = np.random.default_rng(3)
POSE = np.array([1.0, -0.5, 0.7])
P3 = np.array([[0.04, 0.01, 0.002], [0.01, 0.02, -0.003], [0.002, -0.003, 0.01]])
P2 = np.array([[0.02, 0.005], [0.005, 0.03]])
TWO_PI = 2 * np.pi

STACKS: dict[str, FactorStack] = {
    "poses": PoseStack(np.array([POSE, [1.1, -0.4, 0.75], [-2.0, 1.0, 3.0]]), np.array([P3, 2 * P3, P3])),
    "landmarks": LandmarkStack(
        np.array([[3.0, 1.0], [2.0, -3.0]]), np.array([[2.5, -0.2], [-0.9, -2.6]]), np.array([P2, P2])
    ),
    "lines": LineStack(
        np.array([0.7, 0.72]),
        np.array([0.0, np.pi / 2]),
        np.array([1.05, -0.45]),
        np.array([[-3.0, 3.0], [-4.0, 4.0]]),
        np.array([P2, P2]),
    ),
    "headings": HeadingStack(np.array([0.72, -2.4]), np.array([[[0.01]], [[0.01]]])),
}
each = pytest.mark.parametrize("stack", STACKS.values(), ids=STACKS.keys())


def mixture(stack: FactorStack, log_outlier: float = -50.0, symmetric: bool = False) -> SolutionMixture:
    weights = np.log(np.array([0.5, 0.3, 0.2])[: len(stack.covariances)])
    return SolutionMixture(7, ((stack, weights),), log_outlier, symmetric, 54.0)


def log_normal(error: FloatArray, covariance: FloatArray) -> float:
    return float(-0.5 * (error @ np.linalg.solve(covariance, error) + np.linalg.slogdet(TWO_PI * covariance)[1]))


@each
def test_a_stack_has_the_errors_and_jacobians_of_its_factors(stack: FactorStack) -> None:
    poses = np.stack([POSE, se2.retract(POSE, np.array([0.3, -0.2, 0.4])), np.array([-3.0, 2.0, 3.1])])
    errors, jacobians = stack.errors(poses), stack.jacobians(poses)
    for k in range(len(stack.covariances)):
        factor = stack.factor(7, k)
        np.testing.assert_allclose(errors[:, k], factor.error(poses), atol=1e-12)
        np.testing.assert_allclose(factor.covariance, stack.covariances[k])
        for pose, jacobian in zip(poses, jacobians[:, k], strict=True):
            np.testing.assert_allclose(jacobian, factor.jacobian(pose), atol=1e-9)
            numerical = central_difference(lambda d, p=pose, f=factor: f.error(se2.retract(p, d)), np.zeros(3))
            np.testing.assert_allclose(jacobian, numerical, atol=1e-6)


@each
def test_the_likelihood_is_the_sum_over_solutions_and_the_outlier(stack: FactorStack) -> None:
    one = mixture(stack, log_outlier=-5.0)
    weights = one.stacks[0][1]
    terms = [
        w + log_normal(f.error(POSE), f.covariance) for w, f in ((w, one.chosen(k)[0]) for k, w in enumerate(weights))
    ]
    np.testing.assert_allclose(one.log_likelihood(POSE[None])[0], np.logaddexp.reduce([*terms, -5.0]), atol=1e-9)


@each
def test_an_expansion_is_the_logarithm_of_a_solution_s_density(stack: FactorStack) -> None:
    # where the step is small, so that it is linearised at the pose itself: value and slope are exact there
    one = mixture(stack)
    near = one.expand(POSE[None], 1e-6 * P3[None])
    assert len(near.ids)
    for row, solution in enumerate(near.ids):
        (factor,), weight = one.chosen(int(solution)), one.stacks[0][1][solution]

        def density(d: FloatArray) -> FloatArray:
            return np.array([weight + log_normal(factor.error(se2.retract(POSE, d)), factor.covariance)])  # noqa: B023

        np.testing.assert_allclose(near.constant[row], density(np.zeros(3))[0], atol=1e-9)
        np.testing.assert_allclose(near.gradient[row], central_difference(density, np.zeros(3))[0], atol=1e-5)


@each
def test_an_expansion_at_many_places_is_that_at_each_of_them(stack: FactorStack) -> None:
    one = mixture(stack)
    away = [np.zeros(3), np.array([0.2, -0.1, 0.15]), np.array([9.0, 9.0, 3.0]), np.array([-0.15, 0.2, -0.1])]
    poses, covariances = se2.retract(POSE, np.stack(away)), np.stack([P3, 0.5 * P3, P3, 2.0 * P3])
    together = one.expand(poses, covariances)
    assert set(together.parent.tolist()) >= {0, 1, 3}
    for k in range(len(poses)):
        alone, rows = one.expand(poses[k : k + 1], covariances[k : k + 1]), together.parent == k
        np.testing.assert_array_equal(together.ids[rows], alone.ids)
        for name in ("constant", "gradient", "information"):
            np.testing.assert_allclose(getattr(together, name)[rows], getattr(alone, name), rtol=1e-9, atol=1e-9)


@each
def test_the_evidence_is_the_integral_of_likelihood_times_belief(stack: FactorStack) -> None:
    # a narrow belief, over which the model is straight; by sampling, 2 % of standard error
    narrow = 0.02 * P3
    one = mixture(stack)
    near = one.expand(POSE[None], narrow[None])
    draws = RANDOM.multivariate_normal(np.zeros(3), narrow, size=40_000)
    sampled = np.mean(np.exp(one.log_likelihood(se2.retract(POSE, draws))))
    np.testing.assert_allclose(np.exp(np.logaddexp.reduce(near.evidence)), sampled, rtol=0.05)


def test_an_updated_pose_is_that_of_the_kalman_filter() -> None:
    stack = PoseStack(se2.retract(POSE, np.array([[0.01, -0.02, 0.01]])), P3[None])
    near = mixture(stack).expand(POSE[None], P3[None])
    gain = P3 @ np.linalg.inv(2 * P3)
    np.testing.assert_allclose(near.step[0], gain @ np.array([0.01, -0.02, 0.01]), atol=1e-3)
    np.testing.assert_allclose(near.updated[0], (np.eye(3) - gain) @ P3, rtol=0.02, atol=1e-5)


def test_the_integral_over_all_poses_is_the_sum_of_weights_of_whole_poses() -> None:
    one = mixture(STACKS["poses"])
    np.testing.assert_allclose(one.log_integral, 0.0, atol=1e-12)
    found = one.solutions()
    assert found.log_weights.tolist() == sorted(found.log_weights, reverse=True)
    np.testing.assert_allclose(found.poses[0], one.chosen(int(found.ids[0]))[0].pose)  # type: ignore[attr-defined]


def test_what_is_far_from_every_solution_has_no_expansion() -> None:
    for stack in STACKS.values():
        assert not len(mixture(stack).expand(np.array([[40.0, 40.0, -1.0]]), 1e-4 * P3[None]).ids)


def test_a_line_is_not_seen_beyond_its_end() -> None:
    one = mixture(STACKS["lines"])
    beyond = np.array([1.05, 9.0, 0.7])
    assert not len(one.expand(beyond[None], 1e-4 * P3[None]).ids)
    np.testing.assert_allclose(one.log_likelihood(beyond[None])[0], one.log_outlier)


def test_a_solution_is_sure_only_where_belief_tells_it_from_the_others_and_from_nothing() -> None:
    one = mixture(STACKS["poses"])
    far = SolutionMixture(7, ((STACKS["poses"].take(np.array([0, 2])), np.log([0.5, 0.5])),), -50.0, False, 54.0)
    assert sure(far, None) == ()
    (factor,) = sure(far, Belief(POSE, P3))
    np.testing.assert_allclose(factor.error(POSE), 0.0, atol=1e-12)
    assert sure(one, Belief(POSE, P3)) == ()  # two of the three are near
    assert (
        sure(SolutionMixture(7, far.stacks, 5.0, False, 54.0), Belief(POSE, P3)) == ()
    )  # more likely nothing is right
    np.testing.assert_allclose(
        sure(far, None, lambda p: np.where(p[:, 0] < 0, -99.0, 0.0))[0].error(POSE), 0.0, atol=1e-12
    )


def test_a_wrong_belief_hears_of_the_only_whole_pose_there_is() -> None:
    only = SolutionMixture(7, ((STACKS["poses"].take(np.array([2])), np.zeros(1)),), -50.0, False, 54.0)
    (factor,) = sure(only, Belief(POSE, P3))
    np.testing.assert_allclose(factor.error(np.array([-2.0, 1.0, 3.0])), 0.0, atol=1e-12)
