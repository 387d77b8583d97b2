"""The assignments of a scan that robots could have seen who are at some places, each as a quadratic there."""

from typing import NamedTuple

import numpy as np

from fieldloc import pose as se2
from fieldloc import scan_candidates as candidates
from fieldloc.mixture import After, Expansion, IntArray
from fieldloc.pose import FloatArray
from fieldloc.scan_alone import MOST, ROUNDS, STRAIGHT, Symmetric, Vector, expanded_alone, seen_of
from fieldloc.scan_assignments import Assignments, assign
from fieldloc.scan_model import ScanModel, Terms
from fieldloc.scan_pairs import Pairs, pairs_of
from fieldloc.scan_quadratics import Freed, Quadratics, log_shared, quadratics

_FORGOTTEN = 8.0  # log weight below the best one of a pose
_ONLY = np.zeros(1, dtype=np.intp)
_DOUBTFUL = 2.0  # log evidence of an observation's landmark against clutter, below which more of them may be wrong


def expand(model: ScanModel, poses: FloatArray, covariances: FloatArray) -> tuple[Expansion, IntArray]:
    """Assignments near poses (h, 3) as quadratics, and their landmarks (c, n) per observation, -1 for none.

    ids are rows, constants relative to all being clutter, which is left out itself.
    """
    if len(poses) == 1 and model.named is not None and len(model.named):
        # if all are where their labels say, nothing else is to be asked
        wider = model.widening_of(model.named)
        if (undoubted := _alone(model, model.named, wider, poses, covariances)) is not None:
            return undoubted, model.named[None]
        found = Assignments(np.zeros(1, dtype=np.intp), model.named[None], np.zeros((1, 3)), np.zeros(1))
        if (doubted := _without_one(_expanded(model, found, poses, covariances, wider), found.matches)) is not None:
            return doubted
    elif len(poses) == 1:
        only = candidates.matches(model, _vector(poses[0]), _upper(covariances[0]))
        if only is not None:
            wider = model.widening_of(only)
            if (undoubted := _alone(model, only, wider, poses, covariances)) is not None:
                return undoubted, only[None]
    pairs = pairs_of(model, poses, covariances)
    matches = np.full((len(poses), len(model.range_bearing)), -1)
    matches[pairs.pose, pairs.row] = pairs.landmark
    if _unambiguous(pairs, len(poses), *model.may.shape):
        parent = np.flatnonzero((matches >= 0).any(axis=1))
        found = Assignments(parent, matches[parent], np.zeros((len(parent), 3)), np.zeros(len(parent)))
        expanded = _expanded(model, found, poses, covariances, pairs.wider)
        if (doubted := _without_one(expanded, found.matches)) is not None:
            return doubted
    found = assign(model, pairs, covariances)
    found = found.take(np.flatnonzero((found.matches >= 0).any(axis=1)))
    out = _expanded(model, found, poses, covariances, pairs.wider).out
    best = np.full(len(poses), -np.inf)
    np.maximum.at(best, out.parent, out.evidence)
    keep = np.flatnonzero(out.evidence > best[out.parent] - _FORGOTTEN)
    return out.take(keep), found.matches[keep]


def likeliest_near(model: ScanModel, pose: FloatArray, covariance: FloatArray, share: float) -> IntArray | None:
    """(n,) landmark of each observation, -1 for none, near a pose (3,) up to a covariance (3, 3), if that is so likely
    beside all others that explain something."""
    matches = model.named if model.named is not None else candidates.matches(model, _vector(pose), _upper(covariance))
    if matches is not None and model.survey is None and 0 < np.count_nonzero(matches >= 0) <= MOST:
        out = expanded_alone(seen_of(model, matches, model.widening_of(matches)), _vector(pose), _upper(covariance))
        if out.least_gain > _DOUBTFUL and 1.0 + out.doubt < 1.0 / share:
            return matches
    near, every = expand(model, pose[None], covariance[None])
    if not len(every) or np.exp(near.evidence - near.evidence.max()).sum() > 1.0 / share:
        return None
    return np.asarray(every[np.argmax(near.evidence)])


def _unambiguous(pairs: Pairs, h: int, n: int, m: int) -> bool:
    """Whether no observation may be two landmarks, and no landmark two observations, from any one pose."""
    return bool(
        len(pairs.pose) <= 1
        or max(np.bincount(pairs.pose * n + pairs.row).max(), np.bincount(pairs.pose * m + pairs.landmark).max()) == 1
    )


def _alone(
    model: ScanModel, matches: IntArray, wider: FloatArray | None, poses: FloatArray, covariances: FloatArray
) -> Expansion | None:
    """Of one assignment (n,) from one pose (1, 3); None where others are worth a doubt, or arrays are faster."""
    if model.survey is not None or len(matches) > MOST or not (seen := seen_of(model, matches, wider)):
        return None
    out = expanded_alone(seen, _vector(poses[0]), _upper(covariances[0]))
    if not out.least_gain > _FORGOTTEN:
        return None
    return Expansion(
        _ONLY,
        _ONLY,
        np.array([out.constant]),
        np.array([out.gradient]),
        _matrix(out.information),
        covariances,
        After(np.array([out.shrink]), np.array([out.step]), _matrix(out.updated), np.array([out.evidence])),
    )


def _vector(pose: FloatArray) -> Vector:
    x, y, heading = pose.tolist()
    return x, y, heading


def _upper(covariance: FloatArray) -> Symmetric:
    (xx, xy, xh), (_, yy, yh), (_, _, hh) = covariance.tolist()
    return xx, xy, xh, yy, yh, hh


def _matrix(a: Symmetric) -> FloatArray:
    """(1, 3, 3)."""
    return np.array([[[a[0], a[1], a[2]], [a[1], a[3], a[4]], [a[2], a[4], a[5]]]])


class _Expanded(NamedTuple):
    """whole: with the shared errors, which are `freed`, from `terms` in the tangent at the parent's pose; weighted
    (c, n, 2, k + 1): Jacobian and error of each observation, weighted."""

    out: Expansion
    whole: Quadratics
    freed: Freed | None
    terms: Terms
    weighted: FloatArray


def _expanded(
    model: ScanModel, found: Assignments, poses: FloatArray, covariances: FloatArray, wider: FloatArray | None
) -> _Expanded:
    """At their parents among poses (h, 3), straight where they lead."""
    origin, covariance = poses[found.parent], covariances[found.parent]
    step = found.step
    each = np.arange(len(step))
    moved = bool(step.any())
    for _ in range(ROUNDS):
        terms = model.terms(se2.retract(origin, step) if moved else origin, found.matches, wider)
        if moved:
            jacobian = terms.jacobian[..., :3] @ se2.right_jacobian(step)[:, None]
            terms.error[:] -= (jacobian @ step[:, None, :, None])[..., 0]
            terms.jacobian[..., :3] = jacobian
        whole, weighted = quadratics(terms)
        freed = whole.freed()
        out = Expansion(found.parent, each, *whole.of_pose(freed), covariance)
        if (np.abs(out.step - step) < STRAIGHT).all():
            break
        step, moved = out.step, True
    return _Expanded(out, whole, freed, terms, weighted)


def _without_one(found: _Expanded, matches: IntArray) -> tuple[Expansion, IntArray] | None:
    """The assignments of all that has its landmark, and those with one left out that is worth a doubt.

    None where one is so doubtful that more of them may be wrong.
    """
    full, whole, freed, terms, weighted = found
    size = weighted.shape[-1] - 1
    # how likely each is beside the others: the innovation without it, from the residual with it
    jacobian, error = terms.jacobian[..., :3], terms.error
    if freed is not None:
        follows = terms.jacobian[..., 3:] @ freed.mean[:, None]
        jacobian, error = jacobian - follows[..., :3], error + follows[..., 3]
    spread = jacobian @ full.updated[:, None] @ jacobian.swapaxes(-1, -2)
    if freed is not None:
        of_shared = terms.jacobian[..., 3:]
        spread += of_shared @ freed.covariance[:, None] @ of_shared.swapaxes(-1, -2)
    left = error + (jacobian @ full.step[:, None, :, None])[..., 0]
    explained = terms.weight @ spread
    a, b = 1.0 - explained[..., 0, 0], -explained[..., 0, 1]
    c, d = -explained[..., 1, 0], 1.0 - explained[..., 1, 1]
    det = np.maximum(a * d - b * c, 1e-300)
    pull = (terms.weight @ left[..., None])[..., 0]
    misfit = left[..., 0] * (d * pull[..., 0] - b * pull[..., 1]) + left[..., 1] * (a * pull[..., 1] - c * pull[..., 0])
    gain = np.where(matches >= 0, terms.log_peak + 0.5 * np.log(det) - 0.5 * misfit / det, np.inf)
    least = gain.min(initial=np.inf)
    if least > _FORGOTTEN:
        return full, matches
    if least < _DOUBTFUL:
        return None
    row, seen = np.nonzero((gain < _FORGOTTEN) & ((matches >= 0).sum(axis=1) > 1)[:, None])
    error, jacobian, of_it = terms.error[row, seen], terms.jacobian[row, seen], weighted[row, seen]
    back = np.swapaxes(jacobian, -1, -2) @ of_it
    constant = whole.constant[row] - terms.log_peak[row, seen] + 0.5 * (error * of_it[..., size]).sum(axis=1)
    if terms.of_shared is not None:
        of_all = terms.of_shared.sum(axis=1)[row]
        constant += log_shared(of_all - terms.of_shared[row, seen]) - log_shared(of_all)
    sums = Quadratics(constant, whole.gradient[row] + back[..., size], whole.information[row] - back[..., :size])
    fewer = sums.of_pose(sums.freed())
    rows = np.concatenate([np.arange(len(matches)), row])
    others = matches[rows]
    others[np.arange(len(matches), len(rows)), seen] = -1
    return Expansion(
        full.parent[rows],
        np.arange(len(rows)),
        np.concatenate([full.constant, fewer.constant]),
        np.concatenate([full.gradient, fewer.gradient]),
        np.concatenate([full.information, fewer.information]),
        full.covariance[rows],
    ), others
