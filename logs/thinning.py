"""Fewer points for the same picture: long logs are drawn with what a screen can show."""

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from logs.trajectory import IntArray


def extremes(values: FloatArray, bins: int) -> NDArray[np.intp]:
    """Rising indices of the smallest and the largest of each of `bins` equal stretches, and what is left over.

    values: (n,) finite. All indices where that would not make them fewer. Every spike stays, unlike with every n-th.
    """
    size = len(values) // bins
    if size <= 2:
        return np.arange(len(values))
    stretches = values[: size * bins].reshape(bins, size)
    starts = size * np.arange(bins)
    rest = np.arange(size * bins, len(values))
    return np.unique(np.concatenate([starts + stretches.argmin(axis=1), starts + stretches.argmax(axis=1), rest]))


def path(positions: FloatArray, cell_m: float) -> NDArray[np.intp]:
    """Rising indices of the positions (n, 2) at which the path enters another cell of a grid, and of the last."""
    if len(positions) == 0:
        return np.arange(0)
    cells = np.floor(positions / cell_m)
    entered = np.any(np.diff(cells, axis=0) != 0, axis=1)
    return np.flatnonzero(np.concatenate([[True], entered]) | (np.arange(len(positions)) == len(positions) - 1))


def breaks(stamps_ns: IntArray) -> NDArray[np.intp]:
    """Indices before which a drawn line is interrupted: no pose for two seconds and for ten usual steps."""
    steps = np.diff(stamps_ns)
    if len(steps) == 0:
        return np.arange(0)
    return np.flatnonzero((steps > 2_000_000_000) & (steps > 10 * np.median(steps))) + 1
