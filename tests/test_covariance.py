import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.special import chdtri, ndtr

from fieldloc.covariance import (
    central_difference,
    check_covariance,
    chi_square_bounds,
    cholesky_factors,
    inverse_of_lower,
    propagate,
    squared_mahalanobis,
)
from fieldloc.pose import FloatArray

GOOD = np.array([[2.0, 0.5], [0.5, 1.0]])
vectors = arrays(np.float64, 2, elements=st.floats(-5, 5))


def test_a_covariance_passes_as_it_is() -> None:
    np.testing.assert_array_equal(check_covariance(GOOD, 2), GOOD)


@pytest.mark.parametrize(
    ("matrix", "problem"),
    [
        (np.eye(3), "shape"),
        (np.array([[1.0, np.nan], [np.nan, 1.0]]), "finite"),
        (np.array([[1.0, 0.0], [0.0, np.inf]]), "finite"),
        (np.array([[1.0, 0.3], [0.2, 1.0]]), "symmetric"),
        (np.array([[1.0, 2.0], [2.0, 1.0]]), "positive definite"),
        (np.zeros((2, 2)), "positive definite"),
        (np.diag([1.0, -1.0]), "positive definite"),
    ],
)
def test_what_is_no_covariance_is_refused_by_name(matrix: FloatArray, problem: str) -> None:
    with pytest.raises(ValueError, match=f"noise of the test.*{problem}"):
        check_covariance(matrix, 2, "noise of the test")


@given(vectors)
def test_squared_mahalanobis_counts_in_sigmas(residual: FloatArray) -> None:
    sigmas = np.array([0.5, 2.0])
    assert squared_mahalanobis(residual, np.diag(sigmas**2)) == pytest.approx(np.sum((residual / sigmas) ** 2))


def test_squared_mahalanobis_takes_stacks() -> None:
    residuals = np.random.default_rng(0).standard_normal((4, 3, 2))
    expected = [[r @ np.linalg.inv(GOOD) @ r for r in row] for row in residuals]
    np.testing.assert_allclose(squared_mahalanobis(residuals, GOOD), expected)


def test_propagation_is_the_covariance_of_a_linear_function() -> None:
    jacobian = np.array([[1.0, 2.0], [0.0, -1.0], [3.0, 1.0]])
    samples = np.random.default_rng(1).multivariate_normal(np.zeros(2), GOOD, 50_000)
    out = propagate(jacobian, GOOD)
    # a sampled covariance is off by about sqrt(2 / 50000) = 0.6 %; five of these
    np.testing.assert_allclose(out, np.cov((samples @ jacobian.T).T), atol=0.03 * np.abs(out).max())
    np.testing.assert_array_equal(out, out.T)
    stacked = propagate(np.stack([jacobian, 2 * jacobian]), np.stack([GOOD, GOOD]))
    np.testing.assert_allclose(stacked[1], 4 * out)


@given(vectors)
def test_central_differences_are_exact_for_a_quadratic(x: FloatArray) -> None:
    jacobian = central_difference(lambda v: np.array([v[0] * v[1], v[0] ** 2, 3.0 * v[1]]), x, 1e-3)
    np.testing.assert_allclose(jacobian, [[x[1], x[0]], [2 * x[0], 0.0], [0.0, 3.0]], atol=1e-9)


@pytest.mark.parametrize("size", [1, 2, 3, 7])
def test_a_triangle_s_inverse_is_that_of_the_textbook(size: int) -> None:
    half = np.random.default_rng(size).normal(size=(size, size))
    matrix = half @ half.T + 0.1 * np.eye(size)
    root = cholesky_factors(np.stack([matrix, np.eye(size)]))
    np.testing.assert_allclose(inverse_of_lower(root) @ root, np.tile(np.eye(size), (2, 1, 1)), atol=1e-12)


def test_what_rounding_made_indefinite_has_factors_all_the_same() -> None:
    line = np.array([1.0, 1e3, 1.0])
    barely = np.outer(line, line) - 1e-13 * np.eye(3)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(barely)
    root = cholesky_factors(barely[None])
    np.testing.assert_allclose(root @ root.swapaxes(1, 2), barely[None], rtol=1e-11, atol=1e-11)


def test_a_chi_square_is_bounded_as_a_normal_variable_is() -> None:
    bounds = chi_square_bounds(30, 3.0)
    degrees = np.arange(1, 31)
    # a cube root of chi-square is nearly normal: at three sigmas within 3 %, from ten degrees on within half a percent
    np.testing.assert_allclose(bounds[1:], chdtri(degrees, ndtr(-3.0)), rtol=0.03)
    np.testing.assert_allclose(bounds[10:], chdtri(degrees[9:], ndtr(-3.0)), rtol=0.0055)
    assert bounds[0] == np.inf
