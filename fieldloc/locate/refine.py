"""States fitted to all that is matched, many at a time: robust Gauss-Newton on pixels, the prior as one more term."""

from dataclasses import dataclass

import numpy as np

from fieldloc.locate.errors import Cameras, IntArray, circle_errors, line_errors, post_errors
from fieldloc.locate.matching import Matches, Noise
from fieldloc.locate.prior import CameraPrior
from fieldloc.pose import FloatArray, wrap

_LONGEST = np.array([0.7, 0.7, 0.25, 0.25, 0.12, 0.12])  # a step: metres and radians
_LOWEST_M, _HIGHEST_M = 0.05, 6.0
_STEEPEST_RAD = 1.5
_ANYWHERE = np.array([4.0, 4.0, 1.8])  # standard deviations of a pose that may be any on a field: metres and radians
_ROBUST = 9.0  # chi2 per number from which a thing counts less and less


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """information: (k, 6, 6), gradient: (k, 6) at the states; misfit: (k,) chi2 of all that is matched, prior: (k,) of
    the prior; numbers: (k,) of residuals; log_norm: (k,) log density of all matched at no error."""

    information: FloatArray
    gradient: FloatArray
    misfit: FloatArray
    prior: FloatArray
    numbers: FloatArray
    log_norm: FloatArray

    def take(self, rows: IntArray) -> "Step":
        parts = (self.information, self.gradient, self.misfit, self.prior, self.numbers, self.log_norm)
        return Step(*(part[rows] for part in parts))


def linearise(cameras: Cameras, noise: Noise, matches: Matches, prior: CameraPrior, robust: bool = True) -> Step:
    sight, shape = noise.sight, noise.shape
    count = len(cameras.states)
    weight = np.linalg.inv(prior.covariance)
    off = cameras.states[:, 3:] - prior.mean
    pulled = off @ weight
    information, gradient = np.zeros((count, 6, 6)), np.zeros((count, 6))
    information[:, 3:, 3:] = weight
    information[:, [0, 1, 2], [0, 1, 2]] = _ANYWHERE**-2.0
    gradient[:, 3:] = pulled
    misfit, numbers, log_norm = np.zeros(count), np.zeros(count), np.zeros(count)

    def add(error: FloatArray, jacobian: FloatArray, precision: FloatArray, used: FloatArray, size: FloatArray) -> None:
        """Things (k, n) of m numbers each; used (k, n) is one where they count; size (n,) of numbers that are seen."""
        nonlocal information, gradient, misfit, numbers, log_norm
        whitened = (precision @ error[..., None])[..., 0]
        chi2 = np.sum(whitened * error, axis=-1)
        share = used / (1.0 + np.maximum(chi2 / size - _ROBUST, 0.0) / _ROBUST) if robust else used
        weighted = (np.swapaxes(jacobian, -1, -2) @ precision) * share[..., None, None]
        information = information + (weighted @ jacobian).sum(axis=1)
        gradient = gradient + (weighted @ error[..., None])[..., 0].sum(axis=1)
        misfit = misfit + (used * chi2).sum(axis=1)
        numbers = numbers + (used * size).sum(axis=1)
        log_norm = log_norm + (used * 0.5 * (np.linalg.slogdet(precision)[1] - size * np.log(2.0 * np.pi))).sum(axis=1)

    if (matches.lines >= 0).any():
        error, jacobian, px_per_m = line_errors(cameras, sight, shape, np.maximum(matches.lines, 0))
        model = noise.of_lines(px_per_m)
        a, c = model[..., 0] + sight.line_noise[:, 0, 0], model[..., 1] + sight.line_noise[:, 1, 1]
        b = np.broadcast_to(sight.line_noise[:, 0, 1], a.shape)
        precision = np.stack([c, -b, -b, a], axis=-1).reshape(*a.shape, 2, 2) / (a * c - b * b)[..., None, None]
        used = (matches.lines >= 0).astype(np.float64)
        add(error, jacobian, precision, used, np.full(used.shape[1], 2.0))
    if (matches.posts >= 0).any():
        error, jacobian, _ = post_errors(cameras, sight, shape, np.maximum(matches.posts, 0)[..., None])
        precision = np.broadcast_to(np.linalg.inv(noise.of_posts), (*matches.posts.shape, 6, 6))
        size = np.where(sight.feet.known, 6.0, 4.0)
        add(error[:, :, 0], jacobian[:, :, 0], precision, (matches.posts >= 0).astype(np.float64), size)
    for row, circle in enumerate(shape.circles):
        if not len(sight.circle_rays) or not (matches.circle == row).any():
            continue
        error, jacobian, px_per_m = circle_errors(cameras, sight, circle)
        precision = 1.0 / noise.of_circle(px_per_m)
        used = np.repeat((matches.circle == row)[:, None].astype(np.float64), error.shape[1], axis=1)
        add(error[..., None], jacobian[..., None, :], precision[..., None, None], used, np.ones(error.shape[1]))
    return Step(information, gradient, misfit, np.sum(off * pulled, axis=1), numbers, log_norm)


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
