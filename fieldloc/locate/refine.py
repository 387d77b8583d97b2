"""States fitted to all that is matched, many at a time: robust Gauss-Newton on pixels, the prior as one more term."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.locate.errors import (
    Cameras,
    circle_errors,
    circle_jacobians,
    line_errors,
    post_errors,
    post_jacobians,
)
from fieldloc.locate.matching import CIRCLE_NUMBERS, Matches, Noise
from fieldloc.locate.prior import CameraPrior
from fieldloc.locate.windows import Windows
from fieldloc.pose import FloatArray, wrap

_LONGEST = np.array([0.7, 0.7, 0.25, 0.25, 0.12, 0.12])  # a step: metres and radians
_LOWEST_M, _HIGHEST_M = 0.05, 6.0
_STEEPEST_RAD = 1.5
_ANYWHERE = np.array([4.0, 4.0, 1.8])  # standard deviations of a pose that may be any on a field: metres and radians
_LEAST_WIDTH_PX = 4.0  # of a line whose width says how far it is: blur makes thin ones wider
_BLUR_PX = 0.5  # by which light and a lens make white wider than it is
_UNEVEN, _PAINTED = 0.05, 0.12  # share by which a line's width changes along it, and by which all of a field's are off
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
    robust: bool = True,
) -> Step:
    sight, shape = noise.sight, noise.shape
    count = len(cameras.states)
    white: list[FloatArray] = []  # Jacobians (k, n, 7) and errors (k, n) of numbers that are independent
    errors: list[FloatArray] = []
    numbers = np.zeros(count)

    def add(error: FloatArray, jacobian: FloatArray, used: FloatArray, size: FloatArray) -> None:
        """Whitened things (k, n, m) and (k, n, m, 7); used (k, n) is one where they count; size (n,) of numbers."""
        nonlocal numbers
        share = used
        if robust:
            chi2 = (error * error).sum(axis=-1)
            share = used / np.sqrt(1.0 + np.maximum(chi2 / np.maximum(size, 1.0) - _ROBUST, 0.0) / _ROBUST)
        errors.append((error * share[..., None]).reshape(count, -1))
        white.append((jacobian * share[..., None, None]).reshape(count, -1, 7))
        numbers = numbers + used @ size

    used = (matches.lines >= 0).astype(np.float64)
    if used.any():
        error, jacobian, px_per_m = line_errors(cameras, np.maximum(matches.lines, 0))
        variances, together, known = _line_noise(noise, px_per_m, used)
        # the lower Cholesky factor of [[a, b], [b, c]], row by row
        a = np.sqrt(variances[..., 0])
        b = together / a
        c = np.sqrt(variances[..., 1] - b * b)
        error[..., 0] /= a
        error[..., 1] = (error[..., 1] - b * error[..., 0]) / c
        jacobian[..., 0, :] /= a[..., None]
        jacobian[..., 1, :] = (jacobian[..., 1, :] - b[..., None] * jacobian[..., 0, :]) / c[..., None]
        error[:, ~known, 1] = 0.0
        both = np.repeat(used, 2, axis=1)
        both[:, 1::2] *= known
        sizes = np.tile([2.0, 0.0], used.shape[1])  # widths determine no pose beside their lines
        add(error.reshape(count, -1, 2), jacobian.reshape(count, -1, 2, 7), both, sizes)
    used = (matches.posts >= 0).astype(np.float64)
    if used.any():
        row = np.maximum(matches.posts, 0)[..., None]
        error, _ = post_errors(cameras, row)
        jacobian = post_jacobians(cameras, row)
        whitening = noise.whitening_of_posts
        add(
            (whitening @ error[:, :, 0, :, None])[..., 0],
            whitening @ jacobian[:, :, 0],
            used,
            np.where(sight.feet.known, 6.0, 4.0),
        )
    for row_of_map, circle in enumerate(shape.circles):
        used = (matches.circle == row_of_map).astype(np.float64)
        if not used.any():
            continue
        error, px_per_m = circle_errors(cameras, circle)
        jacobian = circle_jacobians(cameras, circle)
        points = error.shape[1]
        # neighbours on an ellipse are off it together
        sigma = np.sqrt(noise.of_circle(px_per_m) * max(points / CIRCLE_NUMBERS, 1.0))
        each = np.repeat(used[:, None], points, axis=1)
        add((error / sigma)[..., None], (jacobian / sigma[..., None])[..., None, :], each, np.ones(points))

    off = cameras.states[:, 3:] - prior.mean
    pulled = off @ prior.precision
    information, gradient, by_focal = np.zeros((count, 6, 6)), np.zeros((count, 6)), np.zeros((count, 6))
    information[:, 3:, 3:] = prior.precision
    information[:, [0, 1, 2], [0, 1, 2]] = _ANYWHERE**-2.0
    gradient[:, 3:] = pulled
    if windows is not None:
        row, away = windows.rows, windows.off(cameras.states)
        information[:, :2, :2] += row[:, :, None] * row[:, None, :]
        gradient[:, :2] += row * away[:, None]
    if white:
        rows, residuals = np.concatenate(white, axis=1), np.concatenate(errors, axis=1)
        across = np.swapaxes(rows, 1, 2)
        squares, pull = across @ rows, (across @ residuals[..., None])[..., 0]
        information += squares[:, :6, :6]
        gradient += pull[:, :6]
        by_focal = squares[:, :6, 6]
    return Step(information, gradient, by_focal, np.einsum("ki,ki->k", off, pulled), numbers)


def _line_noise(
    noise: Noise, px_per_m: FloatArray, used: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Variances (k, l, 2, 2) of lines' ends, px^2, and of the logarithms of their widths there; covariances (k, l, 2)
    of one end with the other; whether the widths count (l,)."""
    sight = noise.sight
    variances, together = np.empty((*used.shape, 2, 2)), np.empty((*used.shape, 2))
    variances[:, :, 0] = noise.of_lines(px_per_m) + sight.line_noise.diagonal(axis1=1, axis2=2)
    together[..., 0] = sight.line_noise[:, 0, 1]
    known = np.asarray(
        np.isfinite(sight.widths).all(axis=1) & (np.nan_to_num(sight.widths).min(axis=1) > _LEAST_WIDTH_PX)
    )
    widths, sigmas = np.where(known[:, None], sight.widths, 1.0), np.where(known[:, None], sight.width_sigmas, 1.0)
    own = (sigmas**2 + _BLUR_PX**2 + noise.widen_px**2) / widths**2 + _UNEVEN**2
    # one brush painted all lines of a field: that it is too wide is seen as often as there are lines, and is one error
    together[..., 1] = np.maximum((used * known).sum(axis=1), 1.0)[:, None] * _PAINTED**2
    variances[:, :, 1] = own + together[..., 1, None]
    return variances, together, known


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
