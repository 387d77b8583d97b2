"""Checks of what callers hand to the solvers: a wrong shape or an impossible covariance is their mistake."""

import numpy as np

from fieldloc.pose import FloatArray

_RELATIVE_ROUNDING = 1e-9  # of the largest element: as much as rounding may do to symmetry and to a zero eigenvalue


def trailing(values: FloatArray, shape: tuple[int, ...], name: str) -> FloatArray:
    """The values as floats; ValueError unless their last axes have the shape."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape[-len(shape) :] != shape:
        wanted = ", ".join(str(n) for n in shape)
        raise ValueError(f"{name} has shape {array.shape}, needs (..., {wanted})")
    return array


def exactly(values: FloatArray, shape: tuple[int, ...], name: str) -> FloatArray:
    """The values as floats; ValueError unless they have the shape."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, needs {shape}")
    return array


def semidefinite(covariance: FloatArray, size: int, name: str = "covariance") -> FloatArray:
    """Covariances (..., size, size); ValueError unless finite, symmetric and without a negative eigenvalue.

    Zero variances are allowed: something may be taken as exact, or known only through something else.
    """
    matrix = trailing(covariance, (size, size), name)
    if not np.all(np.isfinite(matrix)):
        raise ValueError(f"{name} holds a value that is not finite")
    # in units of each standard deviation, so that radians and pixels or metres are held to the same rule
    diagonal = np.diagonal(matrix, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    whitened = matrix / (scale[..., :, None] * scale[..., None, :])
    if np.any(np.abs(whitened - np.swapaxes(whitened, -1, -2)) > _RELATIVE_ROUNDING):
        raise ValueError(f"{name} is not symmetric")
    whitened = 0.5 * (whitened + np.swapaxes(whitened, -1, -2))
    exact_but_correlated = np.any(matrix != 0, axis=-1) & (diagonal <= 0)
    if np.any(exact_but_correlated) or np.any(np.linalg.eigvalsh(whitened) < -_RELATIVE_ROUNDING * size):
        raise ValueError(f"{name} is not positive semidefinite")
    return np.asarray(0.5 * (matrix + np.swapaxes(matrix, -1, -2)))


def posts_covariance_of(covariance: FloatArray | None, number: int) -> FloatArray:
    """Covariances (..., number, 2, 2) of positions as one block-diagonal (..., 2 number, 2 number); None: exact."""
    if covariance is None:
        return np.zeros((2 * number, 2 * number))
    blocks = semidefinite(trailing(covariance, (number, 2, 2), "posts_covariance"), 2, "posts_covariance")
    out = np.zeros((*blocks.shape[:-3], 2 * number, 2 * number))
    for i in range(number):
        out[..., 2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = blocks[..., i, :, :]
    return out
