"""Which landmark is which, all of a scan at once: joint assignments one to one.

Observation by observation as in joint compatibility branch and bound (Neira & Tardos 2001): each that finds its
landmark narrows the pose down before the next one is held against the map.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.scan_candidates import MOST, recognised
from fieldloc.scan_model import Errors, ScanModel
from fieldloc.scan_moments import Upper, determinant
from fieldloc.scan_pairs import Pairs

_AT_ONCE = 48  # assignments followed of one hypothesis
_FORGOTTEN_ON_THE_WAY = 12.0  # log weight below the best one's


class Assignments(NamedTuple):
    """parent (c,): row of the pose. matches (c, n): landmark per observation, -1 for none. step (c, 3): where they take
    the tangent. score (c,): log evidence relative to all being clutter, about."""

    parent: IntArray
    matches: IntArray
    step: FloatArray
    score: FloatArray

    def take(self, rows: IntArray) -> "Assignments":
        return Assignments(self.parent[rows], self.matches[rows], self.step[rows], self.score[rows])


def assign(model: ScanModel, pairs: Pairs, covariances: FloatArray) -> Assignments:
    """All that are within e^-12 of a pose's best, up to 48 a pose, for poses up to covariances (h, 3, 3).

    All clutter is one of them.
    """
    n, h = len(model.range_bearing), len(covariances)
    count = np.bincount(pairs.pose * n + pairs.row, minlength=h * n)
    first = (np.cumsum(count) - count).reshape(h, n)
    count = count.reshape(h, n)
    parent = np.arange(h)
    matches = np.full((h, n), -1)
    covariance, longer = _with_shared(model, covariances)
    step: FloatArray = np.zeros(covariance.shape[:2])
    score: FloatArray = np.zeros(h)
    for row in range(n):
        options = count[parent, row]
        total = int(options.sum())
        if not total:
            continue
        origin = np.repeat(np.arange(len(parent)), options)
        pair = first[parent[origin], row] + np.arange(total) - np.repeat(np.cumsum(options) - options, options)
        if row:
            free = (matches[origin, :row] != pairs.landmark[pair, None]).all(axis=1)
            origin, pair = origin[free], pair[free]
        moved, narrowed, gain = _absorb(pairs, pair, longer[row], step[origin], covariance[origin])
        explained = matches[origin]
        explained[:, row] = pairs.landmark[pair]
        parent = np.concatenate([parent, parent[origin]])
        matches = np.concatenate([matches, explained])
        step, covariance = np.concatenate([step, moved]), np.concatenate([covariance, narrowed])
        score = np.concatenate([score, score[origin] + gain])
        keep = _best(parent, score, h)
        parent, matches, score = parent[keep], matches[keep], score[keep]
        step, covariance = step[keep], covariance[keep]
    return Assignments(parent, matches, step[:, :3], score)


def _with_shared(model: ScanModel, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariances (h, 3, 3) with what the scan shares: a turn of all bearings is one of the sensor, and ranges that are
    all too long are a fourth number (h, 4, 4). Then (n, 2) what that moves each observation by."""
    n = len(model.range_bearing)
    if model.shared is None:
        return covariances, np.zeros((n, 2))
    by_range, by_bearing = model.shared_widened.T
    out = np.zeros((len(covariances), 4, 4))
    out[:, :3, :3] = covariances
    out[:, 2, 2] += by_bearing[0] ** 2
    out[:, 3, 3] = 1.0
    along = model.range_bearing[:, 1]
    return out, by_range[:, None] * np.stack([np.cos(along), np.sin(along)], axis=-1)


def _absorb(
    pairs: Pairs, pair: IntArray, longer: FloatArray, step: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The Kalman update with one pair each: step (c, k), covariance (c, k, k), and gain in log evidence (c,).

    The error's Jacobian is [[-1, 0, y], [0, -1, -x]], with `longer` (2,) beside it if k is 4; written out, it is
    several times faster than products of small matrices.
    """
    x, y = pairs.x[pair], pairs.y[pair]
    ex = pairs.ex[pair] - step[:, 0] + y * step[:, 2]
    ey = pairs.ey[pair] - step[:, 1] - x * step[:, 2]
    p0, p1, p2 = covariance[:, 0], covariance[:, 1], covariance[:, 2]
    by_x, by_y = y[:, None] * p2 - p0, -x[:, None] * p2 - p1
    if step.shape[1] == 4:
        ex, ey = ex + longer[0] * step[:, 3], ey + longer[1] * step[:, 3]
        by_x, by_y = by_x + longer[0] * covariance[:, 3], by_y + longer[1] * covariance[:, 3]
    xx = y * by_x[:, 2] - by_x[:, 0] + pairs.xx[pair]
    xy = -x * by_x[:, 2] - by_x[:, 1] + pairs.xy[pair]
    yy = -x * by_y[:, 2] - by_y[:, 1] + pairs.yy[pair]
    if step.shape[1] == 4:
        xx, xy, yy = xx + longer[0] * by_x[:, 3], xy + longer[1] * by_x[:, 3], yy + longer[1] * by_y[:, 3]
    det = xx * yy - xy * xy
    wx, wy = (yy * ex - xy * ey) / det, (xx * ey - xy * ex) / det
    gain_x = ((yy / det)[:, None] * by_x - (xy / det)[:, None] * by_y)[:, :, None]
    gain_y = ((xx / det)[:, None] * by_y - (xy / det)[:, None] * by_x)[:, :, None]
    return (
        step - wx[:, None] * by_x - wy[:, None] * by_y,
        covariance - gain_x * by_x[:, None] - gain_y * by_y[:, None],
        pairs.log_peak[pair] - 0.5 * (np.log(det) + ex * wx + ey * wy),
    )


def _best(parent: IntArray, score: FloatArray, h: int) -> IntArray:
    """Rows near the best of their parents, in order of these; the best first."""
    order = np.lexsort((-score, parent))
    parent, score = parent[order], score[order]
    begin = np.searchsorted(parent, np.arange(h))
    rank = np.arange(len(parent)) - begin[parent]
    return np.asarray(order[(score > score[begin[parent]] - _FORGOTTEN_ON_THE_WAY) & (rank < _AT_ONCE)])


def likeliest(model: ScanModel, pose: FloatArray) -> IntArray:
    """(n,) landmark of each observation, -1 for none, in the best assignment from one pose (3,)."""
    if model.survey is None and (model.named is not None or model.may.size <= MOST):
        x, y, heading = pose.tolist()
        return recognised(model, (x, y, heading))
    which = np.arange(len(model.positions)) if model.named is None else model.named
    errors = model.errors(pose[None], which)
    plain, _ = model.noise_at(errors, None, model.covariance)
    misfit, _ = _misfit(errors, plain, model.shared_plain.T)
    row, column = np.nonzero((misfit[:, 0] < model.gates[:, None]) & model.may[:, which])
    wider = model.widening(row, which[column])
    _, widened = model.noise_at(errors, wider, model.covariance)
    misfit, det = _misfit(errors, widened, model.shared_widened.T)
    worth = model.log_peak[:, None, None] - 0.5 * (misfit + np.log(det / determinant(widened) * determinant(plain)))
    out = np.full(len(model.range_bearing), -1)
    if model.named is not None:
        good = row[worth[row, 0, column] > 0.0]
        out[good] = model.named[good]
        return out
    gain = np.zeros(model.may.shape)
    gain[row, column] = np.maximum(worth[row, 0, column], 0.0)
    row, landmark = linear_sum_assignment(gain, maximize=True)
    out[row] = np.where(gain[row, landmark] > 0.0, landmark, -1)
    return out


def _misfit(errors: Errors, own: Upper, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Chi-square of errors (n, h, k) by their own covariance and standard deviations (2, n) of what is shared, and the
    determinant of that."""
    rr, rb, bb = own[0] + (shared[0] ** 2)[:, None, None], own[1], own[2] + (shared[1] ** 2)[:, None, None]
    det = rr * bb - rb * rb
    r, b = errors.range_m, errors.bearing_rad
    return (bb * r * r - 2.0 * rb * r * b + rr * b * b) / det, det
