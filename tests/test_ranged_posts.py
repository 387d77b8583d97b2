import numpy as np
import pytest
from goal_views import GOAL, OWN_GOAL, edge_noise, pose_error
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.stats import chi2 as chi_square

from fieldloc.covariance import central_difference, squared_mahalanobis
from fieldloc.fixes.post_fix import PostFix
from fieldloc.fixes.ranged_posts import fix_alike_ranged_posts, fix_ranged_posts
from fieldloc.fixes.sizes import HalfWidths, InverseRanges, PaperSizes, Ranges, SizeModel
from fieldloc.fixes.two_posts import fix_two_posts
from fieldloc.pose import FloatArray, wrap

WIDTHS = HalfWidths(0.05)
MODELS: list[SizeModel] = [
    WIDTHS,
    HalfWidths(np.array([0.05, 0.08])),
    Ranges(),
    InverseRanges(),
    PaperSizes(600.0, 0.1),
]

moderate = settings(deadline=None, max_examples=15)


def view(pose: FloatArray, model: SizeModel = WIDTHS, posts: FloatArray = GOAL) -> FloatArray:
    to_posts = posts - pose[:2]
    bearings = wrap(np.arctan2(to_posts[:, 1], to_posts[:, 0]) - pose[2])
    return np.concatenate([bearings, model.of_range(np.hypot(to_posts[:, 0], to_posts[:, 1]))[0]])


def solve(seen: FloatArray, noise: FloatArray, model: SizeModel = WIDTHS, **more: FloatArray) -> tuple[PostFix, ...]:
    return fix_ranged_posts(seen[:2], seen[2:], noise, GOAL, model, **more)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
@moderate
@given(x=st.floats(-5, 5), y=st.floats(-5, 5), heading=st.floats(-np.pi, np.pi))
def test_the_pose_that_made_the_view_is_among_the_solutions(
    model: SizeModel, x: float, y: float, heading: float
) -> None:
    pose = np.array([x, y, heading])
    assume(np.hypot(*(GOAL - pose[:2]).T).min() > 0.15)
    seen = view(pose, model)
    noise = np.diag([1e-4, 1e-4, *(1e-3 * np.abs(seen[2:]))]) ** 2
    fixes = solve(seen, noise, model)
    errors = [np.abs(pose_error(fix.pose, pose)).max() for fix in fixes]
    assert min(errors) < 1e-6
    assert fixes[int(np.argmin(errors))].chi2 < 1e-6
    assert [fix.log_weight for fix in fixes] == sorted((fix.log_weight for fix in fixes), reverse=True)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
def test_a_size_model_and_its_derivative_agree(model: SizeModel) -> None:
    distances = np.array([0.7, 6.0])
    size, slope = model.of_range(distances)
    np.testing.assert_allclose(model.range_of(size), distances)
    numeric = central_difference(lambda x: model.of_range(x)[0], distances, 1e-5)
    np.testing.assert_allclose(np.diag(slope), numeric, rtol=1e-6, atol=1e-8)
    assert np.all(np.isnan(model.range_of(np.array([0.0, -1.0]))))


def test_the_pose_is_the_least_squares_one() -> None:
    """An optimiser of its own, over the pose itself; the posts' errors and correlated noise included."""
    rng = np.random.default_rng(2)
    truth = np.array([2.3, 0.9, 0.2])
    root = rng.normal(size=(4, 4))
    noise = root @ root.T * 1e-7 + np.eye(4) * 1e-7
    survey = np.stack([np.diag([1e-4, 4e-4]), np.diag([9e-4, 1e-4])])
    seen = view(truth) + np.linalg.cholesky(noise) @ rng.normal(size=4)
    (fix,) = solve(seen, noise, posts_covariance=survey)
    by_posts = central_difference(lambda p: view(fix.pose, posts=p.reshape(2, 2)), GOAL.ravel())
    blocks = np.zeros((4, 4))
    blocks[:2, :2], blocks[2:, 2:] = survey
    total = noise + by_posts @ blocks @ by_posts.T
    whiten = np.linalg.inv(np.linalg.cholesky(total))
    best = least_squares(lambda pose: whiten @ (seen - view(pose)), truth, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    np.testing.assert_allclose(fix.pose, best.x, atol=1e-6)
    assert fix.chi2 == pytest.approx(2 * best.cost, rel=1e-4)


def test_near_posts_carry_the_first_order_covariance_with_the_posts_errors() -> None:
    pose = np.array([2.3, 0.9, 0.2])
    noise = edge_noise(600.0, 0.02) + 1e-8 * np.ones((4, 4))
    survey = np.stack([np.diag([1e-6, 4e-6]), np.diag([9e-6, 1e-6])])
    (fix,) = solve(view(pose), noise, posts_covariance=survey)
    jacobian = central_difference(view, pose)
    by_posts = central_difference(lambda p: view(pose, posts=p.reshape(2, 2)), GOAL.ravel())
    blocks = np.zeros((4, 4))
    blocks[:2, :2], blocks[2:, 2:] = survey
    total = noise + by_posts @ blocks @ by_posts.T
    expected = np.linalg.inv(jacobian.T @ np.linalg.inv(total) @ jacobian)
    np.testing.assert_allclose(fix.covariance, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_knowing_the_scale_never_makes_the_fix_worse() -> None:
    for place in ([2.0, -0.8, 0.3], [0.5, 1.5, 0.0], [3.5, 0.0, 0.0]):
        seen = view(np.array(place))
        noise = edge_noise(600.0, 0.01)
        (ranged,) = solve(seen, noise)
        (ratio,) = fix_two_posts(seen[:2], np.sin(seen[2:]), noise, GOAL)
        assert np.linalg.eigvalsh(ratio.covariance - ranged.covariance)[0] > -1e-3 * ranged.covariance[0, 0]


def test_chi2_has_one_degree_of_freedom() -> None:
    rng = np.random.default_rng(4)
    truth, noise = np.array([2.0, 1.0, 0.1]), edge_noise(600.0, 0.3)
    values = [solve(view(truth) + rng.normal(size=4) * np.sqrt(np.diag(noise)), noise)[0].chi2 for _ in range(200)]
    # the mean of 200 chi-squares of one degree has a standard deviation of sqrt(2 / 200)
    assert np.mean(values) == pytest.approx(1.0, abs=3.5 * np.sqrt(2 / 200))


def test_a_wrong_diameter_shows_in_chi2() -> None:
    seen = view(np.array([2.0, 1.0, 0.1]), HalfWidths(0.06))
    assert min(fix.chi2 for fix in solve(seen, edge_noise(600.0, 0.3))) > chi_square.ppf(0.999, 1)


def test_the_covariance_does_not_depend_on_where_the_robot_looks() -> None:
    """Not even where its heading is about to jump from pi to -pi."""
    noise = edge_noise(600.0, 0.5)
    (ahead,), (astern,) = (solve(view(np.array([0.0, 1.0, heading])), noise) for heading in (0.0, np.pi))
    np.testing.assert_allclose(astern.covariance, ahead.covariance, rtol=1e-6)


def test_two_places_on_one_circle_can_explain_both_ranges() -> None:
    """Far to the side of a goal the sizes are nearly equal: which one is larger tells left from right, barely."""
    truth = np.array([1.5, 4.0, -0.8])
    fixes = solve(view(truth), edge_noise(600.0, 0.3))
    assert len(fixes) == 2
    assert np.abs(pose_error(fixes[0].pose, truth)).max() < 1e-6
    assert fixes[1].pose[1] < 0
    assert fixes[1].chi2 > fixes[0].chi2 + 1
    assert fixes[0].log_weight - fixes[1].log_weight == pytest.approx((fixes[1].chi2 - fixes[0].chi2) / 2, abs=1e-6)


FAR = [
    ([1.5, 1.0, -0.3], 0.3),
    ([0.0, 0.0, 0.1], 0.3),
    ([0.0, 0.0, 0.1], 1.0),
    ([-1.5, 2.0, -0.4], 0.3),
    ([-4.5, 0.0, 0.0], 0.3),  # 6.7 px wide
    ([-4.5, 0.0, 0.0], 1.0),
    ([1.5, 4.0, -0.8], 0.3),
]


def mean_nees(truth: FloatArray, noise: FloatArray, number: int) -> float:
    """Of two places on the circle the one nearer to the truth counts: the other is another solution, not an error."""
    rng = np.random.default_rng(6)
    nees = []
    for _ in range(number):
        fixes = solve(view(truth) + rng.normal(size=4) * np.sqrt(np.diag(noise)), noise)
        nees.append(min(float(squared_mahalanobis(pose_error(fix.pose, truth), fix.covariance)) for fix in fixes))
    return float(np.mean(nees)) / 3


@pytest.mark.parametrize(("pose", "sigma_px"), [FAR[1], FAR[5]])
def test_a_far_fix_is_not_overconfident(pose: list[float], sigma_px: float) -> None:
    assert mean_nees(np.array(pose), edge_noise(600.0, sigma_px), 100) < 1.3


@pytest.mark.slow
@pytest.mark.parametrize(("pose", "sigma_px"), FAR)
def test_no_far_fix_is_overconfident(pose: list[float], sigma_px: float) -> None:
    assert mean_nees(np.array(pose), edge_noise(600.0, sigma_px), 600) < 1.3  # the tails are heavy


@pytest.mark.slow
def test_the_covariance_of_random_fixes_is_their_sampled_spread() -> None:
    rng = np.random.default_rng(7)
    noise = edge_noise(600.0, 0.2)
    white = []
    for _ in range(1_000):
        direction, distance = rng.uniform(np.pi / 2 + 0.25, 3 * np.pi / 2 - 0.25), rng.uniform(1.0, 4.5)
        truth = np.array([4.5 + distance * np.cos(direction), distance * np.sin(direction), rng.uniform(-3, 3)])
        fixes = solve(view(truth) + rng.normal(size=4) * np.sqrt(np.diag(noise)), noise)
        errors = [pose_error(fix.pose, truth) for fix in fixes]
        each = [np.linalg.solve(np.linalg.cholesky(f.covariance), e) for f, e in zip(fixes, errors, strict=True)]
        white.append(min(each, key=lambda w: float(w @ w)))
    second_moment = np.array(white).T @ np.array(white) / len(white)
    # 1,000 samples leave 6 % of their own
    assert np.linalg.norm(second_moment - np.eye(3)) / np.sqrt(3) < 0.12


def test_alike_posts_are_told_apart_by_the_distance_between_them() -> None:
    truth = np.array([2.0, -0.8, 0.3])
    positions = np.concatenate([GOAL, OWN_GOAL])
    seen = view(truth)
    fixes = fix_alike_ranged_posts(seen[:2], seen[2:], edge_noise(600.0, 0.3), positions, WIDTHS)
    good = fixes[:4]
    # either goal, from either side: the distances between the posts agree
    assert all(fix.chi2 < 1e-6 for fix in good)
    assert min(np.abs(pose_error(fix.pose, truth)).max() for fix in good) < 1e-6
    assert len(fixes) >= 12
    assert all(fix.chi2 > 50 for fix in fixes[4:])


NOTHING = [
    ([0.3, -0.3], [0.0, 0.01], GOAL),
    ([0.3, -0.3], [-0.01, 0.01], GOAL),
    ([0.3, -0.3], [2.0, 0.01], GOAL),  # wider than half the horizon
    ([0.3, -0.3], [np.nan, 0.01], GOAL),
    ([np.inf, -0.3], [0.01, 0.01], GOAL),
    ([0.3, -0.3], [0.01, 0.01], np.ones((2, 2))),
    ([0.3, -0.3], [0.01, 0.01], np.array([[1.0, np.nan], [2.0, 2.0]])),
]


@pytest.mark.parametrize(("bearings", "sizes", "posts"), NOTHING)
def test_degenerate_geometry_gives_no_fix(bearings: list[float], sizes: list[float], posts: FloatArray) -> None:
    assert fix_ranged_posts(np.array(bearings), np.array(sizes), edge_noise(600.0, 0.3), posts, WIDTHS) == ()


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
@moderate
@given(
    alpha=st.floats(-np.pi, np.pi) | st.sampled_from([0.0, 1e-9, np.pi]),
    first=st.floats(0.1, 12.0),
    second=st.floats(0.1, 12.0),
    sigma=st.sampled_from([1e-4, 1e-3, 1e-2]),
)
def test_observations_that_contradict_each_other_give_finite_fixes_or_none(
    model: SizeModel, alpha: float, first: float, second: float, sigma: float
) -> None:
    sizes = model.of_range(np.array([first, second]))[0]
    noise = np.diag([sigma, sigma, *(np.abs(sizes) * 10 * sigma)]) ** 2
    fixes = fix_ranged_posts(np.array([0.2, 0.2 + alpha]), sizes, noise, GOAL, model)
    for fix in fixes:
        assert np.all(np.isfinite(fix.pose))
        assert np.isfinite(fix.chi2)
        assert np.isfinite(fix.log_weight)
        scale = np.sqrt(np.diag(fix.covariance))
        assert np.linalg.eigvalsh(fix.covariance / np.outer(scale, scale))[0] > -1e-9


@pytest.mark.parametrize("separation_m", [1e-6, 0.05, 0.1])
def test_posts_that_stand_in_each_other_give_finite_fixes_or_none(separation_m: float) -> None:
    posts = np.array([[1.0, 0.0], [1.0, separation_m]])
    for sizes in ([0.05, 0.05], [1.5, 1.5], [0.05, 1.5]):
        for fix in fix_ranged_posts(np.array([0.1, 0.2]), np.array(sizes), edge_noise(600.0, 0.3), posts, WIDTHS):
            assert np.all(np.isfinite(fix.pose))
            assert np.all(np.isfinite(fix.covariance))


def test_a_callers_mistake_is_a_value_error() -> None:
    with pytest.raises(ValueError, match="radius_m"):
        HalfWidths(0.0)
    with pytest.raises(ValueError, match="diameter_m"):
        PaperSizes(600.0, np.array([0.1, -0.1]))
    seen, noise = view(np.array([2.0, -0.8, 0.3])), edge_noise(600.0, 0.3)
    with pytest.raises(ValueError, match="bearings_rad"):
        fix_ranged_posts(np.zeros(3), seen[2:], noise, GOAL, WIDTHS)
    with pytest.raises(ValueError, match="positive definite"):
        solve(seen, np.zeros((4, 4)))
    with pytest.raises(ValueError, match="posts"):
        fix_ranged_posts(seen[:2], seen[2:], noise, GOAL[0], WIDTHS)
    with pytest.raises(ValueError, match="posts_covariance"):
        solve(seen, noise, posts_covariance=np.eye(4))
    with pytest.raises(ValueError, match="positions"):
        fix_alike_ranged_posts(seen[:2], seen[2:], noise, np.zeros((4, 3)), WIDTHS)
