"""What the solutions of many scans are as factors, at once: as `ScanMixture.chosen` has them one by one.

All scans that see as many landmarks are fitted together, as arrays over scans. What is no clear case (a bend in the
likelihood, landmarks that do not agree, a map that errs) is left to `chosen`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldloc import pose as se2
from fieldloc.factors import Factor, PoseFactor
from fieldloc.fixes.landmarks import FIRST_ORDER, MAX_HEADING_SIGMA_RAD, PROBE_SIGMAS
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.scan_fits import CHI2_LIMITS
from fieldloc.scan_mixture import ScanMixture
from fieldloc.scan_model import ScanModel
from fieldloc.scan_quadratics import quadratics

_ROUNDS = 12
_CONVERGED = 1e-12  # of the last step, in standard deviations squared
_MAX_TURN_RAD = 0.5  # of one step
_RIDGE = 1e-12  # of the information's trace: what leaves a direction open is no clear case
_RANGES = np.array([1.0, 0.0])  # of what is shared: a turn of all bearings turns the robot and nothing else


class _Scans(NamedTuple):
    """k scans of n landmarks each: arrays (k, n, ...) of what was seen and which it is, covariances and what is shared
    widened and as they are; mounts (k, 3) of the sensors."""

    range_bearing: FloatArray
    matches: IntArray
    widened: FloatArray
    plain: FloatArray
    shared_widened: FloatArray
    shared_plain: FloatArray
    mounts: FloatArray


def factors_of(mixtures: Sequence[ScanMixture], solutions: Sequence[int]) -> list[tuple[Factor, ...]]:
    """Of one solution of each."""
    out: list[tuple[Factor, ...]] = [()] * len(mixtures)
    clear = np.array([mixture.model.survey is None for mixture in mixtures], dtype=bool)
    fitted: dict[int, PoseFactor] = {}
    for field in {id(mixture.field_map): mixture.field_map for mixture in mixtures}.values():
        rows = [i for i in np.flatnonzero(clear).tolist() if mixtures[i].field_map is field]
        fitted |= _fitted([mixtures[i] for i in rows], [solutions[i] for i in rows], rows, field.positions)
    for i, (mixture, solution) in enumerate(zip(mixtures, solutions, strict=True)):
        out[i] = (fitted[i],) if i in fitted else mixture.chosen(solution)
    return out


def _fitted(
    mixtures: Sequence[ScanMixture], solutions: Sequence[int], names: Sequence[int], positions: FloatArray
) -> dict[int, PoseFactor]:
    """The clear cases by name."""
    if not mixtures:
        return {}
    matches = [mixture.matches(solution) for mixture, solution in zip(mixtures, solutions, strict=True)]
    every = np.concatenate(matches)
    scan = np.repeat(np.arange(len(matches)), [len(one) for one in matches])
    seen = np.flatnonzero(every >= 0)
    every, scan = every[seen], scan[seen]
    wider = np.stack([mixture.model.wider for mixture in mixtures])[scan, every]
    root = np.sqrt(wider)
    plain = np.concatenate([mixture.model.covariance for mixture in mixtures])[seen]
    widened = plain * root[:, :, None] * root[:, None, :]
    range_bearing = np.concatenate([mixture.model.range_bearing for mixture in mixtures])[seen]
    shared_widened = np.concatenate([mixture.model.shared_widened for mixture in mixtures])[seen]
    shared_plain = np.concatenate([mixture.model.shared_plain for mixture in mixtures])[seen]
    mounts = np.array([mixture.scan.robot_from_sensor for mixture in mixtures])
    counts = np.bincount(scan, minlength=len(mixtures))
    out: dict[int, PoseFactor] = {}
    for count in np.unique(counts[counts >= 2]).tolist():
        those = np.flatnonzero(counts == count)
        rows = np.flatnonzero(counts[scan] == count).reshape(-1, count)
        scans = _Scans(
            range_bearing[rows],
            every[rows],
            widened[rows],
            plain[rows],
            shared_widened[rows],
            shared_plain[rows],
            mounts[those],
        )
        poses, covariances, good = _poses(scans, positions)
        for k in np.flatnonzero(good).tolist():
            stamp_ns = mixtures[those[k]].stamp_ns
            out[names[those[k]]] = PoseFactor(stamp_ns, poses[k].copy(), covariances[k].copy(), by_sight=True)
    return out


def _poses(scans: _Scans, positions: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(k, 3) of the robot, (k, 3, 3) covariances in its frame, and (k,) whether that is all that is to be said."""
    model = _model(scans, positions, scans.widened, scans.shared_widened)
    at = _aligned(scans, positions)
    for _ in range(_ROUNDS):
        _, gradient, information = _at(model, at, scans.matches)
        ridge = _RIDGE * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        covariance = np.linalg.inv(information + ridge)
        step = (covariance @ gradient[..., None])[..., 0]
        last = np.sum(step * gradient, axis=1)
        at = se2.retract(at, step * np.minimum(1.0, _MAX_TURN_RAD / np.maximum(np.abs(step[:, 2:]), 1e-12)))
        if (last < _CONVERGED).all():
            break
    chi2, _, information = _at(model, at, scans.matches)
    ridge = _RIDGE * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    to_robot = se2.adjoint(scans.mounts)
    covariance = to_robot @ np.linalg.inv(information + ridge) @ to_robot.swapaxes(-1, -2)
    poses = se2.compose(at, se2.inverse(scans.mounts))
    in_field = se2.rotate_covariance(covariance, poses[:, 2])
    heading2 = np.maximum(covariance[:, 2, 2], 1e-300)
    bend = np.zeros(len(poses))
    for sigmas in (-PROBE_SIGMAS, PROBE_SIGMAS):
        aside = poses + (sigmas / np.sqrt(heading2))[:, None] * in_field[:, :, 2]
        beyond = _at(model, se2.compose(aside, scans.mounts), scans.matches)[0] - chi2
        bend = np.maximum(bend, np.abs(beyond / PROBE_SIGMAS**2 - 1.0))
    once = _model(scans, positions, scans.plain, scans.shared_plain)
    agree = _at(once, at, scans.matches)[0] < CHI2_LIMITS[min(scans.matches.shape[1] - 2, len(CHI2_LIMITS) - 1)]
    good = (last < _CONVERGED) & (heading2 < MAX_HEADING_SIGMA_RAD**2) & (bend < FIRST_ORDER) & agree
    x, y, _ = scans.mounts.T
    by_turn = scans.shared_widened[:, 0, 1, None] * np.stack([y, -x, np.ones_like(x)], axis=-1)
    return poses, covariance + by_turn[:, :, None] * by_turn[:, None, :], good


def _model(scans: _Scans, positions: FloatArray, covariance: FloatArray, shared: FloatArray) -> ScanModel:
    """All of them as one, of which each is asked for its own matches only; `terms` alone works on it."""
    nothing, m = np.zeros(scans.matches.shape), len(positions)
    may = np.ones((1, m), dtype=bool)
    return ScanModel(
        scans.range_bearing, covariance, may, positions, None, nothing, nothing, np.ones((m, 2)), shared * _RANGES
    )


def _at(model: ScanModel, poses: FloatArray, matches: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """chi2 (k,), gradient (k, 3) and information (k, 3, 3), each from its own pose (k, 3) of the sensor."""
    terms = model.terms(poses, matches, None)
    sums, _ = quadratics(terms._replace(of_shared=None))
    constant, gradient, information = sums.of_pose(sums.freed())
    return 2.0 * (terms.log_peak.sum(axis=1) - constant), gradient, information


def _aligned(scans: _Scans, positions: FloatArray) -> FloatArray:
    """(k, 3): rigid alignments of points seen to the landmarks, each point equally certain in all directions."""
    r, b = scans.range_bearing[..., 0], scans.range_bearing[..., 1]
    seen, there = r * np.exp(1j * b), positions[scans.matches] @ np.array([1.0, 1.0j])
    weight = 1.0 / (scans.widened[..., 0, 0] + r**2 * scans.widened[..., 1, 1])
    weight /= weight.sum(axis=1, keepdims=True)
    middle, seen_middle = (weight * there).sum(axis=1), (weight * seen).sum(axis=1)
    turn = (weight * (there - middle[:, None]) * np.conj(seen - seen_middle[:, None])).sum(axis=1)
    turn /= np.maximum(np.abs(turn), 1e-300)
    origin = middle - turn * seen_middle
    return np.stack([origin.real, origin.imag, np.angle(turn)], axis=-1)
