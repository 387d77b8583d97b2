"""Covariances: checks, propagation, the two-sided difference every Jacobian is held against."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from fieldloc.pose import FloatArray


def check_covariance(covariance: FloatArray, size: int, name: str = "covariance") -> FloatArray:
    """The matrix as (size, size) floats; ValueError unless finite, symmetric and positive definite."""
    matrix = np.asarray(covariance, dtype=np.float64)
    if matrix.shape != (size, size):
        raise ValueError(f"{name} has shape {matrix.shape}, needs ({size}, {size})")
    if not np.all(np.isfinite(matrix)):
        raise ValueError(f"{name} holds a value that is not finite")
    scale = np.abs(matrix).max()
    if np.abs(matrix - matrix.T).max() > 1e-9 * scale:
        raise ValueError(f"{name} is not symmetric")
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        raise ValueError(f"{name} is not positive definite") from None
    return matrix


def propagate(jacobian: FloatArray, covariance: FloatArray) -> FloatArray:
    """First-order covariance (..., m, m) of f(x) from its Jacobian (..., m, n) and the covariance (..., n, n) of x."""
    out = jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)
    return np.asarray(0.5 * (out + np.swapaxes(out, -1, -2)))


def squared_mahalanobis(residual: FloatArray, covariance: FloatArray) -> FloatArray:
    """r^T S^-1 r (...) for residuals (..., n) and covariances (..., n, n)."""
    weighted = np.linalg.solve(covariance, residual[..., None])[..., 0]
    return np.asarray(np.sum(residual * weighted, axis=-1))


def log_peaks(covariances: FloatArray) -> FloatArray:
    """Log densities at zero (...) of normal errors (..., m, m)."""
    return np.asarray(-0.5 * np.linalg.slogdet(2.0 * np.pi * covariances)[1])


@lru_cache(maxsize=64)
def chi_square_bounds(most: int, sigmas: float) -> FloatArray:
    """(most + 1,) by degrees of freedom: chi-square that noise exceeds as rarely as a normal variable exceeds so many
    sigmas (Wilson and Hilferty, 1931); infinite for none, as then rounding is all the misfit there is."""
    degrees = np.arange(1, most + 1)
    spread = 2.0 / (9.0 * degrees)
    return np.append(np.inf, degrees * (1.0 - spread + sigmas * np.sqrt(spread)) ** 3)


def cholesky_factors(matrices: FloatArray) -> FloatArray:
    """Lower triangles (k, m, m); of what rounding made indefinite as of a millionth of a millionth more."""
    try:
        return np.asarray(np.linalg.cholesky(matrices), dtype=np.float64)
    except np.linalg.LinAlgError:
        more = 1e-12 * matrices.diagonal(axis1=1, axis2=2)[..., None] * np.eye(matrices.shape[-1])
        return np.asarray(np.linalg.cholesky(matrices + more), dtype=np.float64)


def inverse_of_lower(root: FloatArray) -> FloatArray:
    """Inverses (..., m, m) of small lower triangles, as of Cholesky's factors: faster than those of any matrices."""
    out = np.zeros_like(root)
    for i in range(root.shape[-1]):
        own = 1.0 / root[..., i, i]
        out[..., i, i] = own
        if i:
            out[..., i, :i] = -own[..., None] * (root[..., i, None, :i] @ out[..., :i, :i])[..., 0, :]
    return out


def central_difference(f: Callable[[FloatArray], FloatArray], x: FloatArray, step: float = 1e-6) -> FloatArray:
    """Numerical Jacobian (m, n) of f: (n,) -> (m,) at x. Angles in f must not wrap within the step."""
    steps = step * np.eye(len(x))
    columns = [(f(x + d) - f(x - d)) / (2 * step) for d in steps]
    return np.stack(columns, axis=-1)
