"""The density of a scan at many poses: the sum over all one-to-one assignments of its landmarks to the map's."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.scan_model import ScanModel

_EXACT = 6  # observations that may be the same landmarks, up to which these are kept apart exactly
_CHUNK = 200_000  # numbers at a time


def log_sum(model: ScanModel, poses: FloatArray, log_floor: float) -> FloatArray:
    """(h,) relative to all being clutter, at poses (h, 3) of the sensor; log_floor: of what else there is, that and all
    clutter included.

    Up to six observations that may be the same landmarks are kept apart exactly, more of them two at a time.
    """
    n, m = model.may.shape
    step = max(1, _CHUNK // (n * m))
    chunks = [slice(begin, begin + step) for begin in range(0, len(poses), step)]
    exactly = np.zeros((1, 3, 3))
    near = np.stack([np.asarray(np.any(model.near(poses[chunk], exactly), axis=0)) for chunk in chunks])
    near = np.asarray(np.any(near, axis=0, keepdims=True))
    wider = model.widening(near)
    row, landmark = np.nonzero(near[0])
    if not len(row):
        return np.full(len(poses), log_floor)
    step = max(1, _CHUNK // len(row))
    parts = [
        _log_matchings(model.log_gains(poses[begin : begin + step], row, landmark, wider), row, landmark, n)
        for begin in range(0, len(poses), step)
    ]
    total = np.concatenate(parts)
    # what is found holds all clutter too, and so does the floor
    return np.asarray(log_floor + np.log1p(np.exp(total - log_floor) - np.exp(-log_floor)))


def _log_matchings(gain: FloatArray, row: IntArray, landmark: IntArray, n: int) -> FloatArray:
    """(h,) log of the sum over assignments, of log ratios (h, k) to clutter for pairs (k,) of row and landmark."""
    ratio = np.exp(np.minimum(gain, 600.0))
    total = np.ones((n, len(gain)))
    for k, i in enumerate(row):
        total[i] += ratio[:, k]
    out = np.log(total).sum(axis=0)
    share = {(int(i), int(j)): ratio[:, k] / total[i] for k, (i, j) in enumerate(zip(row, landmark, strict=True))}
    shared = np.flatnonzero(np.bincount(landmark) > 1)
    if not len(shared):
        return np.asarray(out)
    common = np.isin(landmark, shared)
    graph = coo_array((np.ones(common.sum()), (row[common], landmark[common] + n)), shape=(n + landmark.max() + 1,) * 2)
    _, member = connected_components(graph, directed=False)
    for group in np.unique(member[n + shared]):
        rows = np.flatnonzero(member[:n] == group).tolist()
        of_group = [j for j in shared.tolist() if member[n + j] == group]
        out += _log_one_to_one(share, rows, of_group) if len(rows) <= _EXACT else _log_in_pairs(share, rows, of_group)
    return np.asarray(out)


def _log_one_to_one(share: dict[tuple[int, int], FloatArray], rows: list[int], shared: list[int]) -> FloatArray:
    """(h,) log of the share of what assigns each of the shared landmarks once at most: by subsets of the rows that have
    one of them, landmark by landmark."""
    h = len(next(iter(share.values())))
    taken = np.zeros((1 << len(rows), h))
    taken[0] = 1.0
    alone = np.ones((len(rows), h))
    for j in shared:
        before = taken.copy()
        for bit, i in enumerate(rows):
            if (i, j) in share:
                alone[bit] -= share[i, j]
                without = [s for s in range(1 << len(rows)) if not s >> bit & 1]
                taken[[s | 1 << bit for s in without]] += before[without] * share[i, j]
    alone = np.maximum(alone, 0.0)
    rest = np.ones_like(taken)
    for s in range(1 << len(rows)):
        for bit in range(len(rows)):
            if not s >> bit & 1:
                rest[s] *= alone[bit]
    return np.asarray(np.log(np.maximum(np.sum(taken * rest, axis=0), 1e-300)))


def _log_in_pairs(share: dict[tuple[int, int], FloatArray], rows: list[int], shared: list[int]) -> FloatArray:
    out = np.zeros(len(next(iter(share.values()))))
    for a, i in enumerate(rows):
        for k in rows[:a]:
            both = sum((share[i, j] * share[k, j] for j in shared if (i, j) in share and (k, j) in share), np.zeros(1))
            out = out + np.log1p(-np.minimum(both, 1.0 - 1e-12))
    return out
