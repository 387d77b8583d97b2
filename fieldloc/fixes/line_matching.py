"""Which map line each seen line can be: every assignment that geometry allows, for the lines of one direction.

An interpretation tree, one seen line a level, all branches of a level at once. A branch dies when two of its lines put
the robot at places that differ by more than their noise, or when no place lets every map line reach over what was seen
of it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray

GATE_SIGMAS = 4.0
_MAX_BRANCHES = 200  # reached only when the noise is as large as the gaps between the lines; then the best ones stay


@dataclass(frozen=True, slots=True)
class Seen:
    """Lines of one direction, in grid axes around the robot.

    offsets_m: (n,) in the coordinate that is constant along them, with covariance (n, n). extents_m: (n, 2) lower and
    upper end in the other coordinate, moved inwards by their tolerance (so the lower may be the higher).
    """

    offsets_m: FloatArray
    covariance: FloatArray
    extents_m: FloatArray


@dataclass(frozen=True, slots=True)
class Branches:
    """Assignments (p, n): the map line of each seen line, -1 for one left unexplained (unexplained (p,) of them).

    position_m: (p,) where they put the robot across the lines, sigma_m (p,). room_m: (p, 2) where it can be along them.
    """

    assigned: NDArray[np.intp]
    unexplained: NDArray[np.intp]
    position_m: FloatArray
    sigma_m: FloatArray
    room_m: FloatArray


def match(seen: Seen, offsets_m: FloatArray, extents_m: FloatArray, unexplained: int) -> Branches:
    """All assignments to map lines (m,), (m, 2) with at most so many lines, and never all, left unexplained."""
    count = len(seen.offsets_m)
    variance = np.diagonal(seen.covariance)
    gate = GATE_SIGMAS * np.sqrt(np.maximum(variance[:, None] + variance - 2.0 * seen.covariance, 0.0)) + 1e-9
    assigned = np.full((1, count), -1, dtype=np.intp)
    implied = np.full((1, count), np.nan)  # where each assignment puts the robot
    room = np.array([[-np.inf, np.inf]])
    left_out = np.zeros(1, dtype=np.intp)
    misfit = np.zeros(1)
    for i in np.argsort(variance, kind="stable"):
        position = offsets_m - seen.offsets_m[i]
        low = np.maximum(room[:, :1], extents_m[:, 0] - seen.extents_m[i, 0])
        high = np.minimum(room[:, 1:], extents_m[:, 1] - seen.extents_m[i, 1])
        apart = np.abs(position[:, None] - implied[:, None, :]) / gate[i]
        apart = np.where(np.isnan(apart), 0.0, apart)
        branch, line = np.nonzero((low <= high) & (apart.max(axis=-1) <= 1.0))
        spare = np.flatnonzero(left_out < unexplained)
        parent = np.concatenate([branch, spare])
        assigned, implied = assigned[parent], implied[parent]
        assigned[: len(line), i], implied[: len(line), i] = line, position[line]
        room = np.concatenate([np.stack([low[branch, line], high[branch, line]], axis=-1), room[spare]])
        left_out = np.concatenate([left_out[branch], left_out[spare] + 1])
        misfit = np.concatenate([misfit[branch] + np.sum(apart[branch, line] ** 2, axis=-1), misfit[spare]])
        if len(parent) > _MAX_BRANCHES:
            best = np.sort(np.lexsort((misfit, left_out))[:_MAX_BRANCHES])
            assigned, implied, room = assigned[best], implied[best], room[best]
            left_out, misfit = left_out[best], misfit[best]
    some = left_out < count
    assigned, implied, room, left_out = assigned[some], implied[some], room[some], left_out[some]
    weight = np.where(assigned >= 0, 1.0 / np.maximum(variance, 1e-18), 0.0)
    position = np.sum(weight * np.where(assigned >= 0, implied, 0.0), axis=1) / weight.sum(axis=1)
    # the lines' errors are shared, so together they are hardly better than the best one
    sigma = np.sqrt(np.where(assigned >= 0, variance, np.inf).min(axis=1, initial=np.inf))
    return Branches(assigned, left_out, position, sigma, room)
