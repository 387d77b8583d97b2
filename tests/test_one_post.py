import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fieldloc.covariance import central_difference
from fieldloc.fixes.one_post import RangeBearingArc, arc_of_one_post
from fieldloc.fixes.sizes import HalfWidths, Ranges
from fieldloc.pose import FloatArray, wrap

POST = np.array([4.5, 1.3])
WIDTHS = HalfWidths(0.05)
NOISE = np.array([[1e-6, 2e-8], [2e-8, 1e-8]])  # (bearing, half-width)

angles = st.floats(-np.pi, np.pi)
moderate = settings(deadline=None, max_examples=50)


def arc(distance: float, bearing: float, noise: FloatArray = NOISE) -> RangeBearingArc:
    (found,) = arc_of_one_post(bearing, float(np.arcsin(0.05 / distance)), noise, POST, WIDTHS)
    return found


@moderate
@given(distance=st.floats(0.2, 12.0), bearing=angles, direction=angles)
def test_every_pose_of_the_arc_sees_the_post_as_it_was_seen(distance: float, bearing: float, direction: float) -> None:
    pose = arc(distance, bearing, NOISE * 1e-6).pose(np.array(direction))
    to_post = POST - pose[:2]
    assert np.hypot(*to_post) == pytest.approx(distance)
    assert wrap(np.arctan2(to_post[1], to_post[0]) - pose[2] - bearing) == pytest.approx(0.0, abs=1e-9)
    assert np.cos(np.arctan2(-to_post[1], -to_post[0]) - direction) == pytest.approx(1.0)


def test_directions_come_as_a_stack() -> None:
    found = arc(3.0, 0.4)
    directions = np.linspace(-3, 3, 7)
    assert found.pose(directions).shape == (7, 3)
    assert found.covariance_at(directions, 0.1).shape == (7, 3, 3)
    np.testing.assert_array_equal(found.pose(directions)[4], found.pose(directions[4]))


@pytest.mark.parametrize("sigma_direction_rad", [0.0, 0.2])
def test_the_covariance_is_the_one_propagated_by_central_differences(sigma_direction_rad: float) -> None:
    survey = np.diag([1e-4, 9e-4])
    size = float(np.arcsin(0.05 / 2.0))
    (found,) = arc_of_one_post(0.4, size, NOISE * 1e-2, POST, WIDTHS, survey)

    def pose(x: FloatArray) -> FloatArray:
        at = RangeBearingArc(x[3:], float(WIDTHS.range_of(x[1])), float(x[0]), np.eye(2), np.eye(2))
        return at.pose(x[2])

    jacobian = central_difference(pose, np.array([0.4, size, 1.1, *POST]))
    noise = np.zeros((5, 5))
    noise[:2, :2], noise[2, 2], noise[3:, 3:] = NOISE * 1e-2, sigma_direction_rad**2, survey
    expected = jacobian @ noise @ jacobian.T
    actual = found.covariance_at(np.array(1.1), sigma_direction_rad)
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-3 * np.abs(expected[:2, :2]).max())


def test_the_range_of_a_post_of_few_pixels_is_not_overconfident() -> None:
    """Four pixels wide, half a pixel of noise on each edge: a sixth of the distance."""
    rng = np.random.default_rng(8)
    focal, distance = 300.0, 7.5
    sigma = 0.5 / focal / np.sqrt(2)
    noise = np.eye(2) * sigma**2
    squared = []
    for size in np.arcsin(0.05 / distance) + sigma * rng.normal(size=2_000):
        # the few that could as well have no width at all give no arc
        for found in arc_of_one_post(0.0, float(size), noise, POST, WIDTHS):
            squared.append(((found.range_m - distance) / found.sigma_range_m) ** 2)
    assert len(squared) > 1_970
    assert np.mean(squared) < 1.3


def test_a_good_size_gives_the_first_order_range() -> None:
    found = arc(2.0, 0.1, NOISE * 1e-4)
    slope = 1 / WIDTHS.of_range(np.array(2.0))[1]
    assert found.sigma_range_m == pytest.approx(abs(slope) * np.sqrt(NOISE[1, 1]) * 1e-2, rel=1e-5)
    assert found.covariance[0, 1] == pytest.approx(slope * NOISE[0, 1] * 1e-4, rel=1e-5)
    assert np.linalg.eigvalsh(found.covariance)[0] > 0


@pytest.mark.parametrize("size", [0.0, -0.01, 2.0, 2e-4, np.nan])
def test_a_size_without_a_distance_gives_no_arc(size: float) -> None:
    assert arc_of_one_post(0.1, size, NOISE, POST, WIDTHS) == ()


def test_nan_gives_no_arc() -> None:
    assert arc_of_one_post(np.nan, 0.01, NOISE, POST, WIDTHS) == ()
    assert arc_of_one_post(0.1, 2.0, NOISE, np.array([np.nan, 0.0]), Ranges()) == ()


def test_a_callers_mistake_is_a_value_error() -> None:
    with pytest.raises(ValueError, match="post"):
        arc_of_one_post(0.1, 2.0, NOISE, np.zeros(3), Ranges())
    with pytest.raises(ValueError, match="semidefinite"):
        arc_of_one_post(0.1, 2.0, -NOISE, POST, Ranges())
    with pytest.raises(ValueError, match="post_covariance"):
        arc_of_one_post(0.1, 2.0, NOISE, POST, Ranges(), np.eye(3))
