"""The normal equations of a chain: a row of blocks that know their neighbours only, and a border that all know."""

from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True, eq=False)
class Marginals:
    """Parts of the inverse of the information.

    covariances: (n, d, d). following: (n - 1, d, d) of a block (rows) with the next. border: (p, p).
    """

    covariances: FloatArray
    following: FloatArray
    border: FloatArray
    log_determinant: float
    """Of the information."""


class IndefiniteError(ValueError):
    """Not the information about anything: a block has none about some direction, or less than none."""
