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
_LAST_STEPS = 4
_SCALES = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0)  # of the model's noise, as variances: what residuals decide
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
        states, _, _ = _improved(states, Noise(sight, shape, settings, widen_px, np.ones(len(states))), prior)
    noise = Noise(sight, shape, settings, 1.0, np.ones(len(states)))
    scores = match(Cameras.at(states), noise).gains - 0.5 * _pull(states, prior)
    states = states[_distinct(states, scores, shape, settings.hypotheses)]
    noise = Noise(sight, shape, settings, 0.0, np.ones(len(states)))
    for _ in range(_LAST_STEPS):
        states, _, _ = _improved(states, noise, prior)
    states, matches, step, log_evidence = _settled(states, sight, shape, prior, settings)
    covariances = np.asarray(np.linalg.inv(step.information), dtype=np.float64)
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
) -> tuple[FloatArray, Matches, Step, FloatArray]:
    """With the model's noise that each one's residuals speak for; log evidence (k,)."""
    cameras = Cameras.at(states)
    gains = np.stack(
        [match(cameras, Noise(sight, shape, settings, 0.0, np.full(len(states), scale))).gains for scale in _SCALES]
    )
    scale = np.array(_SCALES)[np.argmax(gains, axis=0)]
    noise = Noise(sight, shape, settings, 0.0, scale)
    for _ in range(2):
        states, _, _ = _improved(states, noise, prior)
    cameras = Cameras.at(states)
    matches = match(cameras, noise)
    step = linearise(cameras, noise, matches, prior)
    log_prior = 0.5 * (np.linalg.slogdet(np.linalg.inv(prior.covariance))[1] - 3.0 * _LOG_2PI) - 0.5 * step.prior
    log_volume = 3.0 * _LOG_2PI - 0.5 * np.linalg.slogdet(step.information)[1]
    log_anywhere = -np.log(shape.area_m2 * 2.0 * np.pi)
    log_missing = log_missed(cameras, sight, shape, matches, settings)
    inside = (states[:, :2] > shape.box[:2]) & (states[:, :2] < shape.box[2:])
    log_evidence = matches.gains + log_prior + log_volume + log_anywhere + log_missing
    return states, matches, step, np.where(inside.all(axis=1), log_evidence, -np.inf)


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
