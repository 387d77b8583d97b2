"""Least squares for all assignments of an image's lines to map lines at once.

In axes turned like the lines against the map, everything is linear and alike for all turns: with (x, y, heading) there,
    bearing = -heading,  distance = (map line's y) - y for family 0,  distance = (map line's x) - x for family 1.
What differs is the map, and which lines are explained; the matrices depend on the latter alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.covariance import chi_square_bounds
from fieldloc.fixes.line_map import TurnedGrid
from fieldloc.fixes.line_matching import GATE_SIGMAS, Matches, distinct, weights_of
from fieldloc.fixes.lines import GroundLines
from fieldloc.pose import FloatArray

_LOG_2_PI = float(np.log(2.0 * np.pi))
_LOW_AND_HIGH = np.array([-1.0, 1.0])[:, None, None]


@dataclass(frozen=True, slots=True)
class Solved:
    """Assignments as Matches whose lines fit together, with the best states (k, c): c of (x, y, heading).

    pattern: (k,) which lines are explained decides about the rows of covariances (p, c, c) of the states, of which
    pixel_covariances are from the pixels and the map alone, and of by_mount (p, c, 4), their change with the mount.
    log_peaks: (k,) log density of the lines at the state; log_weights: of its integral over all states.
    """

    turns: NDArray[np.intp]
    columns: NDArray[np.intp]
    states: FloatArray
    pattern: NDArray[np.intp]
    covariances: FloatArray
    pixel_covariances: FloatArray
    by_mount: FloatArray
    log_peaks: FloatArray
    log_weights: FloatArray


def solve(
    lines: GroundLines, grid: TurnedGrid, sigma_map_m: float, matches: Matches, states: tuple[int, ...]
) -> Solved:
    """Weighted least squares for those of (x, y, heading) in `states`."""
    count, families = len(lines.families), lines.families
    explained = matches.columns >= 0
    first, pattern = _patterns(explained)
    used = np.ones((len(first), 1 + count), dtype=np.bool_)
    used[:, 1:] = explained[first]
    model = np.zeros((1 + count, 3))
    model[0, 2] = -1.0
    model[1:, 0], model[1:, 1] = -families, families - 1
    model = model[:, states]
    weight, log_det = _without(with_map_noise(lines.covariance, sigma_map_m), ~used)
    to_model = model.T @ weight
    information = to_model @ model
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    gain = covariance @ to_model
    explaining = used.sum(axis=1)
    log_norm = -0.5 * (log_det + _LOG_2_PI * explaining)
    log_room = 0.5 * (_LOG_2_PI * len(states) - np.log(np.linalg.det(information)))
    bound = chi_square_bounds(1 + count, GATE_SIGMAS)[np.maximum(explaining - len(states), 0)]

    on_map = grid.offsets_m[matches.turns[:, None], families, matches.columns]
    target = np.empty((len(pattern), 1 + count))
    target[:, 0] = lines.bearing_rad
    target[:, 1:] = (lines.distances_m - on_map) * explained
    found = (gain[pattern] @ target[:, :, None])[..., 0]
    residual = target - found @ model.T
    misfit = ((weight[pattern] @ residual[:, :, None])[..., 0] * residual).sum(axis=1)
    log_peaks = log_norm[pattern] - 0.5 * misfit
    log_peaks[misfit > bound[pattern]] = -np.inf
    pixel = gain @ with_map_noise(lines.pixel_covariance, sigma_map_m) @ gain.swapaxes(1, 2)
    return Solved(
        matches.turns,
        matches.columns,
        found,
        pattern,
        covariance,
        np.asarray(pixel, dtype=np.float64),
        gain @ lines.by_mount,
        log_peaks,
        log_peaks + log_room[pattern],
    )


def log_ends_fit(lines: GroundLines, grid: TurnedGrid, tolerance_m: float, found: Solved) -> FloatArray:
    """(k,) how much rarer whole poses are as seen ends stand out over the map's; -inf beyond what noise can do."""
    families, place = lines.families, (found.turns[:, None], lines.families, found.columns)
    # family 0 runs along x, family 1 along y: by how much the middle is off, and by how much either end sticks out
    off = 0.5 * lines.extents_m.sum(axis=1) + found.states[:, families] - grid.middles_m[place]
    half = 0.5 * (lines.extents_m[:, 1] - lines.extents_m[:, 0])
    beyond = half - grid.halves_m[place] + off * _LOW_AND_HIGH - tolerance_m
    own = (lines.extents_sigma_m**2).T[:, None]
    variance = own + found.covariances[:, families, families][found.pattern]
    squared = np.square(np.maximum(beyond, 0.0)) / variance * (found.columns >= 0)
    penalty = -0.5 * squared.sum(axis=(0, 2))
    penalty[squared.max(axis=(0, 2), initial=0.0) > GATE_SIGMAS**2] = -np.inf
    return np.asarray(penalty)


def with_map_noise(covariance: FloatArray, sigma_map_m: float) -> FloatArray:
    """(1 + n, 1 + n) of (bearing, distances) to lines that the map knows up to that standard deviation."""
    if sigma_map_m == 0.0:
        return covariance
    out = covariance.copy()
    index = np.arange(1, len(out))
    out[index, index] += sigma_map_m**2
    return out


def _patterns(explained: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """One row for each pattern among the rows of (k, n), and the pattern (k,) of each row."""
    if explained.all():
        return np.arange(min(len(explained), 1)), np.zeros(len(explained), dtype=np.intp)
    return distinct(explained @ weights_of(explained.shape[1]))


def _without(covariance: FloatArray, left_out: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Inverses (p, 1 + n, 1 + n) of the covariance of what is not left out (p, 1 + n), else zero, and log determinants.

    A number is left out of the inverse of all by eliminating it there.
    """
    count, each = len(left_out), np.arange(len(left_out))
    weight, log_det = np.empty((count, *covariance.shape)), np.full(count, np.linalg.slogdet(covariance)[1])
    weight[:] = np.linalg.inv(covariance)
    at_once = left_out.argsort(axis=1, kind="stable")
    for turn in range(1, 1 + int(left_out.sum(axis=1).max(initial=0))):
        number = at_once[:, -turn]
        column = weight[each, number] * left_out[each, number, None]
        pivot = column[each, number]
        pivot[pivot == 0.0] = 1.0
        weight -= column[:, :, None] * (column / pivot[:, None])[:, None]
        log_det += np.log(pivot)
    return weight, log_det
