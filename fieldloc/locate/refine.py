"""States fitted to all that is matched, many at a time: robust Gauss-Newton on pixels, the prior as one more term."""

from dataclasses import dataclass

import numpy as np

from fieldloc.locate.cameras import COLUMNS, ERROR, FOCAL, Cameras
from fieldloc.locate.circle_errors import circle_rows
from fieldloc.locate.line_errors import line_rows
from fieldloc.locate.matching import CIRCLE_NUMBERS, Matches
from fieldloc.locate.noise import Noise
from fieldloc.locate.post_errors import post_rows
from fieldloc.locate.prior import CameraPrior
from fieldloc.locate.windows import Windows
from fieldloc.pose import FloatArray, wrap

_LONGEST = np.array([0.7, 0.7, 0.25, 0.25, 0.12, 0.12])  # a step: metres and radians
_LOWEST_M, _HIGHEST_M = 0.05, 6.0
_STEEPEST_RAD = 1.5
_ANYWHERE = np.array([4.0, 4.0, 1.8])  # standard deviations of a pose that may be any on a field: metres and radians
_POSE = np.arange(3)
_ROBUST = 9.0  # chi2 per number from which a thing counts less and less


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """information: (k, 6, 6), gradient: (k, 6) at the states; by_focal: (k, 6) the gradient's change with the focal
    length, as a share of it. prior: (k,) chi2 of the prior. numbers: (k,) of what is
    matched."""

    information: FloatArray
    gradient: FloatArray
    by_focal: FloatArray
    prior: FloatArray
    numbers: FloatArray


def linearise(
    cameras: Cameras,
    noise: Noise,
    matches: Matches,
    prior: CameraPrior,
    windows: Windows | None = None,
) -> Step:
    sight, count = noise.sight, len(cameras.states)
    white: list[FloatArray] = []  # rows (k, n, 8) of numbers that are independent
    numbers = np.zeros(count)
    used = (matches.lines >= 0).astype(np.float64)
    if used.any():
        rows, px_per_m = line_rows(cameras, np.maximum(matches.lines, 0))
        share = _whiten_lines(rows, noise, px_per_m, used)
        white.append((rows * share[..., None, None]).reshape(count, -1, COLUMNS))
        numbers += 2.0 * used.sum(axis=1)
    used = (matches.posts >= 0).astype(np.float64)
    if used.any():
        rows = noise.whitening_of_posts(count) @ post_rows(cameras, np.maximum(matches.posts, 0))
        sizes = np.where(sight.feet.known, 6.0, 4.0)
        share = used * _share((rows[..., ERROR] ** 2).sum(axis=-1) / sizes)
        white.append((rows * share[..., None, None]).reshape(count, -1, COLUMNS))
        numbers += used @ sizes
    if len(sight.circle_rays):
        for row_of_map, circle in enumerate(noise.shape.circles):
            used = (matches.circle == row_of_map).astype(np.float64)
            if not used.any():
                continue
            rows, px_per_m = circle_rows(cameras, circle)
            points = rows.shape[1]
            # what is painted off the map is off it together with its neighbours, what noise moves is not
            sigma = np.sqrt(noise.of_circle(px_per_m, max(points / CIRCLE_NUMBERS, 1.0)))
            share = used[:, None] * _share((rows[..., ERROR] / sigma) ** 2) / sigma
            white.append(rows * share[..., None])
            numbers += used * points
    off = cameras.states[:, 3:] - prior.mean
    pulled = off @ prior.precision
    all_rows = np.concatenate(white, axis=1) if white else np.zeros((count, 0, COLUMNS))
    squares = all_rows.transpose(0, 2, 1) @ all_rows
    information, gradient = squares[:, :6, :6], squares[:, :6, ERROR]
    information[:, 3:, 3:] += prior.precision
    information[:, _POSE, _POSE] += _ANYWHERE**-2.0
    gradient[:, 3:] += pulled
    if windows is not None:
        row, away = windows.rows, windows.off(cameras.states)
        information[:, :2, :2] += row[:, :, None] * row[:, None, :]
        gradient[:, :2] += row * away[:, None]
    return Step(information, gradient, squares[:, :6, FOCAL], (off * pulled).sum(axis=1), numbers)


def _share(chi2: FloatArray) -> FloatArray:
    """By how much things count whose squared residuals are so large per number."""
    return 1.0 / np.sqrt(1.0 + np.maximum(chi2 - _ROBUST, 0.0) / _ROBUST)


def _whiten_lines(rows: FloatArray, noise: Noise, px_per_m: FloatArray, used: FloatArray) -> FloatArray:
    """Makes rows (k, l, 2, 2, 8) of lines' ends and widths white, in place. Returns by how much these count
    (k, l, 2)."""
    sight = noise.sight
    variances, together = np.empty((*used.shape, 2, 2)), np.empty((*used.shape, 2))
    variances[:, :, 0] = noise.of_lines(px_per_m) + sight.line_variances
    together[..., 0] = sight.line_noise[:, 0, 1]
    known, own, common = noise.of_widths
    both = np.empty((*used.shape, 2))
    both[..., 0], both[..., 1] = used, used * known
    # one brush painted all lines of a field: that it is too wide is seen as often as there are lines, and is one error
    often = np.maximum(both[..., 1].sum(axis=1), 1.0)[:, None, None]
    together[..., 1] = often[..., 0] * common.min(axis=1)
    variances[:, :, 1] = own + often * common
    # the lower Cholesky factor of [[a, b], [b, c]], row by row
    a = np.sqrt(variances[..., 0])
    b = together / a
    c = np.sqrt(variances[..., 1] - b * b)
    rows[..., 0, :] /= a[..., None]
    rows[..., 1, :] -= b[..., None] * rows[..., 0, :]
    rows[..., 1, :] /= c[..., None]
    chi2 = (rows[..., ERROR] ** 2).sum(axis=-1)
    chi2[..., 0] *= 0.5
    return both * _share(chi2)


def stepped(states: FloatArray, step: Step) -> FloatArray:
    """One Gauss-Newton step on, no longer than a linearisation is good for."""
    move = np.linalg.solve(step.information, step.gradient[..., None])[..., 0]
    longest = np.max(np.abs(move) / _LONGEST, axis=1, keepdims=True)
    out = np.asarray(states - move / np.maximum(longest, 1.0))
    out[:, 2] = wrap(out[:, 2])
    out[:, 3] = np.clip(out[:, 3], _LOWEST_M, _HIGHEST_M)
    out[:, 4] = np.clip(out[:, 4], -_STEEPEST_RAD, _STEEPEST_RAD)
    out[:, 5] = wrap(out[:, 5])
    return out
