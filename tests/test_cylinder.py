import numpy as np
import pytest
from goal_views import GOAL, RADIUS_M
from hypothesis import given, settings
from hypothesis import strategies as st

from fieldloc.covariance import central_difference
from fieldloc.fixes.cylinder import (
    axis_from_edges,
    edge_bearings,
    edge_bearings_jacobian,
    fix_two_posts_from_edges,
    paper_size_px,
    pinhole_edges_px,
    pinhole_width_px,
    range_bearing_from_edges,
    two_post_inputs_from_edges,
)
from fieldloc.fixes.two_posts import fix_two_posts
from fieldloc.pose import FloatArray, wrap

FOCAL_PX = 600.0

ranges = st.floats(0.06, 20.0)
bearings = st.floats(-3.1, 3.1)
moderate = settings(deadline=None, max_examples=60)


def edges_seen(pose: FloatArray, radius_m: float = RADIUS_M, posts: FloatArray = GOAL) -> FloatArray:
    to_posts = posts - pose[:2]
    bearing = wrap(np.arctan2(to_posts[:, 1], to_posts[:, 0]) - pose[2])
    distance = np.hypot(to_posts[:, 0], to_posts[:, 1])
    edges, mask = edge_bearings(np.stack([distance, bearing], axis=-1), radius_m)
    assert np.all(mask)
    return edges


@moderate
@given(distance=ranges, bearing=bearings)
def test_the_edges_are_the_tangents_of_the_cylinder(distance: float, bearing: float) -> None:
    edges, mask = edge_bearings(np.array([distance, bearing]), RADIUS_M)
    assert mask
    axis = distance * np.array([np.cos(bearing), np.sin(bearing)])
    for edge in edges:
        assert abs(np.cos(edge) * axis[1] - np.sin(edge) * axis[0]) == pytest.approx(RADIUS_M)
    assert wrap(edges[0] - edges[1]) > 0


@moderate
@given(distance=ranges, bearing=bearings)
def test_range_and_bearing_come_back_from_the_edges(distance: float, bearing: float) -> None:
    values = np.array([distance, bearing])
    edges, _ = edge_bearings(values, RADIUS_M)
    back, jacobian, mask = range_bearing_from_edges(edges, RADIUS_M)
    assert mask
    np.testing.assert_allclose(back, values, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(jacobian @ edge_bearings_jacobian(values, RADIUS_M), np.eye(2), atol=1e-6)


@pytest.mark.parametrize("values", [[0.0501, 0.2], [0.3, -1.0], [2.0, 3.1], [9.0, 0.0]])
def test_the_jacobians_are_the_central_differences(values: list[float]) -> None:
    at = np.array(values)
    step = 1e-4 * (at[0] - RADIUS_M)
    numeric = central_difference(lambda x: edge_bearings(x, RADIUS_M)[0], at, step)
    np.testing.assert_allclose(edge_bearings_jacobian(at, RADIUS_M), numeric, rtol=1e-6, atol=1e-9)
    edges, _ = edge_bearings(at, RADIUS_M)
    numeric = central_difference(
        lambda x: range_bearing_from_edges(x, RADIUS_M)[0], edges, 1e-6 * (edges[0] - edges[1])
    )
    np.testing.assert_allclose(range_bearing_from_edges(edges, RADIUS_M)[1], numeric, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("values", [[0.3, 0.6], [1.0, 0.0], [2.0, -0.9], [9.0, 0.4]])
def test_the_pinhole_width_is_what_the_projected_surface_spans(values: list[float]) -> None:
    distance, bearing = values
    around = np.linspace(0, 2 * np.pi, 200_001)
    forward = distance * np.cos(bearing) + RADIUS_M * np.cos(around)
    right = -distance * np.sin(bearing) - RADIUS_M * np.sin(around)
    columns = FOCAL_PX * right / forward
    width, jacobian, mask = pinhole_width_px(np.array(values), RADIUS_M, FOCAL_PX)
    assert mask
    assert width == pytest.approx(np.ptp(columns), rel=1e-8)
    np.testing.assert_allclose(
        pinhole_edges_px(np.array(values), RADIUS_M, FOCAL_PX)[0], [columns.min(), columns.max()], rtol=1e-8
    )
    half = np.arcsin(RADIUS_M / distance)
    closed_form = FOCAL_PX * np.sin(2 * half) / (np.cos(bearing) ** 2 - np.sin(half) ** 2)
    assert width == pytest.approx(closed_form, rel=1e-12)
    numeric = central_difference(lambda x: pinhole_width_px(x, RADIUS_M, FOCAL_PX)[0][None], np.array(values), 1e-6)
    np.testing.assert_allclose(jacobian, numeric[0], rtol=1e-6)


def test_the_papers_size_is_the_width_of_a_thin_post_on_the_axis_only() -> None:
    def excess(distance: float, bearing_deg: float) -> float:
        width, _, _ = pinhole_width_px(np.array([distance, np.radians(bearing_deg)]), RADIUS_M, FOCAL_PX)
        return float(width / paper_size_px(np.array(distance), 2 * RADIUS_M, FOCAL_PX) - 1)

    assert excess(5.0, 0.0) == pytest.approx(0.0, abs=1e-4)
    assert excess(10 * RADIUS_M, 0.0) == pytest.approx(0.005, abs=1e-4)
    assert excess(5.0, 30.0) == pytest.approx(1 / 3, abs=1e-3)


def test_the_papers_size_off_the_axis_moves_the_fix_and_the_exact_one_does_not() -> None:
    pose = np.array([3.0, 0.8, 0.25])  # post 1 near the axis, post 2 sixty degrees off
    edges = edges_seen(pose)
    noise = np.eye(4) * 1e-10
    (exact,) = fix_two_posts_from_edges(edges, noise, GOAL)
    np.testing.assert_allclose(exact.pose, pose, atol=1e-9)
    widths = FOCAL_PX * (np.tan(edges[:, 0]) - np.tan(edges[:, 1]))
    (off,) = fix_two_posts(edges.mean(axis=1), widths, noise, GOAL)
    assert np.hypot(*(off.pose - pose)[:2]) > 0.3


def test_edges_give_the_fix_without_a_diameter() -> None:
    pose = np.array([2.0, -0.8, 0.3])
    for radius in (0.05, 0.3):
        (fix,) = fix_two_posts_from_edges(edges_seen(pose, radius), np.eye(4) * 1e-10, GOAL)
        np.testing.assert_allclose(fix.pose, pose, atol=1e-9)


def test_the_covariance_of_the_edges_is_carried_over_with_its_correlations() -> None:
    edges = edges_seen(np.array([3.9, 1.0, 0.3]), 0.2)
    rng = np.random.default_rng(5)
    root = rng.normal(size=(4, 4)) * 1e-3
    inputs, covariance, mask = two_post_inputs_from_edges(edges, root @ root.T)
    assert mask
    jacobian = central_difference(
        lambda x: two_post_inputs_from_edges(x.reshape(2, 2), np.eye(4))[0], edges.ravel(), 1e-6
    )
    np.testing.assert_allclose(covariance, jacobian @ root @ root.T @ jacobian.T, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(inputs[2:], 0.2 / np.hypot(*(GOAL - [3.9, 1.0]).T))


def test_a_pan_error_shared_by_all_edges_turns_the_heading_and_nothing_else() -> None:
    edges = edges_seen(np.array([2.0, -0.8, 0.3]))
    own = np.eye(4) * 1e-12
    (fix,) = fix_two_posts_from_edges(edges, own + 0.01**2 * np.ones((4, 4)), GOAL)
    (without,) = fix_two_posts_from_edges(edges, own, GOAL)
    np.testing.assert_allclose(fix.covariance[:2, :2], without.covariance[:2, :2], rtol=1e-6)
    assert fix.covariance[2, 2] == pytest.approx(without.covariance[2, 2] + 0.01**2)


@pytest.mark.parametrize("values", [[0.05, 0.0], [0.01, 0.0], [-1.0, 0.0], [np.nan, 0.0], [1.0, np.inf], [np.inf, 0.0]])
def test_an_observer_who_is_not_outside_sees_no_edges(values: list[float]) -> None:
    edges, mask = edge_bearings(np.array(values), RADIUS_M)
    assert not mask
    assert not np.any(edges)
    assert not np.any(edge_bearings_jacobian(np.array(values), RADIUS_M))


@pytest.mark.parametrize("bearing", [np.pi / 2, 2.0, np.pi, -np.pi / 2 + 0.01])
def test_a_post_beside_or_behind_the_camera_has_no_width(bearing: float) -> None:
    width, jacobian, mask = pinhole_width_px(np.array([1.0, bearing]), RADIUS_M, FOCAL_PX)
    assert not mask
    assert width == 0
    assert not np.any(jacobian)


@pytest.mark.parametrize("edges", [[0.1, 0.1], [0.1, 0.2], [np.nan, 0.1], [0.2, -np.inf]])
def test_edges_in_the_wrong_order_are_no_cylinder(edges: list[float]) -> None:
    axis, mask = axis_from_edges(np.array(edges))
    assert not mask
    assert not np.any(axis)
    assert fix_two_posts_from_edges(np.array([edges, [0.5, 0.4]]), np.eye(4) * 1e-8, GOAL) == ()
    values, jacobian, mask = range_bearing_from_edges(np.array(edges), RADIUS_M)
    assert not mask
    assert not np.any(values)
    assert not np.any(jacobian)


def test_a_post_straight_behind_is_seen_across_the_branch_cut() -> None:
    edges, _ = edge_bearings(np.array([1.0, np.pi]), RADIUS_M)
    axis, mask = axis_from_edges(edges)
    assert mask
    assert np.abs(axis[0]) == pytest.approx(np.pi)
    assert axis[1] == pytest.approx(np.arcsin(RADIUS_M))


def test_a_stack_is_solved_as_its_parts() -> None:
    poses = np.array([[2.0, -0.8, 0.3], [1.0, 0.4, -0.2]])
    edges = np.stack([edges_seen(pose) for pose in poses])
    inputs, covariance, mask = two_post_inputs_from_edges(edges, np.eye(4))
    assert inputs.shape == (2, 4)
    assert covariance.shape == (2, 4, 4)
    assert mask.tolist() == [True, True]
    np.testing.assert_array_equal(inputs[1], two_post_inputs_from_edges(edges[1], np.eye(4))[0])


def test_a_callers_mistake_is_a_value_error() -> None:
    with pytest.raises(ValueError, match="edges_rad"):
        fix_two_posts_from_edges(np.zeros((2, 3)), np.eye(4), GOAL)
    with pytest.raises(ValueError, match="semidefinite"):
        fix_two_posts_from_edges(np.array([[0.2, 0.1], [0.0, -0.1]]), -np.eye(4), GOAL)
    with pytest.raises(ValueError, match="range_bearing"):
        edge_bearings(np.zeros(3), RADIUS_M)
