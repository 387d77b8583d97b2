"""The normal equations of a chain: a row of blocks that know their neighbours only, and a border that all know."""

from dataclasses import dataclass

import numpy as np

from fieldloc.pose import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Information about n blocks of d numbers each and p numbers more, the border; with it goes the right-hand side.

    diagonal: (n, d, d). following: (n - 1, d, d), rows of a block, columns of the next. border: (n, d, p + 1) columns
    of the border, then the right-hand side. corner: (p + 1, p + 1) of the border and its right-hand side.
    """

    diagonal: FloatArray
    following: FloatArray
    border: FloatArray
    corner: FloatArray

    @classmethod
    def zeros(cls, n: int, d: int, p: int) -> "Blocks":
        q = p + 1
        return cls(np.zeros((n, d, d)), np.zeros((n - 1, d, d)), np.zeros((n, d, q)), np.zeros((q, q)))

    @property
    def rows(self) -> tuple[int, ...]:
        """d numbers: how many is part of the type, for which a compiler makes code of its own."""
        return (0,) * int(self.diagonal.shape[1])

    @property
    def columns(self) -> tuple[int, ...]:
        """p numbers, as `rows`."""
        return (0,) * (len(self.corner) - 1)


@dataclass(frozen=True, slots=True, eq=False)
class Marginals:
    """Parts of the inverse of the information, and the step that it leads to.

    covariances: (n, d, d). following: (n - 1, d, d) of a block (rows) with the next. border: (p, p). steps: (n, d);
    border_step: (p,).
    """

    covariances: FloatArray
    following: FloatArray
    border: FloatArray
    log_determinant: float
    """Of the information."""
    steps: FloatArray
    border_step: FloatArray


class IndefiniteError(ValueError):
    """Not the information about anything: a block has none about some direction, or less than none."""
