"""The density of a scan at many poses: the sum over all one-to-one assignments of its landmarks to the map's."""

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.scan_coverage import Misses
from fieldloc.scan_model import ScanModel

_EXACT = 6  # observations, up to which those of one landmark are kept apart exactly
_CONFLICT = 1e-3  # share of assignments that give a landmark away twice, below which they are left in
_AT_ONCE = 400_000  # numbers


def log_sum(model: ScanModel, poses: FloatArray, log_floor: float, misses: Misses | None = None) -> FloatArray:
    """(h,) relative to all being clutter, at poses (h, 3) of the sensor; log_floor: of what else there is, that and all
    clutter included. misses: what is not seen counts for assignments, not for the floor.

    Assignments are one to one: exactly for up to six observations, two by two for more; to a thousandth in any case.
    """
    step = max(1, _AT_ONCE // model.may.size)
    parts = [slice(first, first + step) for first in range(0, len(poses), step)]
    near = np.any([model.near_any(poses[part]) for part in parts], axis=0) if parts else model.may & False
    used = np.flatnonzero(near.any(axis=0))
    if not len(used):
        return np.full(len(poses), log_floor)
    wider = model.widening(*np.nonzero(near))
    out = np.empty(len(poses))
    for part in parts:
        gain = model.log_gains(poses[part], used, wider)
        log_missed = (
            np.zeros((len(gain[0]), len(model.positions))) if misses is None else misses.log_missed(poses[part])
        )
        gain -= log_missed[:, used]
        ratio = np.where(near[:, None, used], np.exp(np.minimum(gain, 600.0)), 0.0)
        # what is found holds all clutter too, and so does the floor
        found = _log_matchings(ratio)
        with np.errstate(divide="ignore"):
            some = np.log(-np.expm1(-np.maximum(found, 0.0))) + found
        out[part] = np.logaddexp(log_floor, some + log_missed.sum(axis=1))
    return out


def _log_matchings(ratio: FloatArray) -> FloatArray:
    """(h,) log of the sum over one-to-one assignments of ratios (n, h, k) to clutter."""
    total = 1.0 + ratio.sum(axis=2)
    out = np.log(total).sum(axis=0)
    if len(ratio) > 1 and ratio.shape[2]:
        share = ratio / total[..., None]
        twice = 0.5 * (share.sum(axis=0) ** 2 - (share**2).sum(axis=0)).sum(axis=1)
        rows = np.flatnonzero(twice > _CONFLICT)
        if len(rows):
            apart = _log_one_to_one if len(ratio) <= _EXACT else _log_two_by_two
            out[rows] += apart(share[:, rows], 1.0 / total[:, rows])
    return np.asarray(out)


def _log_one_to_one(share: FloatArray, clutter: FloatArray) -> FloatArray:
    """(h,) log of the part that assigns each landmark once at most, of shares (n, h, k) and (n, h).

    By subsets of the observations that have a landmark, landmark by landmark.
    """
    n, h, k = share.shape
    taken = np.zeros((1 << n, h))
    taken[0] = 1.0
    subsets = np.arange(1 << n)
    without = [subsets[(subsets >> i & 1) == 0] for i in range(n)]
    for j in range(k):
        before = taken.copy()
        for i in range(n):
            taken[without[i] | 1 << i] += before[without[i]] * share[i, :, j]
    for i in range(n):
        taken[without[i]] *= clutter[i]
    return np.asarray(np.log(np.maximum(taken.sum(axis=0), 1e-300)))


def _log_two_by_two(share: FloatArray, clutter: FloatArray) -> FloatArray:
    """The same where conflicts between different pairs of observations have nothing to do with each other."""
    both = np.einsum("ihk,jhk->ijh", share, share)
    above = np.triu_indices(len(share), 1)
    return np.asarray(np.log1p(-np.minimum(both[above], 1.0 - 1e-12)).sum(axis=0))
