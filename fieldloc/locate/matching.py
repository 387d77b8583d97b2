"""Which of the map's things each thing seen is, at k states: log density as that, less log density as none of them.

What is none of the map's is anywhere: a line's two ends across it anywhere in the picture, a post's edges and foot too.
So gains of different things add up and compare, and a gain below zero is no match.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fieldloc.locate.cameras import Cameras, IntArray
from fieldloc.locate.circle_errors import circle_errors
from fieldloc.locate.line_errors import Lines
from fieldloc.locate.noise import Noise
from fieldloc.locate.post_errors import post_errors
from fieldloc.locate.widths import widths_fit
from fieldloc.pose import FloatArray

ARC = -2  # the match of a line that is a piece of a circle: explained, but of no use
_LOG_2PI = math.log(2.0 * math.pi)
_NEAR_PX = 40.0  # what is farther off is not that line, however bad the map
_OVER_M, _OVER_PX = 0.08, 4.0  # by how much an end is found beyond the line's
_ARC_PX = 3.0  # by how much a straight piece of a circle's line is off it
_LOG_POST = -float(np.log(640.0 * 60.0 * 20.0 * 20.0))  # place, width, and the lean of either edge
_LOG_FOOT = -float(np.log(480.0 * 10.0))
CIRCLE_NUMBERS = 5.0  # of an ellipse: so many points of it say something of their own


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """lines (k, l), posts (k, p): row of the map, -1 for none of it, ARC for a piece of a circle's line; circle (k,)
    whether it is the map's `circles`.
    gains of each of these, zero where there is no match."""

    lines: IntArray
    line_gains: FloatArray
    posts: IntArray
    post_gains: FloatArray
    circle: IntArray
    circle_gains: FloatArray

    @staticmethod
    def none() -> "Matches":
        whole, share = np.zeros((0, 0), dtype=np.intp), np.zeros((0, 0))
        return Matches(whole, share, whole, share, whole.ravel(), share.ravel())

    def take(self, rows: IntArray) -> "Matches":
        return Matches(
            self.lines[rows],
            self.line_gains[rows],
            self.posts[rows],
            self.post_gains[rows],
            self.circle[rows],
            self.circle_gains[rows],
        )

    def without_posts(self, rows: NDArray[np.bool_]) -> "Matches":
        """In rows (k,) no post is matched."""
        posts, gains = np.where(rows[:, None], -1, self.posts), np.where(rows[:, None], 0.0, self.post_gains)
        return replace(self, posts=posts, post_gains=gains)

    def without_lines(self, rows: IntArray, which: IntArray) -> "Matches":
        """In rows (n,) the line of that number (n,) is not matched."""
        lines, gains = self.lines.copy(), self.line_gains.copy()
        lines[rows, which], gains[rows, which] = -1, 0.0
        return replace(self, lines=lines, line_gains=gains)

    def and_also(self, other: "Matches") -> "Matches":
        return Matches(
            np.concatenate([self.lines, other.lines]),
            np.concatenate([self.line_gains, other.line_gains]),
            np.concatenate([self.posts, other.posts]),
            np.concatenate([self.post_gains, other.post_gains]),
            np.concatenate([self.circle, other.circle]),
            np.concatenate([self.circle_gains, other.circle_gains]),
        )

    @property
    def gains(self) -> FloatArray:
        return np.asarray(self.line_gains.sum(axis=1) + self.post_gains.sum(axis=1) + self.circle_gains)


def match(cameras: Cameras, noise: Noise) -> Matches:
    lines, line_gains = _match_lines(cameras, noise)
    posts, post_gains = _match_posts(cameras, noise)
    circle, circle_gains = _match_circle(cameras, noise)
    return Matches(lines, line_gains, posts, post_gains, circle, circle_gains)


def _match_lines(cameras: Cameras, noise: Noise) -> tuple[IntArray, FloatArray]:
    sight, shape, settings = noise.sight, noise.shape, noise.settings
    count, lines = len(cameras.states), len(sight.line_rays)
    if not lines or not len(shape.starts):
        return np.full((count, lines), -1), np.zeros((count, lines))
    seen = Lines.of(cameras)
    below = seen.down > 1e-3
    before = below[:, :, 0] & below[:, :, 1]
    down = np.maximum(seen.down, 1e-3)
    reach = cameras.centre[:, 2, None, None] / down
    ground = cameras.centre[:, None, None, :2] + reach[..., None] * seen.rays[..., :2]
    m_per_px = reach / (down * sight.focal_px)
    # most lines of the map are far from what is seen: only of the others one has to know how far
    near = np.abs(seen.off) < (_NEAR_PX + 4.0 * noise.widen_px) * np.abs(seen.slope)
    row, column, mark = np.nonzero(near[:, :, 0] & near[:, :, 1] & before[..., None])
    off, slope = seen.off[row, column, :, mark], seen.slope[row, column, :, mark]
    variance = noise.at(row, np.abs(seen.down[row, column] / slope)) + sight.line_variances[column]
    together = sight.line_noise[column, 0, 1]
    determinant = variance[:, 0] * variance[:, 1] - together * together
    first, second = (off / slope).T
    misfit = (variance[:, 1] * first - 2.0 * together * second) * first + variance[:, 0] * second * second
    end, direction = ground[row, column], shape.directions[mark, :, None]
    along = end[..., 0] * direction[:, 0] + end[..., 1] * direction[:, 1] - shape.starts_along[mark, None]
    over = np.maximum(np.maximum(-along, along - shape.lengths[mark, None]), 0.0)
    over /= _OVER_M + (_OVER_PX + noise.widen_px) * m_per_px[row, column]
    chi2 = misfit / determinant + over[:, 0] * over[:, 0] + over[:, 1] * over[:, 1]
    gain = np.full((count, lines, len(shape.starts)), -np.inf)
    gain[row, column, mark] = -0.5 * (chi2 + np.log(determinant)) - _LOG_2PI
    best = gain.argmax(axis=2)
    log_clutter = -2.0 * math.log(sight.camera.height_px)
    log_odds = math.log((1.0 - settings.false_line) / settings.false_line) - math.log(len(shape.starts))
    rows, columns = np.arange(count)[:, None], np.arange(lines)
    gains = gain[rows, columns, best] + (log_odds - log_clutter)
    px_per_m = np.abs(seen.down / seen.slope[rows, columns, :, best])
    gains = gains + widths_fit(sight, px_per_m, shape.line_width_m, noise.widen_px)
    best, gains = np.where(gains > 0.0, best, -1), np.maximum(gains, 0.0)
    arc = _arcs_fit(noise, ground, m_per_px) + (log_odds - log_clutter)
    is_arc = before & (arc > gains)
    return np.where(is_arc, ARC, best), np.where(is_arc, arc, gains)


def _arcs_fit(noise: Noise, ground: FloatArray, m_per_px: FloatArray) -> FloatArray:
    """(k, l) log density of both ends (k, l, 2, 2) of lines that are short pieces of one of the circles."""
    out = np.full(ground.shape[:2], -np.inf)
    if not len(noise.shape.circles):
        return out
    apart = ground[:, :, 1] - ground[:, :, 0]
    chord2 = apart[..., 0] * apart[..., 0] + apart[..., 1] * apart[..., 1]
    sigma_px = _ARC_PX + noise.widen_px
    log_norm = -2.0 * math.log(sigma_px) - _LOG_2PI
    sigma = sigma_px * m_per_px + noise.settings.map_m
    for x, y, radius in noise.shape.circles:
        off = (np.hypot(ground[..., 0] - x, ground[..., 1] - y) - radius) / sigma
        log_density = log_norm - 0.5 * (off * off).sum(axis=2)
        out = np.maximum(out, np.where(chord2 < radius * radius, log_density, -np.inf))
    return out


def _match_posts(cameras: Cameras, noise: Noise) -> tuple[IntArray, FloatArray]:
    sight, shape, settings = noise.sight, noise.shape, noise.settings
    count, posts, marks = len(cameras.states), len(sight.post_rays), len(shape.posts)
    if not posts or not marks:
        return np.full((count, posts), -1), np.zeros((count, posts))
    choices = np.broadcast_to(np.arange(marks), (count, posts, marks))
    error, ahead = post_errors(cameras, choices)
    whitening = noise.whitening_of_posts(count)
    white = error @ np.swapaxes(whitening, -1, -2)
    misfit = np.sum(white * white, axis=-1)
    numbers = np.where(sight.feet.known, 6.0, 4.0)
    log_norm = np.log(np.diagonal(whitening, axis1=-2, axis2=-1)).sum(axis=-1) - 0.5 * numbers * _LOG_2PI
    log_clutter = _LOG_POST + np.where(sight.feet.known, _LOG_FOOT, 0.0)
    log_odds = np.log((1.0 - settings.false_post) / settings.false_post) - np.log(marks)
    gain = (log_norm - log_clutter + log_odds)[..., None] - 0.5 * misfit
    gain = np.where(ahead, gain, -np.inf)
    best = np.argmax(gain, axis=2)
    gains = np.take_along_axis(gain, best[..., None], axis=2)[..., 0]
    # no two posts are the same landmark: the better one is
    for post in range(posts):
        for other in range(post):
            same = best[:, post] == best[:, other]
            worse = same & (gains[:, post] <= gains[:, other])
            gains[worse, post] = -np.inf
            gains[same & ~worse, other] = -np.inf
    right = gains > 0.0
    return np.where(right, best, -1), np.where(right, gains, 0.0)


def _match_circle(cameras: Cameras, noise: Noise) -> tuple[IntArray, FloatArray]:
    sight, settings = noise.sight, noise.settings
    count, points = len(cameras.states), len(sight.circle_rays)
    best, gains = np.full(count, -1), np.zeros(count)
    if not points:
        return best, gains
    log_odds = np.log((1.0 - settings.false_circle) / settings.false_circle)
    log_clutter = -np.log(sight.camera.height_px)
    numbers = min(CIRCLE_NUMBERS, float(points))
    for row, circle in enumerate(noise.shape.circles):
        error, px_per_m = circle_errors(cameras, circle)
        variance = noise.of_circle(px_per_m)
        each = -0.5 * np.minimum(error * error / variance, 1e6) - 0.5 * (np.log(variance) + _LOG_2PI) - log_clutter
        gain = numbers * each.mean(axis=1) + log_odds
        better = gain > gains
        best, gains = np.where(better, row, best), np.where(better, gain, gains)
    return best, gains
