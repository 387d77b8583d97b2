import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fieldloc.covariance import central_difference
from fieldloc.fixes.central_angle import central_angle_arcs, positions_from_angle, two_post_triangle
from fieldloc.pose import FloatArray

POSTS = np.array([[1.0, 2.0], [2.5, 1.0]])
SEPARATION = float(np.hypot(1.5, 1.0))

angles = st.floats(0.02, np.pi - 0.02)
log_ratios = st.floats(-2.0, 2.0)
moderate = settings(deadline=None, max_examples=60)


def angle_between(place: FloatArray, posts: FloatArray) -> FloatArray:
    """Unsigned angle (...) under which posts are seen from places (..., 2)."""
    to1, to2 = posts[0] - place, posts[1] - place
    cross = to1[..., 0] * to2[..., 1] - to1[..., 1] * to2[..., 0]
    return np.asarray(np.abs(np.arctan2(cross, np.sum(to1 * to2, axis=-1))))


@moderate
@given(alpha=angles, fraction=st.floats(0.01, 0.99))
def test_every_point_of_both_arcs_sees_the_posts_under_the_angle(alpha: float, fraction: float) -> None:
    arcs = central_angle_arcs(alpha, POSTS)
    assert len(arcs) == 2
    for arc in arcs:
        assert angle_between(arc.points(np.array(fraction)), POSTS) == pytest.approx(alpha, abs=1e-9)
        assert np.hypot(*(POSTS - arc.centre).T) == pytest.approx(arc.radius_m)
        np.testing.assert_allclose(arc.points(np.array([0.0, 1.0])), POSTS, atol=1e-9)


@pytest.mark.parametrize("alpha_deg", [30.0, 90.0, 150.0])
def test_the_central_angle_is_twice_the_acute_and_twice_the_supplement_of_the_obtuse(alpha_deg: float) -> None:
    alpha = np.radians(alpha_deg)
    for arc in central_angle_arcs(alpha, POSTS):
        to_posts = POSTS - arc.centre
        central = np.arccos(np.clip(to_posts[0] @ to_posts[1] / arc.radius_m**2, -1, 1))
        assert central == pytest.approx(min(2 * alpha, 2 * np.pi - 2 * alpha), abs=1e-6)  # eqs. 1 and 2
        assert (abs(arc.sweep_rad) > np.pi + 1e-9) == (alpha_deg < 90)  # major arc, minor arc


def test_a_right_angle_has_the_posts_at_the_ends_of_a_diameter() -> None:
    for arc in central_angle_arcs(np.pi / 2, POSTS):
        np.testing.assert_allclose(arc.centre, POSTS.mean(axis=0), atol=1e-12)
        assert arc.radius_m == pytest.approx(SEPARATION / 2)


def test_the_first_arc_is_on_the_right_of_the_way_from_post_1_to_post_2() -> None:
    right, left = central_angle_arcs(0.8, np.array([[0.0, 0.0], [0.0, 1.0]]))
    assert right.points(np.array(0.5))[0] > 0
    assert left.points(np.array(0.5))[0] < 0


@pytest.mark.parametrize("alpha", [0.0, np.pi, -0.3, 4.0, np.nan, np.inf, 1e-320])
def test_an_impossible_angle_has_no_circle(alpha: float) -> None:
    assert central_angle_arcs(alpha, POSTS) == ()


def test_coincident_posts_have_no_circle() -> None:
    assert central_angle_arcs(1.0, np.ones((2, 2))) == ()
    assert central_angle_arcs(1.0, np.array([[0.0, np.nan], [1.0, 1.0]])) == ()


@moderate
@given(alpha=angles, log_ratio=log_ratios)
def test_the_triangle_closes(alpha: float, log_ratio: float) -> None:
    """Laws of cosines at all three corners, each with the angle that atan2 found."""
    sizes = np.array([1.0, np.exp(log_ratio)])
    t = two_post_triangle(np.array(alpha), sizes, np.array(SEPARATION))
    a, b, c = SEPARATION, float(t.distance2_m), float(t.distance1_m)
    assert c / b == pytest.approx(sizes[1] / sizes[0])  # eq. 3
    assert a**2 == pytest.approx(b**2 + c**2 - 2 * b * c * np.cos(alpha))
    assert b**2 == pytest.approx(a**2 + c**2 - 2 * a * c * np.cos(t.beta_rad))
    assert c**2 == pytest.approx(a**2 + b**2 - 2 * a * b * np.cos(t.delta_rad))
    assert alpha + t.beta_rad + t.delta_rad == pytest.approx(np.pi)


@moderate
@given(alpha=angles, log_ratio=log_ratios)
def test_both_positions_see_what_they_were_made_from(alpha: float, log_ratio: float) -> None:
    sizes = np.array([0.7, 0.7 * np.exp(log_ratio)])
    places = positions_from_angle(np.array(alpha), sizes, POSTS).position
    for place in places:
        distances = np.hypot(*(POSTS - place).T)
        assert angle_between(place, POSTS) == pytest.approx(alpha, abs=1e-9)
        assert distances[0] / distances[1] == pytest.approx(sizes[1] / sizes[0])
    along = (POSTS[1] - POSTS[0]) / SEPARATION
    side = along[0] * (places - POSTS[0])[:, 1] - along[1] * (places - POSTS[0])[:, 0]
    assert side[0] < 0 < side[1]
    assert side[0] == pytest.approx(-side[1])


RIGHT_ANGLE_AT_POST_1 = (0.9, 1 / np.cos(0.9))  # d1 / d2 = B / C with C = B cos(alpha)
RIGHT_ANGLE_AT_POST_2 = (0.9, np.cos(0.9))


@pytest.mark.parametrize(
    ("alpha", "d1"),
    [RIGHT_ANGLE_AT_POST_1, RIGHT_ANGLE_AT_POST_2, (0.7, 1.0), (1e-3, 1.2), (np.pi - 1e-3, 0.8), (0.05, 1.0 + 1e-9)],
)
@pytest.mark.parametrize("beside", [-1e-7, 0.0, 1e-7])
def test_all_gradients_are_the_central_differences_also_beside_right_angles(
    alpha: float, d1: float, beside: float
) -> None:
    def quantities(x: FloatArray) -> FloatArray:
        t = two_post_triangle(x[0], x[1:], np.array(SEPARATION))
        places = positions_from_angle(x[0], x[1:], POSTS).position
        return np.concatenate([[t.distance1_m, t.distance2_m, t.beta_rad, t.delta_rad], places.ravel()])

    x = np.array([alpha + beside, d1, 1.0])
    t = two_post_triangle(x[0], x[1:], np.array(SEPARATION))
    gradients = [t.distance1_gradient, t.distance2_gradient, t.beta_gradient, t.delta_gradient]
    analytic = np.concatenate([gradients, positions_from_angle(x[0], x[1:], POSTS).jacobian.reshape(4, 3)])
    numeric = central_difference(quantities, x, step=1e-6)
    np.testing.assert_allclose(analytic, numeric, rtol=0, atol=1e-6 * np.abs(numeric).max())


def test_beta_is_90_degrees_where_the_papers_eq_8_divides_by_zero() -> None:
    alpha, d1 = RIGHT_ANGLE_AT_POST_1
    t = two_post_triangle(np.array(alpha), np.array([d1, 1.0]), np.array(SEPARATION))
    assert t.beta_rad == pytest.approx(np.pi / 2)
    assert np.sin(alpha) * t.distance2_m / SEPARATION == pytest.approx(1.0)  # eq. 5's arcsin is at its end
    assert np.all(np.abs(t.beta_gradient) < 3)


def test_the_alpha_term_of_eq_12_is_negative() -> None:
    """The farther apart the posts appear the nearer they are; the paper prints a plus."""
    t = two_post_triangle(np.array(0.5), np.array([1.0, 1.1]), np.array(2.0))
    k = 1 + 1.1**2 - 2 * 1.1 * np.cos(0.5)
    assert t.distance2_gradient[0] == pytest.approx(-t.distance2_m / k * 1.1 * np.sin(0.5))
    slope = (1.1 - np.cos(0.5)) * t.distance2_m / k
    assert t.distance2_gradient[1:] == pytest.approx([slope * 1.1, -slope])  # these two terms are printed right


@pytest.mark.parametrize(
    ("alpha", "sizes"),
    [
        (0.0, [1.0, 1.0]),
        (0.5, [0.0, 1.0]),
        (0.5, [1.0, -1.0]),
        (0.5, [np.nan, 1.0]),
        (0.5, [1e-300, 1e300]),
        (np.nan, [1.0, 1.0]),
        (-0.1, [1.0, 2.0]),
        (3.2, [1.0, 2.0]),
        (np.inf, [1.0, 2.0]),
    ],
)
def test_no_triangle_is_a_mask_and_never_a_nan(alpha: float, sizes: list[float]) -> None:
    found = positions_from_angle(np.array(alpha), np.array(sizes), POSTS)
    assert not found.solvable
    assert not np.any(found.position)
    assert not np.any(found.jacobian)


def test_coincident_posts_make_no_triangle() -> None:
    assert not positions_from_angle(np.array(0.5), np.ones(2), np.ones((2, 2))).solvable
    assert not positions_from_angle(np.array(0.5), np.ones(2), np.full((2, 2), np.inf)).solvable


def test_a_robot_in_line_with_the_posts_is_found_twice_at_the_same_place() -> None:
    posts = np.array([[0.0, 0.0], [2.0, 0.0]])
    outside = positions_from_angle(np.array(0.0), np.array([1.0, 3.0]), posts)
    np.testing.assert_allclose(outside.position, [[3.0, 0.0], [3.0, 0.0]], atol=1e-12)
    between = positions_from_angle(np.array(np.pi), np.array([1.0, 3.0]), posts)
    np.testing.assert_allclose(between.position, [[1.5, 0.0], [1.5, 0.0]], atol=1e-12)


def test_a_stack_is_solved_as_its_parts() -> None:
    alpha, sizes = np.array([0.3, 0.0, 1.9]), np.array([[1.0, 1.2], [1.0, 1.0], [2.0, 1.0]])
    together = positions_from_angle(alpha, sizes, POSTS)
    assert together.position.shape == (3, 2, 2)
    assert together.jacobian.shape == (3, 2, 2, 3)
    assert together.solvable.tolist() == [True, False, True]
    for i in range(3):
        np.testing.assert_array_equal(together.position[i], positions_from_angle(alpha[i], sizes[i], POSTS).position)


def test_a_wrong_shape_is_the_callers_mistake() -> None:
    with pytest.raises(ValueError, match="sizes"):
        positions_from_angle(np.array(0.5), np.ones(3), POSTS)
    with pytest.raises(ValueError, match="posts"):
        positions_from_angle(np.array(0.5), np.ones(2), np.ones((3, 2)))
    with pytest.raises(ValueError, match="posts"):
        central_angle_arcs(0.5, np.ones((1, 2, 2)))
