"""All poses on a map that explain the lines of one image: four quarter turns, and every offset at which they fit.

The step the paper leaves open after eqs. 13-15: which of the map's lines were seen. Lines of both directions give
poses; lines of a single direction give a heading and one coordinate, and the robot is free to move along them.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fieldloc.field import FieldMap
from fieldloc.fixes.base import Fix
from fieldloc.fixes.line_map import LineGrid, line_grid
from fieldloc.fixes.line_matching import GATE_SIGMAS, Branches, Seen, match
from fieldloc.fixes.lines import GroundLines
from fieldloc.pose import FloatArray, rotate_covariance, rotation, wrap

_Mask = NDArray[np.bool_]
_Found = TypeVar("_Found")

# by family and quarter turn: which way its distance counts along the grid; the extents take the other family's row
_SIGN = np.array([[1.0, -1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0]])
_UNEXPLAINED_SHARE = 0.05  # how often a line that passed for one of the field's is none
_UNEXPLAINED_SPAN_M = 10.0  # over which such a line's distance is spread evenly


@dataclass(frozen=True, slots=True)
class LineConstraint:
    """What lines of a single direction say: normal . position = offset_m, and the heading; nothing about the rest.

    normal: (2,) unit vector in field axes. covariance: (2, 2) of (offset_m, heading_rad).
    along_m: (2,) bounds of the position along the normal turned left, from the ends of the map's lines: not Gaussian,
    and generous by the noise of the ends seen.
    log_weight: as in Fix, under even odds over all places, so a long room counts for more.
    """

    normal: FloatArray
    offset_m: float
    heading_rad: float
    covariance: FloatArray
    along_m: FloatArray
    log_weight: float
    solver: str = "constraints_from_lines"


def poses_from_lines(
    lines: GroundLines, field_map: FieldMap, *, extra_unexplained: int = 0, sigma_map_m: float = 0.0
) -> tuple[Fix, ...]:
    """Poses that explain the lines, likeliest first; empty unless both directions were seen and fit.

    Explains as many lines as any pose can, or up to `extra_unexplained` fewer. The weights are those of evenly likely
    places, with a floor for lines that are none of the map's. sigma_map_m: how well the map knows where its lines are.
    """
    grid = line_grid(field_map)
    problem = _Problem(lines, grid, sigma_map_m, field_map.line_width_m)

    def search(unexplained: int) -> list[Fix]:
        found = []
        for quarter in range(4):
            for matched, offsets in problem.pairs(quarter, unexplained):
                poses, covariance, log_weights = problem.solve(quarter, (0, 1), matched, offsets)
                at = poses[:, :2] @ rotation(grid.heading_rad).T
                in_field = np.column_stack([at, wrap(poses[:, 2] + grid.heading_rad)])
                turned = rotate_covariance(covariance, grid.heading_rad)
                for pose, weight in zip(in_field, log_weights, strict=True):
                    if np.isfinite(weight):
                        found.append(Fix(pose, turned, float(weight), "poses_from_lines"))
        return found

    directions = len(set(lines.families.tolist()))
    fixes = _least_unexplained(search, len(lines.families) - 2, extra_unexplained) if directions == 2 else []
    return tuple(sorted(fixes, key=lambda fix: -fix.log_weight))


def constraints_from_lines(
    lines: GroundLines, field_map: FieldMap, *, extra_unexplained: int = 0, sigma_map_m: float = 0.0
) -> tuple[LineConstraint, ...]:
    """As `poses_from_lines` where lines of one direction only were seen.

    Where both were, empty, unless `extra_unexplained` allows to leave all lines of one direction unexplained: its only
    line may be none of the map's. The weights compare with those of the poses from the same lines.
    """
    grid = line_grid(field_map)
    problem = _Problem(lines, grid, sigma_map_m, field_map.line_width_m)

    def search(family: int, unexplained: int) -> list[LineConstraint]:
        found = []
        for quarter in range(4):
            axis = int(_axis(np.array(family), quarter))
            normal = rotation(grid.heading_rad)[:, axis]
            for matched, offsets, room in problem.alone(axis, quarter, unexplained):
                states, covariance, log_weights = problem.solve(quarter, (axis,), matched, offsets)
                for (offset, heading), (low, high), weight in zip(states, room, log_weights, strict=True):
                    along = np.array([low, high] if axis == 0 else [-high, -low])
                    turned = float(wrap(heading + grid.heading_rad))
                    total = float(weight + np.log(max(high - low, 1e-6)))
                    if np.isfinite(total):
                        found.append(LineConstraint(normal, float(offset), turned, covariance, along, total))
        return found

    count = np.bincount(lines.families, minlength=2)
    found = []
    for family in (0, 1):
        own, other = int(count[family]), int(count[1 - family])
        spare = extra_unexplained - other
        if own and spare >= 0:
            found += _least_unexplained(partial(search, family), min(spare, own - 1) if other else own - 1, spare)
    return tuple(sorted(found, key=lambda constraint: -constraint.log_weight))


def _least_unexplained(search: Callable[[int], list[_Found]], most: int, extra: int) -> list[_Found]:
    """What the search finds with as few lines left unexplained as possible, and up to `extra` more."""
    for unexplained in range(most + 1):
        if found := search(unexplained):
            return search(min(unexplained + extra, most)) if extra else found
    return []


class _Problem:
    """Lines against a grid; a quarter turn puts the robot's axes, turned by the lines' bearing, on the grid's."""

    def __init__(self, lines: GroundLines, grid: LineGrid, sigma_map_m: float, tolerance_m: float) -> None:
        self._lines = lines
        self._grid = grid
        self._tolerance_m = tolerance_m
        self._covariance = lines.covariance.copy()
        index = np.arange(1, len(self._covariance))
        self._covariance[index, index] += sigma_map_m**2

    def alone(self, axis: int, quarter: int, unexplained: int) -> Iterator[tuple[_Mask, FloatArray, FloatArray]]:
        """Per pattern of explained lines (n,): their map offsets (q, n) and the room along them (q, 2), distinct."""
        columns, branches, found = self._match(axis, quarter, unexplained)
        shape = (len(found), len(self._lines.families))
        offsets, matched = np.zeros(shape), np.zeros(shape, dtype=np.bool_)
        offsets[:, columns], matched[:, columns] = found, branches.assigned >= 0
        for pattern, chosen in _patterns(matched, np.column_stack([offsets, branches.room_m])):
            yield pattern, offsets[chosen], branches.room_m[chosen]

    def pairs(self, quarter: int, unexplained: int) -> Iterator[tuple[_Mask, FloatArray]]:
        """Per pattern of explained lines (n,): the map offsets (q, n) that fit in both directions at once, distinct."""
        columns_x, x, offsets_x = self._match(0, quarter, unexplained)
        columns_y, y, offsets_y = self._match(1, quarter, unexplained)
        reach_x, reach_y = GATE_SIGMAS * x.sigma_m, GATE_SIGMAS * y.sigma_m
        fits = x.unexplained[:, None] + y.unexplained <= unexplained
        fits &= (x.position_m + reach_x)[:, None] >= y.room_m[:, 0]
        fits &= (x.position_m - reach_x)[:, None] <= y.room_m[:, 1]
        fits &= y.position_m + reach_y >= x.room_m[:, :1]
        fits &= y.position_m - reach_y <= x.room_m[:, 1:]
        i, j = np.nonzero(fits)
        shape = (len(i), len(self._lines.families))
        offsets, matched = np.zeros(shape), np.zeros(shape, dtype=np.bool_)
        offsets[:, columns_x], offsets[:, columns_y] = offsets_x[i], offsets_y[j]
        matched[:, columns_x], matched[:, columns_y] = x.assigned[i] >= 0, y.assigned[j] >= 0
        for pattern, chosen in _patterns(matched, offsets):
            yield pattern, offsets[chosen]

    def solve(
        self, quarter: int, axes: tuple[int, ...], matched: _Mask, offsets: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Weighted least squares for (position on the axes, heading): states (q, c), covariance (c, c), weights (q,).

        The model is linear: bearing = quarter turns - heading, distance = sign * (map offset - position). The weight is
        -inf where the lines as a whole fit worse than noise can make them.
        """
        sign = _SIGN[self._lines.families[matched], quarter]
        where = _axis(self._lines.families[matched], quarter)
        model = np.zeros((1 + len(sign), len(axes) + 1))
        model[0, -1] = -1.0
        for column, axis in enumerate(axes):
            model[1:, column] = np.where(where == axis, -sign, 0.0)
        kept = np.concatenate([[True], matched])
        noise = self._covariance[np.ix_(kept, kept)]
        weight = np.linalg.inv(noise)
        covariance = np.asarray(np.linalg.inv(model.T @ weight @ model), dtype=np.float64)
        observed = np.concatenate([[self._lines.bearing_rad], self._lines.distances_m[matched]])
        constant = np.column_stack([np.full(len(offsets), quarter * np.pi / 2), sign * offsets[:, matched]])
        target = observed - constant
        states = target @ weight @ model @ covariance
        residual = target - states @ model.T
        misfit = np.einsum("qi,ij,qj->q", residual, weight, residual)
        # the likelihood with the state integrated out, flat before; each unexplained line at its own even density
        log_weight = 0.5 * (_log_volume(covariance) - _log_volume(noise) - misfit)
        log_weight += np.log1p(-_UNEXPLAINED_SHARE) * matched.sum()
        log_weight += np.log(_UNEXPLAINED_SHARE / _UNEXPLAINED_SPAN_M) * (~matched).sum()
        fits = misfit <= _chi_square_bound(len(noise) - len(covariance))
        return states, covariance, np.where(fits, log_weight, -np.inf)

    def _match(self, axis: int, quarter: int, unexplained: int) -> tuple[NDArray[np.intp], Branches, FloatArray]:
        """The lines across one axis of the grid: which they are, their branches, the map offsets (p, n) of those."""
        lines = self._lines
        columns = np.flatnonzero(_axis(lines.families, quarter) == axis)
        family = (1 - axis + quarter) % 2  # all of them are of one family
        sign, along = _SIGN[family, quarter], _SIGN[1 - family, quarter]
        noise = self._covariance[np.ix_(1 + columns, 1 + columns)]
        ends = lines.extents_m[columns] * along
        slack = GATE_SIGMAS * lines.extents_sigma_m[columns] + self._tolerance_m
        order = np.argsort(ends, axis=1)
        ends, slack = np.take_along_axis(ends, order, axis=1), np.take_along_axis(slack, order, axis=1)
        ends = ends + slack * np.array([1.0, -1.0])
        on_axis = self._grid.axes == axis
        offsets = self._grid.offsets_m[on_axis]
        seen = Seen(sign * lines.distances_m[columns], noise, ends)
        branches = match(seen, offsets, self._grid.extents_m[on_axis], unexplained)
        explained = branches.assigned >= 0
        return columns, branches, np.where(explained, np.append(offsets, 0.0)[branches.assigned], 0.0)


def _axis(families: NDArray[np.intp], quarter: int) -> NDArray[np.intp]:
    """The grid coordinate, 0 or 1, that is constant along lines of these families."""
    return np.asarray((1 - families + quarter) % 2)


def _patterns(matched: _Mask, rows: FloatArray) -> Iterator[tuple[_Mask, NDArray[np.intp]]]:
    """Each pattern (n,) that occurs in `matched` (q, n), with the indices of its rows that differ from each other."""
    for pattern in np.unique(matched, axis=0):
        index = np.flatnonzero((matched == pattern).all(axis=1))
        _, first = np.unique(rows[index].round(6), axis=0, return_index=True)
        yield pattern, index[first]


def _chi_square_bound(degrees: int) -> float:
    """Chi-square that noise exceeds as rarely as a normal variable exceeds GATE_SIGMAS (Wilson and Hilferty, 1931)."""
    if degrees == 0:
        return np.inf  # as many unknowns as observations: rounding is all the misfit there is
    spread = 2.0 / (9.0 * degrees)
    return float(degrees * (1.0 - spread + GATE_SIGMAS * np.sqrt(spread)) ** 3)


def _log_volume(covariance: FloatArray) -> float:
    """log det(2 pi S)."""
    return float(np.linalg.slogdet(2 * np.pi * covariance)[1])
