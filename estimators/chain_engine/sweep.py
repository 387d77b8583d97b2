"""A chain's normal equations solved from one end to the other and back, in numba: time and memory as its length.

Block Cholesky. Forwards, each block is eliminated into the next and into the border: with its information L L^T, the
rows that it leaves behind are Y = L^-1 [following, border, right-hand side], and Y^T Y is taken from what comes after.
Backwards, the block is what its row says, given the next and the border; its covariance likewise (the recursion of
Rauch, Tung and Striebel in information form).
"""

import numpy as np

from estimators.chain_engine.blocks import Blocks, IndefiniteError, Marginals
from estimators.chain_engine.jit import compiled
from fieldloc.pose import FloatArray


def solve(blocks: Blocks, damping: float) -> tuple[FloatArray, FloatArray]:
    """Blocks (n, d) and border (p,). damping: added to the diagonal of the blocks."""
    lower, links, rows, corner = _eliminated(blocks, damping)
    border = np.asarray(np.linalg.solve(corner[:-1, :-1], corner[:-1, -1]), dtype=np.float64)
    return _substitute(lower, links, rows, border, blocks.rows, blocks.columns), border


def marginals(blocks: Blocks) -> Marginals:
    lower, links, rows, corner = _eliminated(blocks, 0.0)
    border = np.asarray(np.linalg.inv(corner[:-1, :-1]), dtype=np.float64)
    step = border @ corner[:-1, -1]
    log_determinant = np.linalg.slogdet(corner[:-1, :-1])[1] - 2.0 * np.sum(
        np.log(np.diagonal(lower, axis1=1, axis2=2))
    )
    return Marginals(
        *_covariances(lower, links, rows, border, blocks.rows, blocks.columns),
        border,
        float(log_determinant),
        _substitute(lower, links, rows, step, blocks.rows, blocks.columns),
        step,
    )


def _eliminated(blocks: Blocks, damping: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    *parts, good = _eliminate(
        blocks.diagonal, blocks.following, blocks.border, blocks.corner, damping, blocks.rows, blocks.columns
    )
    if not good:
        raise IndefiniteError("nothing is known of a pose in some direction")
    lower, links, rows, corner = parts
    return lower, links, rows, corner


@compiled
def _eliminate(
    diagonal: FloatArray,
    following: FloatArray,
    border: FloatArray,
    corner: FloatArray,
    damping: float,
    sizes: tuple[int, ...],
    columns: tuple[int, ...],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, bool]:
    """L (n, d, d), the inverse in place of its diagonal; Y's columns of the next block (n, d, d) and of the border and
    the right-hand side (n, d, p + 1); what is left of the corner; whether all went well."""
    n, d, q = len(diagonal), len(sizes), len(columns) + 1
    lower, links, rows, left = np.empty((n, d, d)), np.zeros((n, d, d)), np.empty((n, d, q)), corner.copy()
    good = True
    for k in range(n):
        chol, link, row = lower[k], links[k], rows[k]
        for i in range(d):
            for j in range(i + 1):
                chol[i, j] = diagonal[k, i, j]
            chol[i, i] += damping
            for j in range(q):
                row[i, j] = border[k, i, j]
        if k > 0:
            before, row_before = links[k - 1], rows[k - 1]
            for m in range(d):
                for i in range(d):
                    factor = before[m, i]
                    for j in range(i + 1):
                        chol[i, j] -= factor * before[m, j]
                    for j in range(q):
                        row[i, j] -= factor * row_before[m, j]
        for j in range(d):
            for m in range(j):
                for i in range(j, d):
                    chol[i, j] -= chol[i, m] * chol[j, m]
            good = good and chol[j, j] > 0.0
            chol[j, j] = 1.0 / np.sqrt(chol[j, j]) if good else 1.0
            for i in range(j + 1, d):
                chol[i, j] *= chol[j, j]
        if k < n - 1:
            for i in range(d):
                for j in range(d):
                    link[i, j] = following[k, i, j]
        for i in range(d):
            for m in range(i):
                factor = chol[i, m]
                for j in range(d):
                    link[i, j] -= factor * link[m, j]
                for j in range(q):
                    row[i, j] -= factor * row[m, j]
            for j in range(d):
                link[i, j] *= chol[i, i]
            for j in range(q):
                row[i, j] *= chol[i, i]
        # above the diagonal, in few pieces of a fixed size
        for i in range(q // 2):
            for m in range(d):
                factor = row[m, i]
                for j in range(q):
                    left[i, j] -= factor * row[m, j]
        for i in range(q // 2, q):
            for m in range(d):
                factor = row[m, i]
                for j in range(q // 2, q):
                    left[i, j] -= factor * row[m, j]
    for i in range(q):
        for j in range(i):
            left[i, j] = left[j, i]
    return lower, links, rows, left, good


@compiled
def _substitute(
    lower: FloatArray,
    links: FloatArray,
    rows: FloatArray,
    border: FloatArray,
    sizes: tuple[int, ...],
    columns: tuple[int, ...],
) -> FloatArray:
    n, d, p = len(lower), len(sizes), len(columns)
    out = np.empty((n, d))
    for k in range(n - 1, -1, -1):
        for i in range(d - 1, -1, -1):
            value = rows[k, i, p]
            for j in range(p):
                value -= rows[k, i, j] * border[j]
            if k < n - 1:
                for j in range(d):
                    value -= links[k, i, j] * out[k + 1, j]
            for j in range(i + 1, d):
                value -= lower[k, j, i] * out[k, j]
            out[k, i] = value * lower[k, i, i]
    return out


@compiled
def _covariances(
    lower: FloatArray,
    links: FloatArray,
    rows: FloatArray,
    border: FloatArray,
    sizes: tuple[int, ...],
    columns: tuple[int, ...],
) -> tuple[FloatArray, FloatArray]:
    """Of each block, and with the next. border: (p, p) its covariance."""
    n, d, p = len(lower), len(sizes), len(columns)
    out, following = np.zeros((n, d, d)), np.zeros((max(n - 1, 0), d, d))
    alone = np.zeros((d, d))  # covariance of the block that came last, were the border known
    by_next, by_border = np.empty((d, d)), np.zeros((d, p))  # change of the block with the next and with the border
    last, spread = np.zeros((d, p)), np.empty((d, p))
    carried, inverse = np.empty((d, d)), np.empty((d, d))
    for k in range(n - 1, -1, -1):
        for i in range(d - 1, -1, -1):  # L^T x = ... for unit vectors, neighbours and border
            scale = lower[k, i, i]
            for j in range(d):
                inverse[i, j] = 0.0
            # rows of L^-T: upper triangular
            inverse[i, i] = scale
            for j in range(i + 1, d):
                value = 0.0
                for m in range(i + 1, j + 1):
                    value -= lower[k, m, i] * inverse[m, j]
                inverse[i, j] = value * scale
        for i in range(d):
            for j in range(d):
                value = 0.0
                for m in range(i, d):
                    value -= inverse[i, m] * links[k, m, j]
                by_next[i, j] = value
            for j in range(p):
                value = 0.0
                for m in range(i, d):
                    value -= inverse[i, m] * rows[k, m, j]
                by_border[i, j] = value
        if k < n - 1:
            for i in range(d):
                for j in range(p):
                    value = by_border[i, j]
                    for m in range(d):
                        value += by_next[i, m] * last[m, j]
                    by_border[i, j] = value
                for j in range(d):
                    value = 0.0
                    for m in range(d):
                        value += by_next[i, m] * alone[m, j]
                    carried[i, j] = value
        for i in range(d):
            for j in range(p):
                value = 0.0
                for m in range(p):
                    value += by_border[i, m] * border[m, j]
                spread[i, j] = value
        if k < n - 1:
            for i in range(d):
                for j in range(d):
                    value = carried[i, j]
                    for m in range(p):
                        value += spread[i, m] * last[j, m]
                    following[k, i, j] = value
        for i in range(d):
            for j in range(i, d):
                value = 0.0
                for m in range(j, d):
                    value += inverse[i, m] * inverse[j, m]
                if k < n - 1:
                    for m in range(d):
                        value += carried[i, m] * by_next[j, m]
                alone[i, j] = alone[j, i] = value
                for m in range(p):
                    value += spread[i, m] * by_border[j, m]
                out[k, i, j] = out[k, j, i] = value
        for i in range(d):
            for j in range(p):
                last[i, j] = by_border[i, j]
    return out, following
