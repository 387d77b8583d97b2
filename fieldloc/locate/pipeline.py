"""From one picture's detections to every pose of the camera that explains them, with probabilities."""

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.locate.attitude import attitudes
from fieldloc.locate.candidates import candidates
from fieldloc.locate.errors import Cameras
from fieldloc.locate.evidence import log_missed
from fieldloc.locate.hypotheses import Hypothesis, Located
from fieldloc.locate.matching import Matches, Noise, match
from fieldloc.locate.prior import CameraPrior
from fieldloc.locate.refine import Step, linearise, stepped
from fieldloc.locate.settings import LocateSettings
from fieldloc.locate.shape import Shape, shape_of
from fieldloc.locate.sight import Sight, sight_of
from fieldloc.pose import FloatArray
from fieldloc.vision.detections import Detections

_ROUGH_PX = 12.0  # by how much candidates are off
_ANNEALED_PX = (12.0, 8.0, 4.0, 2.0, 1.0)  # by how much they may be off, step by step
_SHARPER = 0.1
_LAST_STEPS = 3
_SETTLING = 2
_HOPELESS = 25.0  # so much less evidence than the best has no share worth telling
_SCALES = (0.003, 0.03, 0.2, 1.0, 5.0)  # of the model's noise, as variances: what residuals decide
_SAME_M, _SAME_RAD = 0.1, 0.03
_LEAST_NUMBERS = 4  # of a pose, height and attitude known somewhat
_UNKNOWN = np.array([1.5, 1.5, 0.5])  # standard deviations of what is no pose any more
_LOG_2PI = float(np.log(2.0 * np.pi))
_NEGLIGIBLE = 1e-4


def locate(
    detections: Detections,
    camera: Camera,
    field: FieldMap,
    prior: CameraPrior | None = None,
    settings: LocateSettings | None = None,
) -> Located:
    """All poses worth a probability of 1e-4; none where nothing on the map explains what was detected.

    The map's symmetries give twins of equal probability. prior: of height, pitch and roll, wide if not given.
    """
    prior, settings = prior or CameraPrior.told(), settings or LocateSettings()
    sight, shape = sight_of(detections, camera), shape_of(field)
    states = candidates(sight, shape, prior, attitudes(sight, prior).angles)
    if not len(states):
        return Located((), 1.0)
    states = _likeliest(states, sight, shape, prior, settings)
    for widen_px in _ANNEALED_PX:
        ones = np.ones(len(states))
        cameras = Cameras.at(states)
        matches = match(cameras, Noise(sight, shape, settings, widen_px, ones))
        # who is who is seen with tolerance, but where that is weighs against the prior as it will in the end
        sharp = Noise(sight, shape, settings, _SHARPER * widen_px, ones)
        states = stepped(states, linearise(cameras, sharp, matches, prior, robust=False))
    noise = Noise(sight, shape, settings, 1.0, np.ones(len(states)))
    scores = match(Cameras.at(states), noise).gains - 0.5 * _pull(states, prior)
    states = states[_distinct(states, scores, shape, settings.hypotheses)]
    noise = Noise(sight, shape, settings, 0.0, np.ones(len(states)))
    for _ in range(_LAST_STEPS):
        states, _, _ = _improved(states, noise, prior)
    noise = Noise(sight, shape, settings, 0.0, np.ones(len(states)))
    scores = match(Cameras.at(states), noise).gains - 0.5 * _pull(states, prior)
    states = states[scores > scores.max() - _HOPELESS]
    states, covariances, matches, step, log_evidence = _settled(states, sight, shape, prior, settings)
    sigmas = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    enough = (step.numbers >= _LEAST_NUMBERS) & (sigmas[:, :3] < _UNKNOWN).all(axis=1)
    states, log_evidence, covariances = states[enough], log_evidence[enough], covariances[enough]
    rows = np.flatnonzero(enough)
    return _answer(states, covariances, log_evidence, matches, rows, sight, detections, shape, settings)


def _improved(states: FloatArray, noise: Noise, prior: CameraPrior) -> tuple[FloatArray, Matches, Step]:
    """One matching and one step on."""
    cameras = Cameras.at(states)
    matches = match(cameras, noise)
    step = linearise(cameras, noise, matches, prior)
    return stepped(states, step), matches, step


def _likeliest(
    states: FloatArray, sight: Sight, shape: Shape, prior: CameraPrior, settings: LocateSettings
) -> FloatArray:
    noise = Noise(sight, shape, settings, _ROUGH_PX, np.ones(len(states)))
    scores = match(Cameras.at(states), noise).gains - 0.5 * _pull(states, prior)
    return states[_distinct(states, scores, shape, settings.candidates)]


def _pull(states: FloatArray, prior: CameraPrior) -> FloatArray:
    off = states[:, 3:] - prior.mean
    return np.asarray(np.sum(off @ np.linalg.inv(prior.covariance) * off, axis=1))


def _distinct(states: FloatArray, scores: FloatArray, shape: Shape, most: int) -> NDArray[np.intp]:
    """Rows of the best, no two of which are the same place or its twin."""
    order = np.argsort(-scores, kind="stable")
    poses = states[order, :3]
    kept: list[int] = []
    taken = np.zeros(len(order), dtype=np.bool_)
    for i in range(len(order)):
        if taken[i] or not np.isfinite(scores[order[i]]):
            continue
        kept.append(int(order[i]))
        if len(kept) == most:
            break
        for twin in (poses[i], *se2.compose(shape.symmetries, poses[i])):
            off = np.hypot(poses[:, 0] - twin[0], poses[:, 1] - twin[1])
            taken |= (off < _SAME_M) & (np.abs(se2.wrap(poses[:, 2] - twin[2])) < _SAME_RAD)
    return np.array(kept, dtype=np.intp)


def _settled(
    states: FloatArray, sight: Sight, shape: Shape, prior: CameraPrior, settings: LocateSettings
) -> tuple[FloatArray, FloatArray, Matches, Step, FloatArray]:
    """States, covariances (k, 6, 6) and log evidence (k,), over all amounts of the model's noise that the residuals
    allow: each amount has its own fit and evidence, and what few residuals cannot tell stays open."""
    count, amounts = len(states), len(_SCALES)
    noise = Noise(sight, shape, settings, 0.0, np.tile(_SCALES, count))
    fitted = np.repeat(states, amounts, axis=0)
    for _ in range(_SETTLING):
        fitted, _, _ = _improved(fitted, noise, prior)
    cameras = Cameras.at(fitted)
    matches = match(cameras, noise)
    step = linearise(cameras, noise, matches, prior)
    covariances = np.linalg.inv(step.information)
    log_prior = 0.5 * np.linalg.slogdet(np.linalg.inv(prior.covariance))[1] - 1.5 * _LOG_2PI - 0.5 * step.prior
    log_volume = 3.0 * _LOG_2PI + 0.5 * np.linalg.slogdet(covariances)[1]
    inside = ((fitted[:, :2] > shape.box[:2]) & (fitted[:, :2] < shape.box[2:])).all(axis=1)
    logs = matches.gains + log_prior + log_volume - np.log(shape.area_m2 * 2.0 * np.pi) - np.log(amounts)
    inside &= step.numbers >= _LEAST_NUMBERS
    logs = np.where(inside, logs + log_missed(cameras, sight, shape, matches, settings), -np.inf).reshape(
        count, amounts
    )
    best = np.argmax(logs, axis=1)
    log_evidence = np.logaddexp.reduce(logs, axis=1)
    shares = np.exp(logs - np.maximum(log_evidence, -1e9)[:, None])
    rows = np.arange(count) * amounts + best
    off = fitted.reshape(count, amounts, 6) - fitted[rows][:, None]
    off[..., [2, 5]] = se2.wrap(off[..., [2, 5]])
    second = covariances.reshape(count, amounts, 6, 6) + off[..., None] * off[..., None, :]
    return fitted[rows], np.einsum("ks,ksij->kij", shares, second), matches.take(rows), step.take(rows), log_evidence


def _answer(
    states: FloatArray,
    covariances: FloatArray,
    log_evidence: FloatArray,
    matches: Matches,
    rows: NDArray[np.intp],
    sight: Sight,
    detections: Detections,
    shape: Shape,
    settings: LocateSettings,
) -> Located:
    kept = _distinct(states, log_evidence, shape, settings.hypotheses)
    twins = np.concatenate([np.zeros((1, 3)), shape.symmetries])
    logs = np.append(settings.trust * log_evidence[kept] + np.log1p(-settings.none_right), np.log(settings.none_right))
    shares = np.exp(logs - np.logaddexp.reduce(logs))
    found = []
    for share, row in zip(shares, kept, strict=False):
        if share < _NEGLIGIBLE:
            continue
        lines = np.full(len(detections.lines), -1, dtype=np.intp)
        lines[sight.line_rows] = matches.lines[rows[row]]
        posts = np.full(len(detections.posts), -1, dtype=np.intp)
        posts[sight.post_rows] = matches.posts[rows[row]]
        for twin in twins:
            turn = np.eye(6)
            turn[:2, :2] = se2.rotation(twin[2])
            full = turn @ covariances[row] @ turn.T
            pose = se2.compose(twin, states[row, :3])
            found.append(
                Hypothesis(
                    pose,
                    full[:3, :3],
                    float(share) / len(twins),
                    float(states[row, 3]),
                    float(states[row, 4]),
                    float(states[row, 5]),
                    full,
                    lines,
                    posts,
                    int(matches.circle[rows[row]]),
                    float(log_evidence[row]),
                )
            )
    return Located(tuple(found), float(1.0 - sum(one.probability for one in found)))
