"""All whole poses that explain a scan: which landmark is which, and from where, with nothing known before.

`fixes.pair_search` proposes identifications; all are fitted at once, and what else the poses would allow is fitted too.
"""

from typing import NamedTuple

import numpy as np

from fieldloc import pose as se2
from fieldloc.fixes.pair_search import search_pairs
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.scan_assignments import assign
from fieldloc.scan_model import GATE, BoolArray, ScanModel
from fieldloc.scan_pairs import pairs_of
from fieldloc.scan_quadratics import log_shared, quadratics

_ROUNDS = 8
_CONVERGED = 1e-4  # of the last step, in standard deviations squared
_MAX_TURN_RAD = 0.5  # of one step
_MAX_HEADING_SIGMA_RAD = 0.3  # beyond it no ellipse is honest
_LOOSER = 4.0  # covariance in which to look for what else an observation may be
_LOOKED_AROUND = 64  # likeliest fits from which to look
_FORGOTTEN = 20.0  # log weight below the best one's, where a solution is as good as impossible
# chance of a good scan to fail is one in ten thousand: chi-square at 2n - 3 degrees of freedom for n = 2, 3, ...
CHI2_LIMITS = np.array([15.14, 21.11, 25.74, 29.88, 33.72, 37.37, 40.87, 44.26])


class Fits(NamedTuple):
    """matches (c, n), -1 for none; poses (c, 3) of the sensor, covariances (c, 3, 3) of its tangent; log_weights (c,):
    of the integral over poses, relative to all being clutter. whole (c,): whether the heading is known well enough for
    the ellipse to be honest."""

    matches: IntArray
    poses: FloatArray
    covariances: FloatArray
    log_weights: FloatArray
    whole: BoolArray

    def take(self, rows: IntArray) -> "Fits":
        return Fits(
            self.matches[rows], self.poses[rows], self.covariances[rows], self.log_weights[rows], self.whole[rows]
        )


def whole_poses(model: ScanModel) -> Fits:
    """The likeliest first: all that leave at most `may_be_unexplained` observations unexplained, pass a gate at 99.99 %
    and are within e^-20 of the best, at one pose each; those too that leave the heading open, as `whole` says. An
    outlier near a landmark can hide the right one, about once in a hundred scans that hold one."""
    n = len(model.range_bearing)
    found = _fitted(model, _proposals(model))
    if n > 2 and len(found.matches) and (model.may.sum(axis=1) > 1).any():
        start = found.take(np.flatnonzero(found.whole))
        start = start.take(np.argsort(-start.log_weights, kind="stable")[:_LOOKED_AROUND])
        spread = _LOOSER * start.covariances
        around = assign(model, pairs_of(model, start.poses, spread), spread)
        enough = (around.matches >= 0).sum(axis=1) >= n - may_be_unexplained(n)
        found = _fitted(model, np.concatenate([found.matches, around.matches[enough]]))
    best = found.log_weights.max(initial=-np.inf)
    order = np.argsort(-found.log_weights, kind="stable")
    return found.take(order[found.log_weights[order] > best - _FORGOTTEN])


def may_be_unexplained(n: int) -> int:
    """A quarter, but one of three at least."""
    return 0 if n < 3 else max(1, n // 4)


def _proposals(model: ScanModel) -> IntArray:
    """(c, n)."""
    n, m = model.may.shape
    if n < 2 or m < 2:
        return np.zeros((0, n), dtype=np.intp)
    allowed = may_be_unexplained(n)
    if (model.may.sum(axis=1) == 1).all():
        every = np.argmax(model.may, axis=1)
        rows = np.tile(every, (n + 1 if allowed else 1, 1))
        if allowed:
            rows[np.arange(n), np.arange(n)] = -1
        return rows
    seen, covariance = model.points
    survey = np.zeros((m, 2, 2)) if model.survey is None else model.survey
    proposed = search_pairs(model.positions, survey, seen, covariance, allowed, GATE)
    matches = np.array([match for _, match in proposed], dtype=np.intp).reshape(-1, n)
    return matches[(model.may[np.arange(n), matches] | (matches < 0)).all(axis=1)]


def _fitted(model: ScanModel, matches: IntArray) -> Fits:
    """Least squares of each that has two landmarks at least, once each; without those that fit badly."""
    n = matches.shape[1]
    matches = np.unique(matches, axis=0) if len(matches) else matches
    ordered = np.sort(matches, axis=1)
    twice = ((ordered[:, 1:] == ordered[:, :-1]) & (ordered[:, 1:] >= 0)).any(axis=1)
    explained = (matches >= 0).sum(axis=1)
    keep = (explained >= max(2, n - may_be_unexplained(n))) & ~twice
    matches, explained = matches[keep], explained[keep]
    poses = _aligned(model, matches)
    for _ in range(_ROUNDS):
        terms = model.terms(poses, matches, None)
        sums, _ = quadratics(terms)
        constant, gradient, information = sums.of_pose(sums.freed())
        # two landmarks in one place leave the heading open: a step is needed all the same
        ridge = 1e-9 * np.trace(information, axis1=-2, axis2=-1)[:, None, None] * np.eye(3)
        covariance = np.asarray(np.linalg.inv(information + ridge))
        step = (covariance @ gradient[..., None])[..., 0]
        last = np.sum(step * gradient, axis=1)
        step *= np.minimum(1.0, _MAX_TURN_RAD / np.maximum(np.abs(step[:, 2]), 1e-12))[:, None]
        if (last < _CONVERGED).all():
            break
        poses = se2.retract(poses, step)
    peak = terms.log_peak.sum(axis=1)
    if terms.of_shared is not None:
        peak = peak + log_shared(terms.of_shared.sum(axis=1))
    chi2 = 2.0 * (peak - constant)
    good = (last < _CONVERGED) & (chi2 < CHI2_LIMITS[np.minimum(explained - 2, len(CHI2_LIMITS) - 1)])
    heading_variance = covariance[:, 2, 2]
    volume = 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
    # a circle has no more headings than this
    volume -= 0.5 * np.log(np.maximum(heading_variance / (2 * np.pi), 1.0))
    weights = constant + volume
    whole = heading_variance < _MAX_HEADING_SIGMA_RAD**2
    return Fits(matches, poses, covariance, weights, whole).take(np.flatnonzero(good))


def _aligned(model: ScanModel, matches: IntArray) -> FloatArray:
    """(c, 3): rigid alignments of points seen to the landmarks, each point equally certain in all directions."""
    points, covariance = model.points
    seen = points[:, 0] + 1j * points[:, 1]
    there = model.positions[matches] @ np.array([1.0, 1.0j])
    weight = (matches >= 0) / np.trace(covariance, axis1=-2, axis2=-1)
    weight /= weight.sum(axis=1, keepdims=True)
    middle, seen_middle = (weight * there).sum(axis=1), weight @ seen
    turn = (weight * (there - middle[:, None]) * np.conj(seen - seen_middle[:, None])).sum(axis=1)
    turn /= np.maximum(np.abs(turn), 1e-300)
    origin = middle - turn * seen_middle
    return np.stack([origin.real, origin.imag, np.angle(turn)], axis=-1)
