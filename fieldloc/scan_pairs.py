"""What of a scan may be which landmark of the map, from places where the robot may be."""

from typing import NamedTuple

import numpy as np

from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.scan_model import ScanModel
from fieldloc.scan_moments import determinant, turned, upper_of

_FEW = 256  # numbers that are sooner computed with than chosen from


class Pairs(NamedTuple):
    """Observations and landmarks that may belong together, in order of pose and observation, (k,) each.

    x, y: where the landmark is, sensor's frame; ex, ey: less where it was seen, metres; xx, xy, yy: covariance of that,
    of its own error, widened. log_peak: log density of range and bearing without an error, relative to clutter, by the
    covariance that is not widened, plus half the log determinant of (xx, xy, yy): less that of the whole error, it is a
    density again. wider: (n, 2) by how much it is widened, None for not at all.
    """

    pose: IntArray
    row: IntArray
    landmark: IntArray
    x: FloatArray
    y: FloatArray
    ex: FloatArray
    ey: FloatArray
    xx: FloatArray
    xy: FloatArray
    yy: FloatArray
    log_peak: FloatArray
    wider: FloatArray | None


def pairs_of(model: ScanModel, poses: FloatArray, covariances: FloatArray) -> Pairs:
    """What may be what for robots at poses (h, 3) up to covariances (h, 3, 3), by errors that are not widened."""
    x, y = _landmarks_from(model, poses)
    pxx, pxy, pxh, pyy, pyh, phh = upper_of(covariances[:, None])
    xh, yh = y * phh - pxh, x * phh + pyh
    xx = pxx + y * (xh - pxh)
    xy = pxy + x * pxh - y * yh
    yy = pyy + x * (yh + pyh)
    if model.survey is not None:
        sxx, sxy, syy = turned(model.survey, poses[:, 2:])
        xx, xy, yy = xx + sxx, xy + sxy, yy + syy
    pose, row, landmark, seen = _worth_a_look(model, x, y, xx + yy)
    x, y, xx, xy, yy = np.stack([x, y, xx, xy, yy])[:, pose, landmark]
    ex, ey = x - seen[0], y - seen[1]
    # a bearing's error counts by the farther of both ranges
    far = np.maximum(np.hypot(x, y), seen[2])
    xx = xx + seen[5] + far * (seen[11] + far * seen[8])
    xy = xy + seen[6] + far * (seen[12] + far * seen[9])
    yy = yy + seen[7] + far * (seen[13] + far * seen[10])
    keep = (yy * ex - 2.0 * xy * ey) * ex + xx * ey * ey < model.gates[row] * (xx * yy - xy * xy)
    if not keep.all():
        pose, row, landmark = pose[keep], row[keep], landmark[keep]
        x, y, ex, ey = x[keep], y[keep], ex[keep], ey[keep]
    wider = model.widening(row, landmark)
    own = model.own[:, row]
    r = own[2]
    plain = own[5:8] + r * (own[11:14] + r * own[8:11])
    survey: FloatArray | float = 0.0
    if model.survey is not None:
        survey = np.stack(turned(model.survey[landmark], poses[pose, 2]))
        plain += survey
    log_peak = model.log_peak[row] + np.log(r)
    widened = plain
    if wider is not None:
        by_range, by_bearing = wider[row].T
        both = np.sqrt(by_range * by_bearing)
        widened = by_range * own[5:8] + r * (both * own[11:14] + r * by_bearing * own[8:11]) + by_range * survey
        log_peak -= 0.5 * np.log(determinant(plain) / determinant(widened))
    return Pairs(pose, row, landmark, x, y, ex, ey, widened[0], widened[1], widened[2], log_peak, wider)


def _worth_a_look(
    model: ScanModel, x: FloatArray, y: FloatArray, spread: FloatArray
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Poses, observations and landmarks (k,), and `seen` (14, k) of these: all that labels allow, or where they are
    many those in a circle as wide as the widest axis, spread (h, m) and the observation's own, at most."""
    h, (row, landmark) = len(x), model.candidates
    if h * len(row) <= _FEW:
        if h == 1:
            return np.zeros_like(row), row, landmark, model.seen_candidates
        each = np.repeat(np.arange(h), len(row))
        row, landmark = np.tile(row, h), np.tile(landmark, h)
        return each, row, landmark, model.seen[:, row]
    seen_x, seen_y, r, rr, bb = model.seen[:5, :, None]
    far2 = np.maximum((x * x + y * y)[:, None], r * r)
    apart2 = (x[:, None] - seen_x) ** 2 + (y[:, None] - seen_y) ** 2
    near = (apart2 < model.gates[:, None] * (spread[:, None] + rr + far2 * bb)) & model.may
    pose, row, landmark = np.nonzero(near)
    return pose, row, landmark, model.seen[:, row]


def _landmarks_from(model: ScanModel, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """x and y (h, m) of the landmarks in the frames of the poses (h, 3)."""
    dx, dy = model.positions[:, 0] - poses[:, :1], model.positions[:, 1] - poses[:, 1:2]
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    return c * dx + s * dy, c * dy - s * dx
