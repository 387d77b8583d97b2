"""What a solved log's poses have of the errors with which landmarks stand beside their places on the map.

A landmark is as far beside its place in the last scan as in the first, and no number of scans makes that less. So it is
no noise of theirs, but a constant that is not estimated and moves the whole solution (a parameter that is considered:
Schmidt 1966). The solution's covariance grows by K S K^T: S that of the places by the map, K the change of the solution
with them.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.chain import Chain, Recorded
from estimators.chain_engine.considered import Considered
from estimators.chosen import Chosen
from estimators.config import Config
from estimators.copies import Moved
from estimators.solution import Solution
from estimators.surveyed_sights import point_by_tangent
from fieldloc import pose as se2
from fieldloc.factors import Factor, LandmarkFactor, PoseFactor
from fieldloc.field import FieldMap
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.scan_gains import gains
from fieldloc.scan_mixture import ScanMixture

_NOTHING_M = 5e-4  # next to what any sensor sees of a landmark
_AT_ONCE = 250_000  # poses times landmarks: two hundred megabytes


class _Sight(NamedTuple):
    """A scan as it was taken in the end. by: (3,) the symmetry by which the map was moved."""

    node: int
    mixture: ScanMixture
    solution: int
    by: FloatArray
    factors: tuple[Factor, ...]


class _Pulls(NamedTuple):
    """(k,) nodes and landmarks; (k, 3, 2) by how much what was seen there pulls more at the pose that it was seen from,
    robot frame, for each metre that the landmark is moved on the map. noise: (k, 3, 3) what the landmark's place makes
    of the pulls' covariance, as far as scans were read as if it were off anew each time."""

    nodes: IntArray
    landmarks: IntArray
    pulls: FloatArray
    noise: FloatArray


def survey_of(field: FieldMap, sigma_m: float) -> FloatArray:
    """(m, 2, 2) of the landmarks' places; sigma_m where the map says nothing."""
    stated = field.positions_covariance
    return np.where(np.any(stated, axis=(1, 2), keepdims=True), stated, sigma_m**2 * np.eye(2))


def with_survey(
    recorded: Recorded,
    choices: IntArray,
    chosen: Chosen,
    chain: Chain,
    solution: Solution,
    config: Config,
) -> Solution:
    """The same poses, known less well."""
    sights = _sights(recorded, choices, chosen)
    if not sights:
        return solution
    field = sights[0].mixture.field_map
    places = survey_of(field, config.survey.landmark_sigma_m)
    if (np.trace(places, axis1=1, axis2=2) < _NOTHING_M**2).all():
        return solution
    seen_from = chain.seen_from(solution.poses, solution.calibration, solution.sensor)
    nodes, landmarks, pulls, noise = _all_pulls(sights, seen_from, config.graph.cauchy)
    roots = np.linalg.cholesky(places + 1e-18 * np.eye(2))
    covariances, common = solution.covariances.copy(), solution.global_covariance.copy()
    engine = Considered(chain, config, solution)
    if noise.any():  # is in there already
        by_pose, by_common = engine.due_to(nodes, noise)
        covariances, common = covariances - by_pose, common - by_common
    seen = np.unique(landmarks)
    for those in np.array_split(seen, min(len(seen), len(seen) * len(covariances) // _AT_ONCE + 1)):
        rows = np.isin(landmarks, those)
        columns = np.searchsorted(those, landmarks[rows])
        by_pose, by_common = engine.changes(nodes[rows], columns, pulls[rows] @ roots[landmarks[rows]], len(those))
        covariances += by_pose @ by_pose.swapaxes(1, 2)
        common += by_common @ by_common.T
    return replace(solution, covariances=covariances, global_covariance=common)


def _sights(recorded: Recorded, choices: IntArray, chosen: Chosen) -> list[_Sight]:
    out = []
    for index, choice in enumerate(choices.tolist()):
        node, mixture = recorded.mixtures[index]
        still, by = (mixture.still, mixture.by) if isinstance(mixture, Moved) else (mixture, np.zeros(3))
        if choice >= 0 and isinstance(still, ScanMixture) and (factors := chosen(mixture, choice)):
            out.append(_Sight(node, still, choice, by, factors))
    return out


def _all_pulls(sights: Sequence[_Sight], seen_from: FloatArray, cauchy: float) -> _Pulls:
    fixes = [sight for sight in sights if isinstance(sight.factors[0], PoseFactor)]
    others = [sight for sight in sights if isinstance(sight.factors[0], LandmarkFactor)]
    parts = [one(those, seen_from, cauchy) for one, those in ((_of_fixes, fixes), (_one_by_one, others)) if those]
    return _Pulls(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _of_fixes(sights: Sequence[_Sight], seen_from: FloatArray, cauchy: float) -> _Pulls:
    """Of scans whose landmarks are one pose together."""
    nodes, by = np.array([sight.node for sight in sights]), np.array([sight.by for sight in sights])
    at = seen_from[nodes]
    on_map = se2.compose(se2.inverse(by), at)
    found = gains([sight.mixture for sight in sights], [sight.solution for sight in sights], on_map)
    factors = [factor for sight in sights for factor in sight.factors if isinstance(factor, PoseFactor)]
    error = se2.local(np.array([factor.pose for factor in factors]), at)
    slope = se2.right_jacobian_inverse(error)
    weighted = _under_kernel(error, np.array([factor.covariance for factor in factors]), cauchy)
    whole = slope.swapaxes(1, 2) @ weighted @ slope
    pulls = -whole[found.scans] @ found.moves
    noise = _noise(sights[0].mixture.field_map, found.landmarks, pulls, found.as_noise)
    if noise.any():
        of_scan = np.zeros_like(whole)
        np.add.at(of_scan, found.scans, noise)
        # no more than all that a fix knows, which where it bends is not of first order
        share = np.linalg.eigvals(np.linalg.solve(whole, of_scan)).real.max(axis=1)
        noise = noise / np.maximum(1.0, share)[found.scans, None, None]
    return _Pulls(nodes[found.scans], found.landmarks, pulls, noise)


def _one_by_one(sights: Sequence[_Sight], seen_from: FloatArray, cauchy: float) -> _Pulls:
    """Of scans whose landmarks are not."""
    matches = [sight.mixture.matches(sight.solution) for sight in sights]
    factors = [factor for sight in sights for factor in sight.factors if isinstance(factor, LandmarkFactor)]
    scans = np.repeat(np.arange(len(sights)), [len(sight.factors) for sight in sights])
    nodes, by = (np.array(each)[scans] for each in zip(*((sight.node, sight.by) for sight in sights), strict=True))
    at = seen_from[nodes]
    there = se2.apply(se2.inverse(at), np.array([factor.landmark for factor in factors]))
    error = there - np.array([factor.seen for factor in factors])
    slope = point_by_tangent(there)
    weighted = _under_kernel(error, np.array([factor.covariance for factor in factors]), cauchy)
    by_place = se2.rotation(by[:, 2] - at[:, 2])
    models = [sight.mixture.model for sight in sights]
    known = np.array([model.survey is not None for model in models])
    wider = np.concatenate([model.wider[each[each >= 0], 0] for model, each in zip(models, matches, strict=True)])
    landmarks = np.concatenate([each[each >= 0] for each in matches])
    pulls = slope.swapaxes(1, 2) @ weighted @ by_place
    return _Pulls(nodes, landmarks, pulls, _noise(sights[0].mixture.field_map, landmarks, pulls, wider * known[scans]))


def _noise(field: FieldMap, landmarks: IntArray, pulls: FloatArray, wider: FloatArray) -> FloatArray:
    """(k, 3, 3) that places as known to the map have in pulls (k, 3, 2), variances so much wider (k,)."""
    places = field.positions_covariance[landmarks] * wider[:, None, None]
    return np.asarray(pulls @ places @ pulls.swapaxes(1, 2))


def _under_kernel(error: FloatArray, covariance: FloatArray, cauchy: float) -> FloatArray:
    """(k, m, m) information of factors with those errors (k, m)."""
    information = np.linalg.inv(covariance)
    square = np.einsum("ki,kij,kj->k", error, information, error)
    return np.asarray(information / (1.0 + square / cauchy**2)[:, None, None])
