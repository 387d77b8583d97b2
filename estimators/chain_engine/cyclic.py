"""A chain's normal equations without numba: block cyclic reduction, which numpy does for half of the chain at a time.

Every second block is eliminated into its two neighbours and the border; what is left is a chain of half the length. A
few dozen blocks are solved as one matrix. On the way back each eliminated block follows from its neighbours, and so
does its covariance, as the one between these two is known there (Takahashi's recursion). In here the
chain's axis is the last one: so numpy works along it.
"""

from typing import NamedTuple

import numpy as np

from estimators.chain_engine.blocks import Blocks, IndefiniteError, Marginals
from fieldloc.pose import FloatArray

_FEW = 24


class _Level(NamedTuple):
    """Of the eliminated blocks, each for m of them: the inverse of their information (d, d, m); by how much they follow
    the block before (d, d, m), after (d, d, m; zeros for none), border and right-hand side (d, p + 1, m)."""

    inverse: FloatArray
    by_before: FloatArray
    by_after: FloatArray
    by_border: FloatArray


class _Reduced(NamedTuple):
    """levels: the first one first. inverse: (k d, k d) of the last few blocks' information. few: (d, p + 1, k) what the
    border and the right-hand side make of them. corner: what is left of it. log_determinant: of all blocks."""

    levels: list[_Level]
    inverse: FloatArray
    few: FloatArray
    corner: FloatArray
    log_determinant: float


def solve(blocks: Blocks, damping: float) -> tuple[FloatArray, FloatArray]:
    """Blocks (n, d) and border (p,). damping: added to the diagonal of the blocks."""
    return _stepped(_reduced(blocks, damping))


def marginals(blocks: Blocks) -> Marginals:
    reduced = _reduced(blocks, 0.0)
    d, _, few = reduced.few.shape
    border = np.asarray(np.linalg.inv(reduced.corner[:-1, :-1]), dtype=np.float64)
    by_block = reduced.inverse.reshape(few, d, few, d)
    at = np.arange(few)
    alone, following = by_block[at, :, at].transpose(1, 2, 0), by_block[at[:-1], :, at[1:]].transpose(1, 2, 0)
    by_border = -reduced.few[:, :-1]
    for level in reversed(reduced.levels):
        by_border = _spread(by_border, -level.by_border[:, :-1], level)
        alone, following = _finer(alone, following, level)
    spread = _times(by_border, np.broadcast_to(border[..., None], (*border.shape, by_border.shape[2])))
    alone = alone + np.einsum("ijn,kjn->ikn", spread, by_border)
    following = following + np.einsum("ijn,kjn->ikn", spread[..., :-1], by_border[..., 1:])
    log_determinant = reduced.log_determinant + float(np.linalg.slogdet(reduced.corner[:-1, :-1])[1])
    covariances, with_next = alone.transpose(2, 0, 1).copy(), following.transpose(2, 0, 1).copy()
    return Marginals(covariances, with_next, border, log_determinant, *_stepped(reduced))


def changes(blocks: Blocks, given: int) -> tuple[FloatArray, FloatArray]:
    """Of the blocks (n, d, given) and of the rest of the border (p - given, given), with the last `given` numbers of
    the border, were these known."""
    reduced = _reduced(blocks, 0.0)
    by_border = -reduced.few[:, :-1]
    for level in reversed(reduced.levels):
        by_border = _spread(by_border, -level.by_border[:, :-1], level)
    p = len(blocks.corner) - 1
    rest, last = slice(p - given), slice(p - given, p)
    border = -np.asarray(np.linalg.solve(reduced.corner[rest, rest], reduced.corner[rest, last]), dtype=np.float64)
    out = by_border[:, last].transpose(2, 0, 1) + by_border[:, rest].transpose(2, 0, 1) @ border
    return out, border


def _stepped(reduced: _Reduced) -> tuple[FloatArray, FloatArray]:
    border = np.asarray(np.linalg.solve(reduced.corner[:-1, :-1], reduced.corner[:-1, -1]), dtype=np.float64)
    towards = np.append(-border, 1.0)
    out = np.einsum("iqn,q->in", reduced.few, towards)[:, None]
    for level in reversed(reduced.levels):
        own = np.einsum("iqn,q->in", level.by_border, towards)[:, None]
        out = _spread(out, own, level)
    return out[:, 0].T.copy(), border


def _reduced(blocks: Blocks, damping: float) -> _Reduced:
    diagonal, following, border = (
        np.ascontiguousarray(np.moveaxis(a, 0, -1)) for a in (blocks.diagonal, blocks.following, blocks.border)
    )
    d = len(diagonal)
    diagonal += damping * np.eye(d)[..., None]
    corner, log_determinant, levels = blocks.corner.copy(), 0.0, []
    while diagonal.shape[2] > _FEW:
        count = diagonal.shape[2] // 2  # of blocks 1, 3, 5, ...
        before, after = following[:, :, 0::2][..., :count], following[:, :, 1::2]
        own = border[..., 1::2]
        inverse, log_pivots = _inverse(diagonal[..., 1::2])
        log_determinant += log_pivots
        by_before = np.einsum("ijn,kjn->ikn", inverse, before)
        by_after = np.zeros_like(by_before)
        inner = after.shape[2]  # the last one has none after it in a chain of even length
        by_after[..., :inner] = _times(inverse[..., :inner], after)
        by_border = _times(inverse, own)
        levels.append(_Level(inverse, by_before, by_after, by_border))
        corner -= np.einsum("iqn,irn->qr", own, by_border)
        diagonal, border = diagonal[..., 0::2].copy(), border[..., 0::2].copy()
        diagonal[..., :count] -= _times(before, by_before)
        border[..., :count] -= _times(before, by_border)
        backwards = after.swapaxes(0, 1)
        diagonal[..., 1 : inner + 1] -= _times(backwards, by_after[..., :inner])
        border[..., 1 : inner + 1] -= _times(backwards, by_border[..., :inner])
        following = -_times(before[..., :inner], by_after[..., :inner])
    return _few(levels, diagonal, following, border, corner, log_determinant)


def _few(
    levels: list[_Level],
    diagonal: FloatArray,
    following: FloatArray,
    border: FloatArray,
    corner: FloatArray,
    log_determinant: float,
) -> _Reduced:
    d, q, few = border.shape
    whole = np.zeros((few, d, few, d))
    at = np.arange(few)
    whole[at, :, at] = diagonal.transpose(2, 0, 1)
    whole[at[:-1], :, at[1:]] = following.transpose(2, 0, 1)
    whole[at[1:], :, at[:-1]] = following.transpose(2, 1, 0)
    try:
        root = np.linalg.inv(np.linalg.cholesky(whole.reshape(few * d, few * d)))
    except np.linalg.LinAlgError:
        raise IndefiniteError("nothing is known of a pose in some direction") from None
    inverse = root.T @ root
    own = border.transpose(2, 0, 1).reshape(few * d, q)
    solved = inverse @ own
    corner -= own.T @ solved
    log_determinant -= 2.0 * float(np.sum(np.log(np.diagonal(root))))
    return _Reduced(levels, inverse, solved.reshape(few, d, q).transpose(1, 2, 0), corner, log_determinant)


def _spread(coarse: FloatArray, own: FloatArray, level: _Level) -> FloatArray:
    """Solutions (d, c, n) of all blocks from those of every second one, and from what the others are by themselves."""
    _, _, count = own.shape
    out = np.empty((*own.shape[:2], count + coarse.shape[2]))
    inner = coarse.shape[2] - 1
    out[..., 0::2] = coarse
    own = own - _times(level.by_before, coarse[..., :count])
    own[..., :inner] -= _times(level.by_after[..., :inner], coarse[..., 1:])
    out[..., 1::2] = own
    return out


def _finer(alone: FloatArray, following: FloatArray, level: _Level) -> tuple[FloatArray, FloatArray]:
    """Covariances of all blocks, and of each with the next, from those of every second one."""
    d, _, count = level.inverse.shape
    inner = alone.shape[2] - 1
    before, after = level.by_before, level.by_after[..., :inner]
    with_before = -_times(before, alone[..., :count])
    with_before[..., :inner] -= np.einsum("ijn,kjn->ikn", after, following)
    with_after = -_times(before[..., :inner], following) - _times(after, alone[..., 1:])
    own = level.inverse - np.einsum("ijn,kjn->ikn", with_before, before)
    own[..., :inner] -= np.einsum("ijn,kjn->ikn", with_after, after)
    out, out_following = np.empty((d, d, count + inner + 1)), np.empty((d, d, count + inner))
    out[..., 0::2], out[..., 1::2] = alone, own
    out_following[..., 0::2] = with_before.swapaxes(0, 1)
    out_following[..., 1::2] = with_after
    return out, out_following


def _times(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ijn,jkn->ikn", one, other))


def _inverse(information: FloatArray) -> tuple[FloatArray, float]:
    """(d, d, m) of symmetric positive definite ones, by Gauss and Jordan; the logarithm of all determinants."""
    out = information.copy()
    log_determinant = 0.0
    for i in range(len(out)):
        pivot = out[i, i].copy()
        if not (pivot > 0.0).all():
            raise IndefiniteError("nothing is known of a pose in some direction")
        log_determinant += float(np.sum(np.log(pivot)))
        row = out[i] / pivot
        column = out[:, i].copy()
        column[i] = 0.0
        out -= column[:, None] * row
        out[:, i] = -column / pivot
        out[i] = row
        out[i, i] = 1.0 / pivot
    return out, log_determinant
