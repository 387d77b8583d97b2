"""Is a matrix a covariance? Asked of one as lists or of a stack: the same operations in the same order, so one answer.

Cholesky on the correlation matrix, so that no axis' unit decides what is rounding.
"""

from functools import lru_cache
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray

_ROUNDING = 1e-9  # how far a correlation matrix may be from symmetry, or an eigenvalue of it below zero
_SINGULAR = 1e-13  # no inverse worth having below this pivot of a correlation matrix


def is_covariance(rows: list[list[float]], definite: bool) -> bool:
    """Whether it is symmetric and positive semidefinite, or definite. Square, at least 2 x 2, finite."""
    return _is_plain(rows) or _has_root(tuple(map(tuple, rows)), definite)


def are_covariances(stack: FloatArray, definite: bool) -> NDArray[np.bool_]:
    """(n,) what `is_covariance` says of each of (n, size, size)."""
    with np.errstate(all="ignore"):
        return _are_plain(stack) | _have_roots(stack, definite)


def _is_plain(rows: list[list[float]]) -> bool:
    """Diagonal, 2 x 2 and positive: what nearly every landmark has, at a tenth of the price."""
    return len(rows) == 2 and rows[0][0] > 0.0 < rows[1][1] and rows[0][1] == 0.0 == rows[1][0]


def _are_plain(stack: FloatArray) -> NDArray[np.bool_]:
    if stack.shape[1] != 2:
        return np.zeros(len(stack), dtype=np.bool_)
    (a, b), (c, d) = np.moveaxis(stack, 0, -1)
    plain: NDArray[np.bool_] = (a > 0.0) & (d > 0.0) & (b == 0.0) & (c == 0.0)
    return plain


@lru_cache(maxsize=64)  # a robot mostly states one covariance all day
def _has_root(rows: tuple[tuple[float, ...], ...], definite: bool) -> bool:
    if any(rows[i][i] < 0.0 for i in range(len(rows))):
        return False
    scale = [1.0 / sqrt(row[i]) if row[i] > 0.0 else 0.0 for i, row in enumerate(rows)]
    lower: list[list[float]] = []
    for i, row in enumerate(rows):
        lower.append([])
        for j in range(i + 1):
            unit = scale[i] * scale[j]
            if abs(row[j] - rows[j][i]) * unit > _ROUNDING or (unit == 0.0 and (row[j] != 0.0 or rows[j][i] != 0.0)):
                return False
            left = row[j] * unit
            for k in range(j):  # not sum(), which rounds in its own way from Python 3.12 on
                left -= lower[i][k] * lower[j][k]
            if j < i:
                lower[i].append(left / lower[j][j])
                continue
            pivot = left if definite else left + _ROUNDING
            if pivot <= _SINGULAR:
                return False
            lower[i].append(sqrt(pivot))
    return True


def _have_roots(stack: FloatArray, definite: bool) -> NDArray[np.bool_]:
    entries = np.moveaxis(stack, 0, -1)  # entry by entry, each (n,)
    size = len(entries)
    good: NDArray[np.bool_] = np.all([entries[i, i] >= 0.0 for i in range(size)], axis=0)
    scale = [np.where(entries[i, i] > 0.0, 1.0 / np.sqrt(entries[i, i]), 0.0) for i in range(size)]
    lower: list[list[FloatArray]] = []
    for i in range(size):
        lower.append([])
        for j in range(i + 1):
            one, other, unit = entries[i, j], entries[j, i], scale[i] * scale[j]
            good &= ~(np.abs(one - other) * unit > _ROUNDING)
            good &= (unit != 0.0) | ((one == 0.0) & (other == 0.0))
            left = one * unit
            for k in range(j):
                left = left - lower[i][k] * lower[j][k]
            if j < i:
                lower[i].append(left / lower[j][j])
                continue
            pivot = left if definite else left + _ROUNDING
            good &= ~(pivot <= _SINGULAR)
            lower[i].append(np.sqrt(pivot))
    return good
