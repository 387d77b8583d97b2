"""The density of a scan at many poses: the sum over all one-to-one assignments of its landmarks to the map's."""

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.scan_coverage import Misses
from fieldloc.scan_model import BoolArray, Errors, ScanModel
from fieldloc.scan_quadratics import log_shared

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
        errors = model.errors(poses[part], used)
        log_missed = np.zeros((len(errors.d), len(model.positions)))
        if misses is not None:
            log_missed = misses.log_missed(poses[part])
        may = near[:, None, used]
        unseen = log_missed[:, used]
        lower: FloatArray | float = 0.0
        if model.shared is not None:
            errors, lower = _without_shared(model, errors, wider, may, unseen)
        ratio = _ratio(model.log_gains(errors, wider, model.covariance), may, unseen)
        # what is found holds all clutter too, and so does the floor
        found = _log_matchings(ratio)
        with np.errstate(divide="ignore"):
            some = np.log(-np.expm1(-np.maximum(found, 0.0))) + found
        out[part] = np.logaddexp(log_floor, some + lower + log_missed.sum(axis=1))
    return out


def _ratio(gain: FloatArray, may: BoolArray, unseen: FloatArray) -> FloatArray:
    """(n, h, k) of densities of observations as landmarks to those as clutter."""
    return np.where(may, np.exp(np.minimum(gain - unseen, 600.0)), 0.0)


def _without_shared(
    model: ScanModel, errors: Errors, wider: FloatArray | None, may: BoolArray, unseen: FloatArray
) -> tuple[Errors, FloatArray]:
    """Errors (n, h, k) without what the scan likeliest shares, from each pose; and (h,) the log of what the integral
    over that has to its integrand there.

    Of one assignment that is exact. Of several that are as likely it is taken as of one that is all of them, by their
    shares: the approximation.
    """
    assert model.shared is not None
    by_range, by_bearing = model.shared_widened.T[:, :, None, None]
    ratio = _ratio(_whole_gains(model, errors, wider), may, unseen)
    share = ratio / (1.0 + ratio.sum(axis=2, keepdims=True))
    # of two observations the likelier one has the landmark
    share /= np.maximum(share.sum(axis=0), 1.0)
    (rr, rb, bb), (wrr, wrb, wbb) = model.noise_at(errors, wider, model.covariance)
    weight = share / (wrr * wbb - wrb * wrb)
    pull_r = (weight * (wbb * errors.range_m - wrb * errors.bearing_rad) * by_range).sum(axis=(0, 2))
    pull_b = (weight * (wrr * errors.bearing_rad - wrb * errors.range_m) * by_bearing).sum(axis=(0, 2))
    a = 1.0 + (weight * wbb * by_range**2).sum(axis=(0, 2))
    b = -(weight * wrb * by_range * by_bearing).sum(axis=(0, 2))
    d = 1.0 + (weight * wrr * by_bearing**2).sum(axis=(0, 2))
    det = a * d - b * b
    of_range, of_bearing = (b * pull_b - d * pull_r) / det, (b * pull_r - a * pull_b) / det
    lower = -0.5 * (of_range**2 + of_bearing**2)
    if wider is None and (model.wider_shared == 1.0).all():
        lower -= 0.5 * np.log(det)
    else:
        weight = share / (rr * bb - rb * rb)
        plain_r, plain_b = model.shared.T[:, :, None, None]
        sums = (weight * bb * plain_r**2, -weight * rb * plain_r * plain_b, weight * rr * plain_b**2)
        lower += log_shared(np.stack([one.sum(axis=(0, 2)) for one in sums], axis=-1))
    return errors._replace(
        range_m=errors.range_m + by_range * of_range[:, None],
        bearing_rad=errors.bearing_rad + by_bearing * of_bearing[:, None],
    ), lower


def _whole_gains(model: ScanModel, errors: Errors, wider: FloatArray | None) -> FloatArray:
    """(n, h, k) of each observation by itself, widened."""
    assert model.shared is not None
    if wider is None and (model.wider_shared == 1.0).all():
        return model.log_gains(errors, None, model.whole_covariance)
    own = model.covariance
    if wider is not None:
        root = np.sqrt(wider)
        own = own * root[:, :, None] * root[:, None, :]
    return model.log_gains(errors, None, own + model.shared_widened[:, :, None] ** 2 * np.eye(2))


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
