import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, logm

from fieldloc import pose as se2
from fieldloc.covariance import central_difference
from fieldloc.pose import FloatArray

# headings where something can go wrong: zero, the series' border, half turns from either side
TRICKY = [0.0, 1e-9, 9.9e-5, 1.01e-4, -1e-3, np.pi / 2, np.pi - 1e-7, np.pi, -np.pi, -np.pi + 1e-7, 3 * np.pi]

headings = st.sampled_from(TRICKY) | st.floats(-7.0, 7.0)
poses = st.tuples(st.floats(-9, 9), st.floats(-9, 9), headings).map(np.array)
below_half_turn = st.sampled_from([x for x in TRICKY if abs(x) < np.pi - 1e-8]) | st.floats(-3.14, 3.14)
tangents = st.tuples(st.floats(-3, 3), st.floats(-3, 3), below_half_turn).map(np.array)


def matrix(pose: FloatArray) -> FloatArray:
    """Homogeneous (3, 3)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]])


def hat(tangent: FloatArray) -> FloatArray:
    x, y, angle = tangent
    return np.array([[0.0, -angle, x], [angle, 0.0, y], [0.0, 0.0, 0.0]])


@given(st.floats(-1e3, 1e3))
def test_wrap_keeps_the_direction_and_lands_in_one_turn(angle: float) -> None:
    wrapped = float(se2.wrap(angle))
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)


@settings(deadline=None)
@given(poses, poses)
def test_poses_compose_and_invert_as_their_matrices_do(one: FloatArray, other: FloatArray) -> None:
    np.testing.assert_allclose(matrix(se2.compose(one, other)), matrix(one) @ matrix(other), atol=1e-12)
    np.testing.assert_allclose(matrix(se2.inverse(one)), np.linalg.inv(matrix(one)), atol=1e-12)
    np.testing.assert_allclose(matrix(se2.between(one, other)), np.linalg.solve(matrix(one), matrix(other)), atol=1e-12)
    np.testing.assert_allclose(se2.apply(one, other[:2]), (matrix(one) @ [*other[:2], 1.0])[:2], atol=1e-12)


@settings(deadline=None)
@given(tangents)
def test_exp_and_log_are_those_of_matrices(tangent: FloatArray) -> None:
    pose = se2.exp(tangent)
    np.testing.assert_allclose(matrix(pose), expm(hat(tangent)), atol=1e-11)
    if abs(tangent[2]) < 3.1:  # scipy's logarithm loses digits towards the half turn
        np.testing.assert_allclose(hat(se2.log(pose)), np.real(logm(matrix(pose))), atol=1e-9)
    np.testing.assert_allclose(se2.log(pose), tangent, atol=1e-9)


@settings(deadline=None)
@given(poses, tangents)
def test_local_undoes_retract(pose: FloatArray, tangent: FloatArray) -> None:
    np.testing.assert_allclose(se2.local(pose, se2.retract(pose, tangent)), tangent, atol=1e-8)


@settings(deadline=None)
@given(poses, tangents)
def test_the_adjoint_moves_a_tangent_to_the_other_side(pose: FloatArray, tangent: FloatArray) -> None:
    right = se2.compose(pose, se2.exp(tangent))
    left = se2.compose(se2.exp(se2.adjoint(pose) @ tangent), pose)
    np.testing.assert_allclose(matrix(left), matrix(right), atol=1e-10)


@settings(deadline=None)
@given(tangents)
def test_the_right_jacobian_is_the_derivative_of_exp(tangent: FloatArray) -> None:
    numeric = central_difference(lambda d: se2.local(se2.exp(tangent), se2.exp(tangent + d)), np.zeros(3))
    np.testing.assert_allclose(se2.right_jacobian(tangent), numeric, atol=1e-8)
    if abs(tangent[2]) < 3.1:  # the logarithm's derivative is not smooth across the half turn
        back = central_difference(lambda d: se2.log(se2.retract(se2.exp(tangent), d)), np.zeros(3))
        np.testing.assert_allclose(se2.right_jacobian_inverse(tangent), back, atol=1e-6)


@settings(deadline=None)
@given(poses, tangents)
def test_rotate_covariance_takes_robot_axes_to_field_axes_and_back(pose: FloatArray, tangent: FloatArray) -> None:
    root = np.array([[0.1, 0.0, 0.0], [0.05, 0.2, 0.0], tangent / 10])
    robot = root @ root.T + 1e-6 * np.eye(3)

    def step(d: FloatArray) -> FloatArray:
        x, y, heading = se2.retract(pose, d) - pose
        return np.array([x, y, se2.wrap(heading)])

    to_field = central_difference(step, np.zeros(3))
    np.testing.assert_allclose(se2.rotate_covariance(robot, pose[2]), to_field @ robot @ to_field.T, atol=1e-8)
    there = se2.rotate_covariance(robot, pose[2])
    np.testing.assert_allclose(se2.rotate_covariance(there, -pose[2]), robot, atol=1e-12)


def test_stacks_give_what_one_by_one_gives() -> None:
    random = np.random.default_rng(0)
    stack, other = random.uniform(-3, 3, (5, 2, 3)), random.uniform(-3, 3, (5, 2, 3))
    for f in (se2.compose, se2.between, se2.retract, se2.local):
        single = [[f(a, b) for a, b in zip(*row, strict=True)] for row in zip(stack, other, strict=True)]
        np.testing.assert_allclose(f(stack, other), single, atol=1e-14)
    for g in (se2.inverse, se2.exp, se2.log, se2.adjoint, se2.right_jacobian, se2.right_jacobian_inverse):
        np.testing.assert_allclose(g(stack), [[g(a) for a in row] for row in stack], atol=1e-14)
    turned = se2.rotate_covariance(np.broadcast_to(np.diag([1.0, 2.0, 3.0]), (5, 2, 3, 3)), stack[..., 2])
    np.testing.assert_allclose(turned[3, 1], se2.rotate_covariance(np.diag([1.0, 2.0, 3.0]), stack[3, 1, 2]))
