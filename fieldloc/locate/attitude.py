"""How the camera may be turned, from the picture's straight lines, posts and circle and what is known beforehand.

A field's lines run in two directions (the grid's), its posts in the third. In the camera frame each seen line's plane
contains its direction, so with R = field_from_camera of (heading, pitch, roll) each line gives (R normal) . x = 0 or
(R normal) . y = 0, each edge of a post (R normal) . up = 0: vanishing points and horizon in one robust fit, the heading
modulo 90 degrees. Many starts are fitted at once, as nobody knows which line is of which direction, or of any.

A circle's image is a cone of rays; the two planes that cut a cone in a circle follow from the eigenvectors of its
matrix (Forsyth et al., 1991): up to that choice a circle alone gives the attitude.
"""

from dataclasses import dataclass

import numpy as np

from fieldloc.locate.prior import CameraPrior
from fieldloc.locate.sight import Sight
from fieldloc.locate.states import cross, rotations, turn_axes
from fieldloc.pose import FloatArray

_HEADINGS = np.radians(np.arange(-45.0, 45.0, 10.0))
# In standard deviations. Two lines leave the pitch to the prior, which is two of these off in one picture of 22.
_OFF = np.array([[0.0, 0.0], [-1.2, 0.0], [1.2, 0.0], [-2.2, 0.0], [2.2, 0.0], [0.0, -1.2], [0.0, 1.2]])
_WIDE_PITCHES = np.radians([-15.0, 0.0, 15.0, 30.0, 45.0, 60.0])
_ANNEALED_PX = (25.0, 12.0, 6.0)  # noise that is allowed for, from iteration to iteration, of all starts
_FINE_PX = (2.0, 0.3)  # and then of the best of them
_MOST = 60
_LOOSEST = 4.0  # times; the starts at the prior's own mean keep to it, which lines that are none would pull from it
_MARGIN = 26.0  # so much worse than the best is none: about two lines that have to be left out
_CIRCLE_RAD = np.radians(2.0)  # how well an ellipse shows how the camera is turned
_SAME_RAD = np.radians(1.2)
_LONGEST = 0.2  # a step
_GATE = 25.0  # chi2 up to which a line counts for an attitude


@dataclass(frozen=True, slots=True, eq=False)
class Attitudes:
    """The likeliest first. angles: (a, 3) heading against the grid modulo a quarter turn, pitch, roll. scores: (a,)."""

    angles: FloatArray
    scores: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Planes:
    """normals, middles, alongs: (n, 3) of seen edges; offset_var, turn_var: (n,) of the normal, per px^2 of noise."""

    normals: FloatArray
    middles: FloatArray
    alongs: FloatArray
    offset_var: FloatArray
    turn_var: FloatArray
    noise_px2: FloatArray

    @staticmethod
    def of(rays: FloatArray, noise: FloatArray, focal_px: float) -> "_Planes":
        """rays (n, 2, 3), noise (n,) px^2 of their ends."""
        normals = cross(rays[:, 0], rays[:, 1])
        sine = np.maximum(np.linalg.norm(normals, axis=-1), 1e-6)
        normals = normals / sine[:, None]
        middles = rays.sum(axis=1)
        middles = middles / np.linalg.norm(middles, axis=-1, keepdims=True)
        per_px2 = 1.0 / focal_px**2
        return _Planes(
            normals, middles, cross(normals, middles), np.full(len(sine), 0.5 * per_px2), 2.0 * per_px2 / sine**2, noise
        )

    def variance(self, directions: FloatArray, widen_px: float) -> FloatArray:
        """(k, n) of normal . direction for directions (k, 3) of the camera frame."""
        per_px2 = (
            self.offset_var * (directions @ self.middles.T) ** 2 + self.turn_var * (directions @ self.alongs.T) ** 2
        )
        return np.asarray(per_px2 * (self.noise_px2 + widen_px**2) + 1e-12)


def attitudes(sight: Sight, prior: CameraPrior, most: int = 4) -> Attitudes:
    circles = _of_circle(sight)
    means, sigmas = _starts(prior, circles)
    angles = np.zeros((len(_HEADINGS) * len(means), 3))
    angles[:, 0] = np.tile(_HEADINGS, len(means))
    angles[:, 1:] = np.repeat(means, len(_HEADINGS), axis=0)
    pull = np.repeat(sigmas, len(_HEADINGS), axis=0)
    lines = _Planes.of(sight.line_rays, sight.line_noise.diagonal(axis1=1, axis2=2).mean(axis=1), sight.focal_px)
    edges = sight.post_rays.reshape(-1, 2, 3)
    noise = sight.post_noise.diagonal(axis1=1, axis2=2).reshape(-1, 2).mean(axis=1)
    posts = _Planes.of(edges, noise, sight.focal_px)
    target = angles[:, 1:].copy()
    loose = np.where((target == prior.mean[1:]).all(axis=1), 1.0, _LOOSEST)[:, None]

    def fit(widen_px: float) -> tuple[FloatArray, FloatArray]:
        # while much noise is allowed for the prior is to weigh little more than it will against the lines in the end
        looser = pull * np.clip(widen_px / _FINE_PX[-1], 1.0, loose)
        return _fit(angles, target, looser, sight, lines, posts, widen_px)

    for widen_px in _ANNEALED_PX:
        angles, scores = fit(widen_px)
    best = np.argsort(-scores, kind="stable")[:_MOST]
    angles, target, pull, loose = angles[best], target[best], pull[best], loose[best]
    for widen_px in _FINE_PX:
        angles, _ = fit(widen_px)
    _, scores = fit(_FINE_PX[-1])
    scores = scores + _likely(angles[:, 1:], target, pull, prior, circles)
    angles[:, 0] = (angles[:, 0] + 0.25 * np.pi) % (0.5 * np.pi) - 0.25 * np.pi
    order = np.argsort(-scores, kind="stable")
    order = order[scores[order] > scores[order[0]] - _MARGIN]
    # a line that is none may outweigh a circle: what the circle shows is kept beside what most lines show
    shown = [np.abs(angles[order, 1:] - tilt).max(axis=1) < _CIRCLE_RAD for tilt in circles]
    order = np.concatenate([order[:1], *(order[near][:1] for near in shown), order[1:]])
    off = np.abs(angles[order, None] - angles[order])
    off[..., 0] = np.minimum(off[..., 0], 0.5 * np.pi - off[..., 0])
    same = (off < _SAME_RAD).all(axis=2)
    kept: list[int] = []
    taken = np.zeros(len(order), dtype=np.bool_)
    for i, row in enumerate(order):
        if not taken[i]:
            kept.append(int(row))
            taken |= same[i]
            if len(kept) == most:
                break
    return Attitudes(angles[kept], scores[kept])


def _starts(prior: CameraPrior, circles: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Pitches and rolls (s, 2) to start from, with the standard deviations (s, 2) of what holds them there."""
    mean, sigma = prior.mean[1:], prior.sigmas[1:]
    if sigma[0] < np.radians(8.0):
        means = [mean + sigma * off for off in _OFF]
    else:
        means = [np.array([pitch, mean[1]]) for pitch in _WIDE_PITCHES]
    sigmas = [sigma] * len(means)
    for tilt in circles:
        off = (tilt - mean) / np.hypot(sigma, _CIRCLE_RAD)
        if np.abs(off).max() < 3.5:
            weight = _CIRCLE_RAD**-2 + sigma**-2
            means.append((tilt * _CIRCLE_RAD**-2 + mean * sigma**-2) / weight)
            sigmas.append(weight**-0.5)
    return np.array(means), np.array(sigmas)


def _likely(
    tilts: FloatArray, target: FloatArray, pull: FloatArray, prior: CameraPrior, circles: list[FloatArray]
) -> FloatArray:
    """(k,) log density of tilts (k, 2) under what is known of them and what a circle shows, in place of that under the
    targets that spread their starts."""
    started = (tilts - target) / pull
    off = (tilts - prior.mean[1:]) / prior.sigmas[1:]
    out = 0.5 * (started * started).sum(axis=1) - 0.5 * (off * off).sum(axis=1)
    if circles:
        away = (tilts[:, None] - np.array(circles)) / _CIRCLE_RAD
        out = out + np.maximum(0.5 * _GATE - 0.5 * (away * away).sum(axis=2).min(axis=1), 0.0)
    return np.asarray(out)


def _fit(
    angles: FloatArray,
    target: FloatArray,
    pull: FloatArray,
    sight: Sight,
    lines: _Planes,
    posts: _Planes,
    widen_px: float,
) -> tuple[FloatArray, FloatArray]:
    """One step of Gauss and Newton on from angles (k, 3); and how well they fit (k,)."""
    count = len(angles)
    states = np.zeros((count, 6))
    states[:, 2], states[:, 4:] = angles[:, 0], angles[:, 1:]
    rotation = rotations(states)
    axes = turn_axes(states, rotation)
    across = rotation.transpose(0, 2, 1)
    off = (angles[:, 1:] - target) / pull
    score = -0.5 * (off * off).sum(axis=1)
    jacobians, errors, weights = [], [], []

    def add(turned: FloatArray, error: FloatArray, variance: FloatArray, used: FloatArray) -> None:
        """turned: (k, n, 3) cross products of the planes' normals with the direction that they hold, in the field."""
        nonlocal score
        chi2 = error * error / variance
        jacobians.append(turned @ axes.transpose(0, 2, 1))
        errors.append(error)
        weights.append(used / (variance * (1.0 + chi2 / 9.0) ** 2))
        score = score + 0.5 * (used * np.maximum(_GATE - chi2, 0.0)).sum(axis=1)

    if len(lines.normals):
        normals = lines.normals @ across
        variances = [lines.variance(rotation[:, i], widen_px) for i in (0, 1)]
        along_y = normals[..., 1] ** 2 / variances[1] < normals[..., 0] ** 2 / variances[0]
        variance = np.where(along_y, variances[1], variances[0])
        turned = np.zeros_like(normals)
        turned[..., 0], turned[..., 1] = (
            np.where(along_y, -normals[..., 2], 0.0),
            np.where(along_y, 0.0, normals[..., 2]),
        )
        turned[..., 2] = np.where(along_y, normals[..., 0], -normals[..., 1])
        below = (rotation[:, 2] @ lines.middles.T < -0.01).astype(np.float64)
        error = np.where(along_y, normals[..., 1], normals[..., 0])
        add(turned, error, variance, below * np.minimum(1.0, sight.line_lengths / 40.0))
    if len(posts.normals):
        normals = posts.normals @ across
        turned = np.zeros_like(normals)
        turned[..., 0], turned[..., 1] = normals[..., 1], -normals[..., 0]
        add(turned, normals[..., 2], posts.variance(rotation[:, 2], widen_px), np.full(1, 0.5))
    if not jacobians:
        return angles, score
    jacobian, error, weight = (np.concatenate(parts, axis=1) for parts in (jacobians, errors, weights))
    weighted = (jacobian * weight[..., None]).transpose(0, 2, 1)
    information, gradient = weighted @ jacobian, (weighted @ error[..., None])[..., 0]
    information[:, 0, 0] += 1e-3
    information[:, [1, 2], [1, 2]] += pull**-2.0
    gradient[:, 1:] += off / pull
    step = np.linalg.solve(information, gradient[..., None])[..., 0]
    return angles - np.minimum(np.maximum(step, -_LONGEST), _LONGEST), score


def _of_circle(sight: Sight) -> list[FloatArray]:
    """(pitch, roll) each (2,) that make a circle on the ground of what is seen as one; at most two."""
    if len(sight.circle_rays) < 8 or (sight.circle_rays[:, 2] <= 0.1).any():
        return []
    x, y = (sight.circle_rays[:, :2] / sight.circle_rays[:, 2:]).T
    middle, size = np.array([x.mean(), y.mean()]), float(np.hypot(x.std(), y.std()))
    p, q = (x - middle[0]) / size, (y - middle[1]) / size
    _, _, rows = np.linalg.svd(np.column_stack([p * p, p * q, q * q, p, q, np.ones_like(p)]), full_matrices=False)
    a, b, c, d, e, f = rows[-1]
    conic = np.array([[a, b / 2, d / 2], [b / 2, c, e / 2], [d / 2, e / 2, f]])
    to_unit = np.array([[1.0, 0.0, -middle[0]], [0.0, 1.0, -middle[1]], [0.0, 0.0, size]]) / size
    values, vectors = np.linalg.eigh(to_unit.T @ conic @ to_unit)
    if values[1] < 0.0:  # an ellipse's cone has one negative eigenvalue
        values, vectors = -values[::-1], vectors[:, ::-1]
    if not values[0] < 0.0 < values[1] or values[2] - values[0] <= 0.0:
        return []
    share = np.sqrt(max(values[2] - values[1], 0.0) / (values[2] - values[0]))
    rest = np.sqrt(max(values[1] - values[0], 0.0) / (values[2] - values[0]))
    out = []
    for sign in (1.0, -1.0):
        up = share * vectors[:, 2] + sign * rest * vectors[:, 0]
        if up[1] > 0.0:  # the camera's y is down
            up = -up
        # up in the camera is (-sin(roll) cos(pitch), -cos(roll) cos(pitch), -sin(pitch))
        out.append(np.array([np.arcsin(np.clip(-up[2], -1.0, 1.0)), np.arctan2(-up[0], -up[1])]))
    return out
