import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fieldloc import pose as se2
from fieldloc.covariance import central_difference
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor, innovation_covariance
from fieldloc.fixes.base import Fix
from fieldloc.pose import FloatArray

P3 = np.array([[0.04, 0.01, 0.002], [0.01, 0.02, -0.003], [0.002, -0.003, 0.01]])
P2 = np.array([[0.03, 0.01], [0.01, 0.02]])

headings = st.sampled_from([0.0, 1e-9, np.pi, -np.pi, np.pi - 1e-3, -np.pi + 1e-3]) | st.floats(-7.0, 7.0)
poses = st.tuples(st.floats(-9, 9), st.floats(-9, 9), headings).map(np.array)
points = st.tuples(st.floats(-9, 9), st.floats(-9, 9)).map(np.array)
factors = (
    st.builds(lambda pose: PoseFactor(1, pose, P3), poses)
    | st.builds(lambda there, seen: LandmarkFactor(1, there, seen, P2), points, points)
    | st.builds(lambda heading: HeadingFactor(1, heading, P2[:1, :1]), headings)
    | st.builds(
        lambda heading, normal, offset: LineFactor(1, heading, normal, offset, P2), headings, headings, headings
    )
)


def wraps_nearby(factor: Factor, pose: FloatArray) -> bool:
    """At the half turn from what the factor says its error jumps: no derivative there."""
    match factor:
        case PoseFactor():
            return abs(se2.wrap(pose[2] - factor.pose[2])) > 3.1
        case HeadingFactor() | LineFactor():
            return abs(se2.wrap(pose[2] - factor.heading_rad)) > np.pi - 1e-4
    return False


@settings(deadline=None, max_examples=300)
@given(factors, poses)
def test_the_jacobian_is_the_derivative_by_the_robot_frame_tangent(factor: Factor, pose: FloatArray) -> None:
    assume(not wraps_nearby(factor, pose))
    numeric = central_difference(lambda d: factor.error(se2.retract(pose, d)), np.zeros(3))
    assert factor.jacobian(pose).shape == (len(factor.covariance), 3)
    # the log's Jacobian grows with the distance and towards the half turn: relative to its largest number
    np.testing.assert_allclose(factor.jacobian(pose), numeric, atol=1e-7 * max(1.0, np.abs(numeric).max()))


@settings(deadline=None)
@given(factors, st.lists(poses, min_size=1, max_size=4))
def test_the_error_of_a_stack_is_that_of_each(factor: Factor, stack: list[FloatArray]) -> None:
    together = factor.error(np.array([stack, stack]))
    assert together.shape == (2, len(stack), len(factor.covariance))
    for pose, error in zip(stack, together[1], strict=True):
        np.testing.assert_array_equal(factor.error(pose), error)


@settings(deadline=None)
@given(factors, poses)
def test_no_error_is_more_than_half_a_turn(factor: Factor, pose: FloatArray) -> None:
    match factor:
        case PoseFactor():
            assert abs(factor.error(pose)[2]) <= np.pi
        case HeadingFactor() | LineFactor():
            assert abs(factor.error(pose)[0]) <= np.pi


@settings(deadline=None)
@given(poses)
def test_the_error_is_zero_at_the_pose_that_made_the_factor(pose: FloatArray) -> None:
    landmark, normal_rad = np.array([1.0, 2.0]), 0.7
    seen = se2.apply(se2.inverse(pose), landmark)
    offset = np.cos(normal_rad) * pose[0] + np.sin(normal_rad) * pose[1]
    exact: tuple[Factor, ...] = (
        PoseFactor(1, pose, P3),
        LandmarkFactor(1, landmark, seen, P2),
        HeadingFactor(1, pose[2], P2[:1, :1]),
        LineFactor(1, pose[2], normal_rad, float(offset), P2),
    )
    for factor in exact:
        np.testing.assert_allclose(factor.error(pose), 0.0, atol=1e-12)


def test_the_errors_have_the_units_and_signs_of_their_docstrings() -> None:
    pose = np.array([1.0, 2.0, np.pi / 2])  # looks along y
    np.testing.assert_allclose(
        LandmarkFactor(1, np.array([1.0, 5.0]), np.array([2.5, 0.25]), P2).error(pose), [0.5, -0.25], atol=1e-12
    )
    np.testing.assert_allclose(HeadingFactor(1, 1.5, P2[:1, :1]).error(pose), [np.pi / 2 - 1.5], atol=1e-12)
    # a line parallel to x at y = 1.5: heading error first, then the offset
    np.testing.assert_allclose(LineFactor(1, 1.5, np.pi / 2, 1.5, P2).error(pose), [np.pi / 2 - 1.5, 0.5], atol=1e-12)
    # half a metre ahead in the factor's own frame
    np.testing.assert_allclose(PoseFactor(1, np.array([1.0, 1.5, np.pi / 2]), P3).error(pose), [0.5, 0, 0], atol=1e-12)


@settings(deadline=None)
@given(poses)
def test_a_fixs_covariance_is_turned_into_the_robots_frame(pose: FloatArray) -> None:
    factor = PoseFactor.from_fix(7, Fix(pose, P3))
    assert factor.stamp_ns == 7
    np.testing.assert_array_equal(factor.pose, pose)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    field_from_robot = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(field_from_robot @ factor.covariance @ field_from_robot.T, P3, atol=1e-12)


def test_the_innovations_covariance_is_its_spread() -> None:
    random = np.random.default_rng(2)
    pose, belief = np.array([0.5, -1.0, 3.0]), 1e-4 * P3  # small enough for first order
    truth = se2.retract(pose, random.multivariate_normal(np.zeros(3), belief, 40_000))
    seen = se2.apply(se2.inverse(truth), np.array([2.0, 1.0])) + random.multivariate_normal([0, 0], 1e-4 * P2, 40_000)
    residuals = se2.apply(se2.inverse(pose), np.array([2.0, 1.0])) - seen
    factor = LandmarkFactor(1, np.array([2.0, 1.0]), seen[0], 1e-4 * P2)
    jacobian, expected = innovation_covariance(factor, pose, belief)
    np.testing.assert_array_equal(jacobian, factor.jacobian(pose))
    whitener = np.linalg.inv(np.linalg.cholesky(expected))
    # standard error of a sampled variance: sqrt(2 / 40000) = 0.7 %; five of these
    np.testing.assert_allclose(whitener @ np.cov(residuals.T) @ whitener.T, np.eye(2), atol=0.035)


@pytest.mark.parametrize("pose", [np.array([1.0, 0.5, 3.0]), np.array([-2.0, 1.0, -0.4])])
def test_a_line_factor_does_not_care_where_along_the_line_the_robot_stands(pose: FloatArray) -> None:
    factor = LineFactor(1, 0.3, 0.9, 0.4, P2)
    along = np.array([-np.sin(0.9), np.cos(0.9), 0.0])
    np.testing.assert_allclose(factor.error(pose + 5.0 * along), factor.error(pose), atol=1e-12)
    # the same line described from its other side
    other = LineFactor(1, 0.3, 0.9 + np.pi, -0.4, P2)
    np.testing.assert_allclose(other.error(pose), factor.error(pose) * [1.0, -1.0], atol=1e-12)
