"""From one picture's detections to every pose of the camera that explains them, with probabilities."""

import math

import numpy as np

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.lens import Mask
from fieldloc.locate.attitude import attitudes
from fieldloc.locate.candidates import candidates
from fieldloc.locate.hypotheses import Hypothesis, Located
from fieldloc.locate.matching import Matches
from fieldloc.locate.prior import CameraPrior
from fieldloc.locate.refine import linearise, stepped
from fieldloc.locate.settings import LocateSettings
from fieldloc.locate.settle import Settled, settle
from fieldloc.locate.shape import shape_of
from fieldloc.locate.sight import sight_of
from fieldloc.locate.task import Task
from fieldloc.pose import FloatArray
from fieldloc.vision.detections import Detections

_STAGES = ((10.0, 35.0, 2), (2.0, 30.0, 3), (0.0, 20.0, 1))
"""By how much states may be off, px; so much worse than the best is hopeless; how often they are fitted."""
_SHARPER = 0.25
_DOUBTING = (
    1  # from that stage on so many of the states are fitted without their posts, and without one line each, too:
)
_POSTS_DOUBTED, _LINES_DOUBTED, _FEW_LINES = 4, 12, 2
_NEGLIGIBLE = 1e-4
_HOPELESS = 0.01  # all poses together: specks line up by chance somewhere


def locate(
    detections: Detections,
    camera: Camera,
    field: FieldMap,
    prior: CameraPrior | None = None,
    settings: LocateSettings | None = None,
) -> Located:
    """All poses worth a probability of 1e-4; none where what was detected is hardly explained by anything on the map.

    The map's symmetries give twins of equal probability. prior: of height, pitch and roll, wide if not given.
    """
    prior, settings = prior or CameraPrior.told(), settings or LocateSettings()
    task = Task(sight_of(detections, camera), shape_of(field), prior, settings)
    states = candidates(task.sight, task.shape, prior, attitudes(task.sight, prior).angles)
    if not len(states):
        return Located((), 1.0)
    settled = settle(task, *_refined(task, states))
    rows = task.best(settled.states, settled.log_evidence, settings.hypotheses, np.inf)
    return _answer(task, settled, rows, detections)


def _refined(task: Task, states: FloatArray) -> tuple[FloatArray, Matches]:
    """Matched with ever less tolerance, and fitted; those that are left at the end."""
    doubted = np.zeros(len(states), dtype=np.bool_)
    matches = Matches.none()
    for stage, (widen_px, margin, times) in enumerate(_STAGES):
        if widen_px == 0.0:
            doubted[:] = False
        matches, scores = task.matched(states, widen_px, doubted)
        rows = task.best(states, scores, task.settings.candidates, margin, doubted)
        doubted, states, matches = doubted[rows], states[rows], matches.take(rows)
        if stage == _DOUBTING:
            states, matches, doubted = _with_doubts(states, matches)
        # who is who is seen with tolerance, but where that is weighs against the prior as it will in the end
        sharp = task.noise(_SHARPER * widen_px)
        for _ in range(times):
            states = stepped(states, linearise(task.cameras(states), sharp, matches, task.prior))
    return states, matches


def _with_doubts(states: FloatArray, matches: Matches) -> tuple[FloatArray, Matches, Mask]:
    """The states, and the best of them once more without posts or without one of their lines: what stands beside the
    field and looks like a post, and a line taken for its neighbour, keep a fit from where all else would have it. And
    which of them are without posts."""
    posts = np.flatnonzero((matches.posts[:_POSTS_DOUBTED] >= 0).any(axis=1))
    used = matches.lines[:_LINES_DOUBTED] >= 0
    lines, which = np.nonzero(used & (used.sum(axis=1, keepdims=True) > _FEW_LINES))
    rows = np.concatenate([np.arange(len(states)), posts, lines])
    doubted = np.zeros(len(rows), dtype=np.bool_)
    doubted[len(states) : len(states) + len(posts)] = True
    again = matches.take(rows).without_posts(doubted)
    return states[rows], again.without_lines(np.arange(len(rows) - len(lines), len(rows)), which), doubted


def _log_false(task: Task) -> float:
    """Log probability that all that was detected is none of the map's though the picture is of it: gains are beside
    that, while in a picture of something else all of it is false anyway."""
    sight, settings = task.sight, task.settings
    return (
        len(sight.line_rows) * math.log(settings.false_line)
        + len(sight.post_rows) * math.log(settings.false_post)
        + (math.log(settings.false_circle) if len(sight.circle_rays) else 0.0)
    )


def _answer(task: Task, settled: Settled, kept: np.ndarray[tuple[int], np.dtype[np.intp]], seen: Detections) -> Located:
    settings = task.settings
    twins = np.concatenate([np.zeros((1, 3)), task.shape.symmetries])
    log_right = settings.trust * (settled.log_evidence[kept] + _log_false(task)) + np.log1p(-settings.none_right)
    logs = np.append(log_right, np.log(settings.none_right))
    shares = np.exp(logs - np.logaddexp.reduce(logs))
    if shares[-1] > 1.0 - _HOPELESS:
        return Located((), 1.0)
    kept = kept[shares[:-1] >= _NEGLIGIBLE]
    states, covariances, matches = settled.states[kept], settled.covariances[kept], settled.matches.take(kept)
    lines = np.full((len(kept), len(seen.lines)), -1, dtype=np.intp)
    lines[:, task.sight.line_rows] = matches.lines
    posts = np.full((len(kept), len(seen.posts)), -1, dtype=np.intp)
    posts[:, task.sight.post_rows] = matches.posts
    turns = np.tile(np.eye(6), (len(twins), 1, 1))
    turns[:, :2, :2] = se2.rotation(twins[:, 2])
    turned = turns @ covariances[:, None] @ turns.transpose(0, 2, 1)
    poses = se2.compose(twins, states[:, None, :3])
    found = []
    for row, share in enumerate(shares[:-1][shares[:-1] >= _NEGLIGIBLE]):
        height_m, pitch_rad, roll_rad = states[row, 3:].tolist()
        for pose, full in zip(poses[row], turned[row], strict=True):
            found.append(
                Hypothesis(
                    pose,
                    full[:3, :3],
                    float(share) / len(twins),
                    height_m,
                    pitch_rad,
                    roll_rad,
                    full,
                    lines[row],
                    posts[row],
                    int(matches.circle[row]),
                    float(settled.log_evidence[kept[row]]),
                )
            )
    return Located(tuple(found), float(1.0 - sum(one.probability for one in found)))
