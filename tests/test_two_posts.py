import numpy as np
import pytest
from goal_views import GOAL, OWN_GOAL, edge_noise, pose_error, poses_in_front_of_the_goal, view
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fieldloc.covariance import central_difference
from fieldloc.fixes.central_angle import positions_from_angle
from fieldloc.fixes.two_posts import (
    covariance_of_two_posts,
    fix_two_alike_posts,
    fix_two_posts,
    poses_from_two_posts,
)
from fieldloc.pose import FloatArray, wrap

GOOD_NOISE = np.diag([1e-4, 1e-4, 1e-6, 1e-6]) ** 2

coordinates = st.floats(-6.0, 6.0)
headings = st.floats(-np.pi, np.pi)
moderate = settings(deadline=None, max_examples=80)


def pose_of(inputs: FloatArray, posts: FloatArray = GOAL) -> FloatArray:
    return poses_from_two_posts(inputs[..., :2], inputs[..., 2:], posts).pose


@moderate
@given(x=coordinates, y=coordinates, heading=headings)
def test_the_fix_is_the_pose_that_made_the_view(x: float, y: float, heading: float) -> None:
    pose = np.array([x, y, heading])
    assume(np.hypot(*(GOAL - pose[:2]).T).min() > 0.02)
    inputs = view(pose)
    np.testing.assert_allclose(pose_error(pose_of(inputs), pose), 0.0, atol=1e-9)


@moderate
@given(scale=st.floats(1e-3, 1e3))
def test_only_the_ratio_of_the_sizes_matters(scale: float) -> None:
    inputs = view(np.array([1.0, 0.7, 0.3]))
    scaled = inputs * [1, 1, scale, scale]
    np.testing.assert_allclose(pose_of(scaled), pose_of(inputs), atol=1e-12)


@moderate
@given(x=coordinates, y=coordinates, heading=headings)
def test_the_position_is_one_of_the_two_that_the_papers_unsigned_angle_leaves(
    x: float, y: float, heading: float
) -> None:
    pose = np.array([x, y, heading])
    assume(np.hypot(*(GOAL - pose[:2]).T).min() > 0.02)
    inputs = view(pose)
    alpha = wrap(inputs[1] - inputs[0])
    right, left = positions_from_angle(np.abs(alpha), inputs[2:], GOAL).position
    # on the right of the way from post 1 to post 2, post 1 is the left one
    np.testing.assert_allclose(pose_of(inputs)[:2], right if alpha <= 0 else left, atol=1e-9)


SINGULAR_FOR_THE_PAPER = [
    np.array([1.7, 1.3, 0.4]),  # 90 degrees at post 1
    np.array([1.7 + 1e-8, 1.3 - 1e-8, 0.4]),
    np.array([2.0, -1.3, -2.0]),  # 90 degrees at post 2
    np.array([2.0, -1.3 + 1e-9, -2.0]),
    np.array([0.0, 0.0, 0.0]),  # equal sizes
    np.array([0.0, 1e-9, 0.0]),
    np.array([4.5, 3.0, 1.0]),  # in line with both posts
    np.array([4.5, 0.2, 1.0]),  # in line, between them
    np.array([4.5 + 1e-9, 0.2, 1.0]),
    np.array([4.45, 1.32, 3.1]),  # nearly touching one
    np.array([-4.4, 2.9, np.pi]),
]


@pytest.mark.parametrize("pose", SINGULAR_FOR_THE_PAPER, ids=lambda pose: str(pose.tolist()))
def test_the_jacobians_are_the_central_differences_where_the_papers_are_infinite(pose: FloatArray) -> None:
    check_jacobians(pose)


@moderate
@given(x=coordinates, y=coordinates, heading=headings)
def test_the_jacobians_are_the_central_differences_everywhere(x: float, y: float, heading: float) -> None:
    pose = np.array([x, y, heading])
    assume(np.hypot(*(GOAL - pose[:2]).T).min() > 0.05)
    check_jacobians(pose)


def check_jacobians(pose: FloatArray) -> None:
    """To 1e-6 of the largest change of each coordinate; the sizes are differenced in units of themselves."""
    inputs = view(pose)
    unit = np.concatenate([[1.0, 1.0], inputs[2:]])
    found = poses_from_two_posts(inputs[:2], inputs[2:], GOAL)

    def relative_to_truth(scaled: FloatArray) -> FloatArray:
        return pose_error(pose_of(scaled * unit), pose)

    def by_posts(posts: FloatArray) -> FloatArray:
        return pose_error(pose_of(inputs, posts.reshape(2, 2)), pose)

    for analytic, numeric in [
        (found.jacobian * unit, central_difference(relative_to_truth, inputs / unit, step=1e-5)),
        (found.post_jacobian, central_difference(by_posts, GOAL.ravel(), step=1e-5)),
    ]:
        largest = np.abs(numeric).max(axis=1, keepdims=True)
        np.testing.assert_allclose(analytic / largest, numeric / largest, rtol=0, atol=1e-6)


def correlated(rng: np.random.Generator, sigmas: list[float]) -> FloatArray:
    root = rng.normal(size=(len(sigmas), len(sigmas)))
    covariance = root @ root.T
    scale = np.array(sigmas) / np.sqrt(np.diag(covariance))
    return covariance * np.outer(scale, scale)


def test_the_covariance_takes_correlated_inputs_and_the_posts_own_errors() -> None:
    rng = np.random.default_rng(3)
    noise = correlated(rng, [1e-4, 2e-4, 1e-5, 1e-5])
    survey = np.stack([correlated(rng, [1e-3, 3e-3]), correlated(rng, [2e-3, 1e-3])])
    inputs = view(np.array([2.0, -0.8, 0.3]))
    found = poses_from_two_posts(inputs[:2], inputs[2:], GOAL)
    by_inputs = central_difference(pose_of, inputs, step=1e-6)
    by_posts = central_difference(lambda posts: pose_of(inputs, posts.reshape(2, 2)), GOAL.ravel())
    blocks = np.zeros((4, 4))
    blocks[:2, :2], blocks[2:, 2:] = survey
    expected = by_inputs @ noise @ by_inputs.T + by_posts @ blocks @ by_posts.T
    first_order = found.first_order_covariance(noise, survey)
    np.testing.assert_allclose(first_order, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    (fix,) = fix_two_posts(inputs[:2], inputs[2:], noise, GOAL, survey)
    np.testing.assert_array_equal(fix.covariance, first_order)
    np.testing.assert_array_equal(fix.first_order_covariance, first_order)
    uncorrelated = found.first_order_covariance(np.diag(np.diag(noise)), survey)
    assert np.abs(uncorrelated / first_order - 1).max() > 0.05  # the correlations do matter here


def test_a_shift_of_both_posts_shifts_the_robot() -> None:
    inputs = view(np.array([2.0, -0.8, 0.3]))
    to_both = poses_from_two_posts(inputs[:2], inputs[2:], GOAL).post_jacobian @ np.vstack([np.eye(2), np.eye(2)])
    np.testing.assert_allclose(to_both, [[1, 0], [0, 1], [0, 0]], atol=1e-12)


def test_posts_in_the_other_order_put_the_robot_on_the_other_side() -> None:
    inputs = view(np.array([2.0, -0.8, 0.3]))
    (fix,) = fix_two_posts(inputs[:2], inputs[2:], GOOD_NOISE, GOAL)
    (other,) = fix_two_posts(inputs[:2], inputs[2:], GOOD_NOISE, GOAL[::-1])
    np.testing.assert_allclose(other.pose[:2], 2 * GOAL.mean(axis=0) - fix.pose[:2], atol=1e-9)
    assert np.abs(wrap(other.pose[2] - fix.pose[2])) == pytest.approx(np.pi)


def test_alike_posts_leave_every_ordered_pair() -> None:
    pose = np.array([2.0, -0.8, 0.3])
    inputs = view(pose)
    positions = np.concatenate([GOAL, OWN_GOAL])
    fixes = fix_two_alike_posts(inputs[:2], inputs[2:], GOOD_NOISE, positions)
    assert len(fixes) == 12
    errors = [np.abs(pose_error(fix.pose, pose)).max() for fix in fixes]
    assert min(errors) < 1e-9
    turned = np.array([-2.0, 0.8, 0.3 - np.pi])  # the field's own symmetry
    assert min(np.abs(pose_error(fix.pose, turned)).max() for fix in fixes) < 1e-9
    for fix in fixes:
        seen = [view(fix.pose, positions[[i, j]]) for i in range(4) for j in range(4) if i != j]
        agree = [
            np.abs(wrap(s[:2] - inputs[:2])).max() < 1e-9 and s[2] / s[3] == pytest.approx(inputs[2] / inputs[3])
            for s in seen
        ]
        assert any(agree)
    assert {fix.log_weight for fix in fixes} == {0.0}


def test_alike_posts_keep_their_own_survey_errors() -> None:
    inputs = view(np.array([2.0, -0.8, 0.3]))
    positions = np.concatenate([GOAL, OWN_GOAL])
    survey = np.stack([np.eye(2) * (0.001 * i) ** 2 for i in range(4)])
    fixes = fix_two_alike_posts(inputs[:2], inputs[2:], GOOD_NOISE, positions, survey)
    (expected,) = fix_two_posts(inputs[:2], inputs[2:], GOOD_NOISE, OWN_GOAL, survey[2:])
    assert any(np.array_equal(fix.covariance, expected.covariance) for fix in fixes)


NOTHING = [
    ([0.3, -0.3], [0.0, 0.01], GOAL),
    ([0.3, -0.3], [0.01, -0.01], GOAL),
    ([0.3, -0.3], [0.01, np.nan], GOAL),
    ([0.3, -0.3], [1e-300, 1e300], GOAL),
    ([np.nan, -0.3], [0.01, 0.01], GOAL),
    ([np.inf, -0.3], [0.01, 0.01], GOAL),
    ([0.3, 0.3], [0.01, 0.01], GOAL),  # equal sizes under no angle
    ([0.3, 0.3 + 1e-15], [0.01, 0.01], GOAL),
    ([0.3, 0.3 - 2 * np.pi], [0.01, 0.01], GOAL),
    ([0.3, -0.3], [0.01, 0.01], np.ones((2, 2))),  # coincident
    ([0.3, -0.3], [0.01, 0.01], np.array([[1.0, np.nan], [2.0, 2.0]])),
    ([0.3, -0.3], [0.01, 0.01], np.array([[1.0, np.inf], [2.0, np.inf]])),
]


@pytest.mark.parametrize(("bearings", "sizes", "posts"), NOTHING)
def test_degenerate_geometry_gives_no_fix_and_no_nan(
    bearings: list[float], sizes: list[float], posts: FloatArray
) -> None:
    b, s = np.array(bearings), np.array(sizes)
    assert fix_two_posts(b, s, GOOD_NOISE, posts) == ()
    found = poses_from_two_posts(b, s, posts)
    assert np.all(np.isfinite(found.pose))
    assert np.all(np.isfinite(found.jacobian))
    assert np.all(np.isfinite(found.post_jacobian))
    assert not np.any(np.isnan(covariance_of_two_posts(b, s, GOOD_NOISE, posts)))


@moderate
@given(
    numbers=st.lists(
        st.floats(-1e3, 1e3) | st.sampled_from([0.0, np.nan, np.inf, 1e-310, np.pi]), min_size=4, max_size=4
    ),
    sigma=st.sampled_from([0.0, 1e-6, 1e-2, 1.0]),
)
def test_whatever_is_seen_a_fix_is_finite_with_a_covariance(numbers: list[float], sigma: float) -> None:
    inputs = np.array(numbers)
    for fix in fix_two_posts(inputs[:2], inputs[2:], np.eye(4) * sigma**2, GOAL):
        assert np.all(np.isfinite(fix.pose))
        scale = np.abs(fix.covariance).max()
        assert np.linalg.eigvalsh(fix.covariance)[0] >= -1e-9 * scale


def test_a_stack_is_solved_as_its_parts() -> None:
    rng = np.random.default_rng(15)
    poses = poses_in_front_of_the_goal(rng, 6, 1.0, 4.0).reshape(2, 3, 3)
    seen = view(poses)
    seen[1, 1, 2] = np.nan
    noises = np.stack([GOOD_NOISE, 4 * GOOD_NOISE, edge_noise(600.0, 0.5)])
    posts = np.stack([GOAL, OWN_GOAL])[:, None]
    found = poses_from_two_posts(seen[..., :2], seen[..., 2:], posts)
    covariances = covariance_of_two_posts(seen[..., :2], seen[..., 2:], noises, posts)
    first_order = found.first_order_covariance(noises)
    assert found.jacobian.shape == (2, 3, 3, 4)
    for i, j in np.ndindex(2, 3):
        one = poses_from_two_posts(seen[i, j, :2], seen[i, j, 2:], posts[i, 0])
        fixes = fix_two_posts(seen[i, j, :2], seen[i, j, 2:], noises[j], posts[i, 0])
        if (i, j) == (1, 1):
            assert not found.solvable[i, j]
            assert fixes == ()
            assert np.all(np.isinf(np.diag(covariances[i, j])))
            assert np.all(np.isinf(np.diag(first_order[i, j])))
        else:
            np.testing.assert_array_equal(found.pose[i, j], fixes[0].pose)
            np.testing.assert_allclose(covariances[i, j], fixes[0].covariance, rtol=1e-12)
            np.testing.assert_allclose(first_order[i, j], one.first_order_covariance(noises[j]), rtol=1e-12)


def test_a_callers_mistake_is_a_value_error() -> None:
    bearings, sizes = np.array([0.3, -0.3]), np.array([0.01, 0.01])
    with pytest.raises(ValueError, match="bearings_rad"):
        fix_two_posts(np.zeros(3), sizes, GOOD_NOISE, GOAL)
    with pytest.raises(ValueError, match="sizes"):
        fix_two_posts(bearings, np.zeros((1, 2)), GOOD_NOISE, GOAL)
    with pytest.raises(ValueError, match="posts"):
        fix_two_posts(bearings, sizes, GOOD_NOISE, np.zeros((3, 2)))
    with pytest.raises(ValueError, match="covariance"):
        fix_two_posts(bearings, sizes, np.eye(3), GOAL)
    with pytest.raises(ValueError, match="semidefinite"):
        fix_two_posts(bearings, sizes, np.diag([1.0, 1.0, 1.0, -1e-12]), GOAL)
    exact_but_correlated = np.diag([0.0, 1.0, 1.0, 1.0])
    exact_but_correlated[0, 1] = exact_but_correlated[1, 0] = 1e-7
    with pytest.raises(ValueError, match="semidefinite"):
        fix_two_posts(bearings, sizes, exact_but_correlated, GOAL)
    with pytest.raises(ValueError, match="symmetric"):
        fix_two_posts(bearings, sizes, np.eye(4) + np.eye(4, k=1), GOAL)
    with pytest.raises(ValueError, match="finite"):
        fix_two_posts(bearings, sizes, np.full((4, 4), np.nan), GOAL)
    with pytest.raises(ValueError, match="posts_covariance"):
        fix_two_posts(bearings, sizes, GOOD_NOISE, GOAL, np.eye(2))
    with pytest.raises(ValueError, match="posts_covariance"):
        fix_two_posts(bearings, sizes, GOOD_NOISE, GOAL, np.stack([np.eye(2), -np.eye(2)]))
    with pytest.raises(ValueError, match="positions"):
        fix_two_alike_posts(bearings, sizes, GOOD_NOISE, np.zeros((4, 3)))
