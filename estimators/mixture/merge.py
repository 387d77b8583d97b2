"""Hypotheses that say nearly the same become one, with the mean and the covariance that they had together.

Two are alike if one Gaussian in place of both loses little: (1 - a) log|P1| + a log|P2| against log|P| of both
together, half of it (Runnalls 2007, eq. 16, without the weight in front), in the pose and the compass' offset; a is
the share of the second.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimators.mixture.bank import Bank
from estimators.mixture.sides import Sides
from estimators.views import OFFSET
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_COMPARED = np.array([0, 1, 2, OFFSET])
_ALIKE = 0.2  # a loss that nobody sees: equally likely ones are 0.65 sigmas apart
_SAME = 1e-7  # with different weights for the map's copies only those merge that are one but for rounding
_SAME_SIDES = 0.01
_LEAST_SHARE = 0.05  # of the unlikelier of two: it may become likely, and what it knows better is not to be lost
_APART2 = 16.0  # squared sigmas of the difference: what may soon be told apart is kept, however unlikely
_NEAR_SIGMAS = 4.0


def merged(bank: Bank, sides: Sides) -> tuple[Bank, IntArray]:
    """The likeliest first, and (h,) the row of it in which each of the old ones is now."""
    bank_order = np.argsort(-bank.totals, kind="stable")
    bank = bank.take(bank_order)
    one, other, copy = _alike(bank, sides)
    count = len(bank)
    if not len(one):
        into = np.empty(count, dtype=np.intp)
        into[bank_order] = np.arange(count)
        return bank, into
    # greedily: the likeliest takes all that are like it, then the likeliest of those left
    head, side = list(range(count)), [0] * count
    taken = [False] * count
    for i, j, k in zip(one.tolist(), other.tolist(), copy.tolist(), strict=True):
        if not taken[i] and not taken[j]:
            taken[j], head[j], side[j] = True, i, k
    heads = np.flatnonzero(~np.array(taken))
    row_of = np.zeros(count, dtype=np.intp)
    row_of[heads] = np.arange(len(heads))
    group = row_of[np.array(head)]
    into = np.empty(count, dtype=np.intp)
    into[bank_order] = group
    return _together(bank, heads, group, np.array(side), sides), into


def _alike(bank: Bank, sides: Sides) -> tuple[IntArray, IntArray, IntArray]:
    """(n,) rows of pairs that may be merged, the likelier first, in order; and which copy of it the second is."""
    variances = np.diagonal(bank.covariances, axis1=1, axis2=2)
    reach = _NEAR_SIGMAS * np.sqrt(variances[:, 0] + variances[:, 1])
    turn = _NEAR_SIGMAS * np.sqrt(variances[:, 2])
    reach, turn = reach[:, None, None] + reach, turn[:, None, None] + turn
    at = sides.unfold(bank.poses)[:, :, None]  # (h, c, 1, 3), against (h, 3)
    apart = bank.poses - at
    near = (np.abs(apart[..., :2]) < reach[..., None]).all(axis=-1) & (np.abs(se2.wrap(apart[..., 2])) < turn)
    rank = np.arange(len(bank))
    near &= (rank[:, None] < rank)[:, None]
    one, copy, other = np.nonzero(near)
    if not len(one):
        return one, other, copy
    loss, apart2, same_sides = _compared(bank, sides, one, other, copy)
    good = (loss < np.where(same_sides, _ALIKE, _SAME)) & (apart2 < _APART2)
    return one[good], other[good], copy[good]


def _compared(
    bank: Bank, sides: Sides, one: IntArray, other: IntArray, copy: IntArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """(n,) what is lost by merging, squared sigmas between them, whether their weights agree about the sides."""
    totals = bank.totals
    share = np.maximum(1.0 / (1.0 + np.exp(totals[one] - totals[other])), _LEAST_SHARE)
    offset = bank.extra[other, -1] - bank.extra[one, -1]
    tangent = se2.local(sides.of_copy(copy, bank.poses[one]), bank.poses[other])
    step = np.concatenate([tangent, offset[:, None]], axis=1)
    covariances = bank.covariances[:, _COMPARED[:, None], _COMPARED]
    first, second = covariances[one], covariances[other]
    a = share[:, None, None]
    both = (1.0 - a) * first + a * second + a * (1.0 - a) * step[:, :, None] * step[:, None, :]
    log_det, log_det_both = np.split(np.linalg.slogdet(np.concatenate([covariances, both]))[1], [len(bank)])
    loss = 0.5 * (log_det_both - (1.0 - share) * log_det[one] - share * log_det[other])
    apart2 = np.einsum("ni,ni->n", step, np.linalg.solve(first + second, step[:, :, None])[:, :, 0])
    if len(sides) == 1:
        return loss, apart2, np.ones(len(one), dtype=np.bool_)
    by_side = np.exp(bank.log_weights - totals[:, None])
    theirs = _as_sides_of(by_side[other], copy, sides)
    return loss, apart2, np.abs(by_side[one] - theirs).max(axis=1) < _SAME_SIDES


def _as_sides_of(weights: FloatArray, copy: IntArray, sides: Sides) -> FloatArray:
    """(n, c) weights of copies of poses which are themselves that copy (n,) of another, as of copies of that one."""
    if not copy.any():
        return weights
    out = np.empty_like(weights)
    np.put_along_axis(out, sides.after.T[copy], weights, axis=1)
    return out


def _together(bank: Bank, heads: IntArray, group: IntArray, copy: IntArray, sides: Sides) -> Bank:
    """One Gaussian for each group (h,), in the tangent of its head; the copy of that which each row is: (h,)."""
    log_weights = _as_sides_of(bank.log_weights, copy, sides)
    totals = bank.totals
    sums = np.full((len(heads), len(sides)), -np.inf)
    np.logaddexp.at(sums, group, log_weights)
    out = replace(bank.take(heads), log_weights=sums)
    several = np.bincount(group) > 1
    rows = np.flatnonzero(several[group])
    index = (np.cumsum(several) - 1)[group[rows]]
    heads, count = heads[several], int(several.sum())
    weights = np.exp(totals[rows] - out.totals[several][index])
    steps = np.concatenate(
        [
            se2.local(sides.of_copy(copy[rows], bank.poses[heads][index]), bank.poses[rows]),
            bank.extra[rows] - bank.extra[heads][index],
        ],
        axis=1,
    )
    mean = np.zeros((count, steps.shape[1]))
    np.add.at(mean, index, weights[:, None] * steps)
    around = steps - mean[index]
    covariances = _turned(bank.covariances[rows], se2.right_jacobian_inverse(steps[:, :3]))
    covariances += around[:, :, None] * around[:, None, :]
    summed = np.zeros((count, *covariances.shape[1:]))
    np.add.at(summed, index, weights[:, None, None] * covariances)
    out.poses[several] = se2.retract(bank.poses[heads], mean[:, :3])
    out.extra[several] = bank.extra[heads] + mean[:, 3:]
    out.covariances[several] = _turned(summed, se2.right_jacobian(mean[:, :3]))
    return out


def _turned(covariances: FloatArray, by: FloatArray) -> FloatArray:
    """With the pose's part of covariances (n, SIZE, SIZE) in the tangent that `by` (n, 3, 3) leads to."""
    out = covariances.copy()
    out[:, :3] = by @ out[:, :3]
    out[:, :, :3] = out[:, :, :3] @ by.swapaxes(-1, -2)
    return np.asarray(0.5 * (out + out.swapaxes(-1, -2)))
