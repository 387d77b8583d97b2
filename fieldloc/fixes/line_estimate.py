"""Least squares for all assignments of an image's lines to map lines at once.

In axes turned like the lines against the map, everything is linear and alike for all turns: with (x, y, heading) there,
    bearing = -heading,  distance = (map line's y) - y for family 0,  distance = (map line's x) - x for family 1.
What differs is the map, and which lines are explained; the matrices depend on the latter alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.fixes.line_map import TurnedGrid
from fieldloc.fixes.line_matching import GATE_SIGMAS, HASH, LineMatcher, Matches
from fieldloc.fixes.lines import GroundLines
from fieldloc.pose import FloatArray

_LOG_2_PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True)
class LineProblem:
    """Lines against a map that knows where its lines are up to a standard deviation."""

    lines: GroundLines
    grid: TurnedGrid
    tolerance_m: float
    covariance: FloatArray
    pixel_covariance: FloatArray
    matcher: LineMatcher

    @staticmethod
    def of(
        lines: GroundLines, grid: TurnedGrid, tolerance_m: float, sigma_map_m: float, unexplained: int
    ) -> "LineProblem":
        covariance, pixels = lines.covariance, lines.pixel_covariance
        if sigma_map_m > 0.0:
            own = np.diag([0.0, *[sigma_map_m**2] * len(lines.families)])
            covariance, pixels = covariance + own, pixels + own
        matcher = LineMatcher(lines, covariance, grid, tolerance_m, unexplained)
        return LineProblem(lines, grid, tolerance_m, covariance, pixels, matcher)


@dataclass(frozen=True, slots=True)
class Solved:
    """Assignments (k, n) whose lines fit together, as Matches, with the best states (k, c): c of (x, y, heading).

    covariances: (k, c, c) of them, of which pixel_covariances are from the pixels and the map alone, and by_mount
    (k, c, 4) is their change with the mount.
    log_peaks: (k,) log density of the lines at the state; log_weights: of its integral over all states.
    """

    turns: NDArray[np.intp]
    columns: NDArray[np.intp]
    states: FloatArray
    covariances: FloatArray
    pixel_covariances: FloatArray
    by_mount: FloatArray
    log_peaks: FloatArray
    log_weights: FloatArray


def solve(problem: LineProblem, matches: Matches, states: tuple[int, ...]) -> Solved:
    """Weighted least squares for those of (x, y, heading) in `states`."""
    lines = problem.lines
    explained = matches.columns >= 0
    of_pattern, pattern = _patterns(explained)
    used = np.ones((len(of_pattern), 1 + len(lines.families)), dtype=np.bool_)
    used[:, 1:] = explained[of_pattern]
    model = np.zeros((used.shape[1], 3))
    model[0, 2] = -1.0
    model[np.arange(1, len(model)), 1 - lines.families] = -1.0
    model = model[:, list(states)]
    # a line that is left out gets a row and column of the unit matrix, and then no say
    both = used[:, :, None] & used[:, None, :]
    noise = np.where(both, problem.covariance, np.eye(used.shape[1]))
    weight = np.where(both, np.linalg.inv(noise), 0.0)
    information = model.T @ weight @ model
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    gain = covariance @ model.T @ weight
    log_norm = -0.5 * (np.linalg.slogdet(noise)[1] + _LOG_2_PI * used.sum(axis=1))
    log_room = 0.5 * (_LOG_2_PI * len(states) - np.linalg.slogdet(information)[1])
    bound = _chi_square_bound(used.sum(axis=1) - len(states))

    on_map = problem.grid.offsets_m[matches.turns[:, None], lines.families, matches.columns]
    target = np.empty((len(pattern), used.shape[1]))
    target[:, 0] = lines.bearing_rad
    target[:, 1:] = np.where(explained, lines.distances_m - on_map, 0.0)
    found = (gain[pattern] @ target[:, :, None])[..., 0]
    residual = target - found @ model.T
    misfit = np.einsum("ki,kij,kj->k", residual, weight[pattern], residual)
    fits = np.flatnonzero(misfit <= bound[pattern])
    pattern = pattern[fits]
    pixel = gain @ problem.pixel_covariance @ np.swapaxes(gain, 1, 2)
    log_peaks = log_norm[pattern] - 0.5 * misfit[fits]
    return Solved(
        matches.turns[fits],
        matches.columns[fits],
        found[fits],
        covariance[pattern],
        pixel[pattern],
        (gain @ lines.by_mount)[pattern],
        log_peaks,
        log_peaks + log_room[pattern],
    )


def log_ends_fit(problem: LineProblem, found: Solved) -> FloatArray:
    """(k,) how much rarer whole poses are as seen ends stand out over the map's; -inf beyond what noise can do."""
    lines, grid, families = problem.lines, problem.grid, problem.lines.families
    place = found.turns[:, None], families, found.columns
    # family 0 runs along x, family 1 along y
    along = found.states[:, families]
    ends = grid.middles_m[place][..., None] + grid.halves_m[place][..., None] * np.array([-1.0, 1.0])
    beyond = (lines.extents_m + along[..., None] - ends) * np.array([-1.0, 1.0]) - problem.tolerance_m
    variance = lines.extents_sigma_m**2 + found.covariances[:, families, families][..., None]
    squared = np.where(found.columns[..., None] >= 0, np.maximum(beyond, 0.0) ** 2 / variance, 0.0)
    worst = squared.max(axis=(1, 2), initial=0.0)
    return np.where(worst <= GATE_SIGMAS**2, -0.5 * squared.sum(axis=(1, 2)), -np.inf)


def rows_of(problem: LineProblem, found: Solved) -> NDArray[np.intp]:
    """(k, n) rows of the LineGrid, -1 for lines left unexplained."""
    rows = problem.grid.rows[found.turns[:, None], problem.lines.families, found.columns]
    return np.where(found.columns >= 0, rows, -1)


def _patterns(explained: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """One row for each pattern among the rows of (k, n), and the pattern (k,) of each row."""
    code = explained @ HASH[np.arange(explained.shape[1]) % len(HASH)]
    _, first, pattern = np.unique(code, return_index=True, return_inverse=True)
    return first, pattern


def _chi_square_bound(degrees: NDArray[np.intp]) -> FloatArray:
    """Chi-square that noise exceeds as rarely as a normal variable exceeds GATE_SIGMAS (Wilson and Hilferty, 1931)."""
    # without a degree of freedom rounding is all the misfit there is
    spread = 2.0 / (9.0 * np.maximum(degrees, 1))
    return np.where(degrees > 0, degrees * (1.0 - spread + GATE_SIGMAS * np.sqrt(spread)) ** 3, np.inf)
