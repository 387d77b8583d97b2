"""Where exactly a post's edges are: a straight line through the sub-pixel steps of all its rows.

In each row the step from what is beside the post to the post is told twice: where the colour changes fastest, and
where it has changed by half. Noise scatters both about the line; light that falls off towards a round post's limb,
overexposure and blur that is not symmetric set them apart. The covariance is made of both: the scatter, with its
correlation from row to row, and the square of half the distance between the two.
"""

from dataclasses import dataclass

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.straight import Plane

_MOST_ROWS = 240
_REACH_PX = 5  # to either side of where the edge should be
_NEAR_PX = 2.6  # from there to where it is, at most
_LEAST_ROWS = 6
_LEAST_STEP = 0.35  # of the rows' median step: rows with less are hidden, or in front of the like
_OUTLIER = 3.0  # standard deviations
_MARGIN = 0.04  # of the length at either end, where crossbar and foot begin


@dataclass(frozen=True, slots=True, eq=False)
class FittedEdge:
    """line: (2,) intercept and slope of x = a + b y in the plane of straight lines. across: (2,) the standard deviation
    of a line's points is sqrt([1 y - centre] covariance [1 y - centre]'), across the line; covariance: (2, 2)."""

    line: FloatArray
    centre: float
    covariance: FloatArray

    def x_at(self, y: FloatArray) -> FloatArray:
        return np.asarray(self.line[0] + self.line[1] * y)

    def covariance_at(self, y: FloatArray) -> FloatArray:
        """(k, k) of x at rows y (k,)."""
        design = np.stack([np.ones_like(y), y - self.centre], axis=1)
        return np.asarray(design @ self.covariance @ design.T)


def fit_edge(
    picture: UInt8Array, line: FloatArray, rows: tuple[float, float], width_px: float, inwards: int, plane: Plane
) -> FittedEdge | None:
    """The edge near u = a + b v between two rows; None where too few rows show a step.

    width_px: of the post, so that its other edge stays out of sight. inwards: 1 where the post is to the right, or -1.
    """
    height, columns = picture.shape[:2]
    margin = _MARGIN * (rows[1] - rows[0])
    first, last = max(0, int(np.ceil(rows[0] + margin))), min(height - 1, int(rows[1] - margin))
    if last - first < _LEAST_ROWS:
        return None
    v = np.unique(np.linspace(first, last, min(_MOST_ROWS, last - first + 1)).astype(np.intp))
    guess = line[0] + line[1] * v
    inside = int(np.clip(0.5 * width_px, 1, _REACH_PX))
    offsets = inwards * np.arange(-_REACH_PX, inside + 1)
    column = np.rint(guess).astype(np.intp)[:, None] + offsets
    whole = (column >= 0).all(axis=1) & (column < columns).all(axis=1)
    v, guess, column = v[whole], guess[whole], column[whole]
    if len(v) < _LEAST_ROWS:
        return None
    colours = picture[v[:, None], column].astype(np.float64)
    profile = colours @ _direction(colours)
    fastest, half, step = _steps(profile, column[:, 0].astype(np.float64), guess, inwards)
    seen = (step > _LEAST_STEP * np.nanmedian(step)) & np.isfinite(fastest) & np.isfinite(half)
    if np.count_nonzero(seen) < _LEAST_ROWS:
        return None
    points = plane.from_picture(np.stack([0.5 * (fastest + half)[seen], v[seen]], axis=1))
    return _line(points, (fastest - half)[seen])


def _direction(colours: FloatArray) -> FloatArray:
    """(3,) the direction in colour from outside to inside, over all rows."""
    difference = np.median(colours[:, -2:].mean(axis=1) - colours[:, :3].mean(axis=1), axis=0)
    return np.asarray(difference / max(float(np.linalg.norm(difference)), 1e-9))


def _steps(
    profile: FloatArray, start: FloatArray, guess: FloatArray, inwards: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """u (n,) of the fastest change and of half the change in each row, and the change; NaN where there is none."""
    change = np.diff(profile, axis=1)
    at = start[:, None] + inwards * (np.arange(change.shape[1]) + 0.5)
    near = np.abs(at - guess[:, None]) <= _NEAR_PX
    near[:, [0, -1]] = False
    peak = np.where(near, change, -np.inf).argmax(axis=1)
    rows = np.arange(len(profile))
    high = change[rows, peak]
    around = np.stack([change[rows, peak - 1], high, change[rows, np.minimum(peak + 1, change.shape[1] - 1)]])
    low, high_log, up = np.log(np.maximum(around, 0.02 * np.maximum(high, 1e-9)))
    bend = np.minimum(low - 2.0 * high_log + up, -1e-6)
    fastest = at[rows, peak] + inwards * np.clip(0.5 * (low - up) / bend, -1.0, 1.0)
    # what is beside the step is flat two pixels away from it
    count = profile.shape[1] - 1
    outside = 0.5 * (profile[rows, np.maximum(peak - 2, 0)] + profile[rows, np.maximum(peak - 1, 0)])
    inside = 0.5 * (profile[rows, np.minimum(peak + 2, count)] + profile[rows, np.minimum(peak + 3, count)])
    step = inside - outside
    level = 0.5 * (inside + outside)
    before, after = profile[rows, peak], profile[rows, peak + 1]
    part = (level - before) / np.where(np.abs(after - before) > 1e-6, after - before, np.nan)
    half = start + inwards * (peak + np.where((part >= -1.0) & (part <= 2.0), part, np.nan))
    return np.where(high > 0.0, fastest, np.nan), half, np.where(high > 0.0, step, 0.0)


def _line(points: FloatArray, disagreement: FloatArray) -> FittedEdge | None:
    points, disagreement = points[finite := np.isfinite(points).all(axis=1)], disagreement[finite]
    if len(points) < _LEAST_ROWS:
        return None
    x, y = points.T
    centre = float(y.mean())
    design = np.stack([np.ones_like(y), y - centre], axis=1)
    kept = np.ones(len(y), dtype=np.bool_)
    weight = np.ones_like(y)
    solution = np.zeros(2)
    for _ in range(6):  # Cauchy's weights bring the line to most of the points
        root = np.sqrt(weight)
        solution = np.linalg.lstsq(design * root[:, None], x * root, rcond=None)[0]
        residual = x - design @ solution
        scale = max(1.4826 * float(np.median(np.abs(residual))), 1e-3)
        weight = 1.0 / (1.0 + (residual / (2.0 * scale)) ** 2)
        kept = np.abs(residual) < _OUTLIER * scale
    if np.count_nonzero(kept) < _LEAST_ROWS or np.count_nonzero(kept) < 0.4 * len(y):
        return None
    design, x = design[kept], x[kept]
    solution = np.linalg.lstsq(design, x, rcond=None)[0]
    residual = x - design @ solution
    count = len(x)
    variance = float(residual @ residual) / max(count - 2, 1)
    neighbours = float(residual[1:] @ residual[:-1]) / max(float(residual @ residual), 1e-12)
    inflation = (1.0 + neighbours) / (1.0 - neighbours) if 0.0 < neighbours < 0.95 else 1.0
    scatter = variance * inflation * np.linalg.inv(design.T @ design)
    common = np.linalg.lstsq(design, disagreement[kept], rcond=None)[0]
    return FittedEdge(
        np.array([solution[0] - solution[1] * centre, solution[1]]), centre, scatter + 0.25 * np.diag(common**2)
    )
