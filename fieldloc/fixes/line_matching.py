"""Which map line each seen line can be: every assignment that geometry allows, of all turns at once.

An anchor is one seen line taken for one map line: it puts the robot somewhere across that line, which says what every
other line of the same direction can be. If at most u lines are none of the map's, then of any u + 1 lines one is, so
u + 1 lines a direction are enough to try. A pair of anchors, one a direction, is a place, which says whether each map
line reaches over what was seen of it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fieldloc.fixes.line_map import TurnedGrid
from fieldloc.fixes.lines import GroundLines
from fieldloc.pose import FloatArray

GATE_SIGMAS = 4.0
AROUND_M = 1.0  # a robot can stand so far outside of the lines
_SURE_SHARE = 0.5  # of the gates: a line that is nearer than that to a map line is never left unexplained
_MOST = 1000  # places, and matches: more come only of noise as large as the gaps between the lines; then the best stay

_IntArray = NDArray[np.intp]


@lru_cache(maxsize=64)
def weights_of(count: int) -> NDArray[np.int64]:
    """(count,) of which sums, modulo 2^64, tell rows of so many small numbers apart."""
    return np.random.default_rng(1).integers(1, 2**62, count)


def distinct(keys: NDArray[np.int64]) -> tuple[_IntArray, _IntArray]:
    """The first row of each key among (k,), and which of those stands for each row (k,)."""
    order = keys.argsort(kind="stable")
    ordered = keys[order]
    new = np.ones(len(keys), dtype=np.bool_)
    new[1:] = ordered[1:] != ordered[:-1]
    which = np.empty(len(keys), dtype=np.intp)
    which[order] = new.cumsum() - 1
    return order[new], which


@dataclass(frozen=True, slots=True)
class Matches:
    """turns: (k,) rows of the TurnedGrid. columns: (k, n) of its lines, -1 where a line is none of the map's."""

    turns: _IntArray
    columns: _IntArray


class LineMatcher:
    """Lines of one image against a map, with at most so many of them unexplained."""

    def __init__(
        self, lines: GroundLines, covariance: FloatArray, grid: TurnedGrid, tolerance_m: float, unexplained: int
    ) -> None:
        """covariance: (1 + n, 1 + n) as the lines', with the map's own noise in it."""
        families = lines.families
        self._families, self._unexplained = families, unexplained
        variance = covariance.diagonal()[1:]
        between = variance[:, None] + variance - 2.0 * covariance[1:, 1:]
        gate = GATE_SIGMAS * np.sqrt(np.maximum(between, 0.0)) + 1e-9
        reach = GATE_SIGMAS * np.sqrt(variance)
        # where each assignment puts the robot across (t, n, m), and where along it may be then
        self._position = grid.offsets_m[:, families] - lines.distances_m[:, None]
        slack = GATE_SIGMAS * lines.extents_sigma_m
        self._slack = _SURE_SHARE * slack.max(axis=1)[:, None]
        inwards = lines.extents_m + (slack + tolerance_m) * np.array([1.0, -1.0])
        self._middle = grid.middles_m[:, families] - 0.5 * (inwards[:, :1] + inwards[:, 1:])
        half = grid.halves_m[:, families] - 0.5 * (inwards[:, 1:] - inwards[:, :1])
        long_enough = half >= 0.0
        self._half = np.where(long_enough, half, -1e9)

        self._count = np.bincount(families, minlength=2)
        alike = families[:, None] == families
        # the surest so many of each direction
        first = (alike & (variance < variance[:, None])).sum(axis=1) <= unexplained
        # family 0 says where the robot is in y, family 1 in x
        across, margin = 1 - families, AROUND_M + reach
        possible = long_enough & first[:, None]
        possible &= self._position > (grid.low_m[:, across] - margin)[..., None]
        possible &= self._position < (grid.high_m[:, across] + margin)[..., None]
        turn, line, column = possible.nonzero()
        at, middle, wide = (a[turn, line, column] for a in (self._position, self._middle, self._half))
        apart = np.abs(self._position[turn] - at[:, None, None]) / gate[line][:, :, None]
        fits = (apart <= 1.0).astype(np.int8) + (apart <= _SURE_SHARE)
        fits *= alike[line][:, :, None]
        fits *= np.abs(self._middle[turn] - middle[:, None, None]) <= self._half[turn] + wide[:, None, None]
        family = families[line]
        left_out = self._count[family] - fits.any(axis=2).sum(axis=1)
        kept = left_out <= unexplained
        # per anchor: turn, position across, its reach, room along, which lines fit, how many do not
        self._turn, self._family, self._left_out = turn[kept], family[kept], left_out[kept]
        self._at, self._reach, self._fits = at[kept], reach[line[kept]], fits[kept]
        self._room = middle[kept], wide[kept]

    def pairs(self) -> Matches:
        """With lines of both directions explained."""
        (y,), (x,) = (self._family == 0).nonzero(), self._family.nonzero()
        middle, half = self._room
        both = self._turn[y][:, None] == self._turn[x]
        both &= self._left_out[y][:, None] + self._left_out[x] <= self._unexplained
        both &= np.abs(self._at[y][:, None] - middle[x]) <= half[x] + self._reach[y][:, None]
        both &= np.abs(self._at[x] - middle[y][:, None]) <= half[y][:, None] + self._reach[x]
        i, j = np.nonzero(both)
        y, x = y[i], x[j]
        if len(y) > _MOST:
            best = np.argsort(self._left_out[y] + self._left_out[x], kind="stable")[:_MOST]
            y, x = y[best], x[best]
        turn, fits = self._turn[y], self._fits[y] + self._fits[x]
        # what was seen of a line says where the robot is in the other direction's coordinate
        of_y = self._families == 1
        at = np.where(of_y, self._at[y][:, None], self._at[x][:, None])
        reach = np.where(of_y, self._reach[y][:, None], self._reach[x][:, None])
        beyond = np.abs(self._middle[turn] - at[:, :, None]) - self._half[turn]
        # that an end is on the map's line may turn out wrong once all lines have their say, but not if it is well on it
        on_it = (beyond <= reach[:, :, None]).astype(np.int8) + (beyond <= -self._slack)
        return self._expand(turn, np.minimum(fits, on_it), (0, 1))

    def alone(self, family: int) -> Matches:
        """With lines of that direction only explained."""
        rows = np.flatnonzero(self._family == family)
        return self._expand(self._turn[rows], self._fits[rows], (family,))

    def room(self, turns: _IntArray, columns: _IntArray) -> tuple[FloatArray, FloatArray]:
        """(k,) bounds of where along its lines a robot is that sees these: from x for family 0, from y for family 1."""
        place = turns[:, None], np.arange(columns.shape[1]), columns
        middle, half = self._middle[place], self._half[place]
        low = np.where(columns >= 0, middle - half, -np.inf).max(axis=1, initial=-np.inf)
        return low, np.where(columns >= 0, middle + half, np.inf).min(axis=1, initial=np.inf)

    def _expand(self, turn: _IntArray, fits: NDArray[np.int8], explained: tuple[int, ...]) -> Matches:
        """Every choice among what fits (p, n, m); a line that fits nothing well may be left unexplained.

        explained: the families of which not all are left.
        """
        count = len(self._families)
        enough = fits.any(axis=2).sum(axis=1) >= count - self._unexplained
        turn, fits = turn[enough], fits[enough]
        options = np.empty((*fits.shape[:2], fits.shape[2] + 1), dtype=np.bool_)
        options[:, :, :-1] = fits
        options[:, :, -1] = fits.max(axis=2, initial=0) < 2
        parent, columns = self._choices(fits, options)
        columns[columns == fits.shape[2]] = -1
        turn = turn[parent]
        used = (columns >= 0).astype(np.float64) @ (self._families[:, None] == (0, 1))
        good = used.sum(axis=1) >= count - self._unexplained
        good &= (used[:, explained] > 0.0).all(axis=1)
        turn, columns = turn[good], columns[good]
        weights = weights_of(1 + count)
        rows, _ = distinct(columns @ weights[1:] + turn * weights[0])
        return Matches(turn[rows], columns[rows])

    def _choices(self, fits: NDArray[np.int8], options: NDArray[np.bool_]) -> tuple[_IntArray, _IntArray]:
        """Every choice (k, n) of one option (p, n, m) a line, and from which row it is (k,)."""
        count = options.sum(axis=2)
        choices = count.prod(axis=1, dtype=np.float64)
        if choices.sum() > _MOST:
            return self._likely_choices(fits, options)
        total = choices.astype(np.intp)
        parent = np.arange(len(options)).repeat(total)
        number = np.arange(len(parent)) - (total.cumsum() - total)[parent]
        # the options' numbers as digits of the choice's number
        base = count.cumprod(axis=1)
        digit = number[:, None] // (base // count)[parent] % count[parent]
        column = options.argsort(axis=2)[:, :, ::-1]
        return parent, column[parent[:, None], np.arange(options.shape[1]), digit]

    def _likely_choices(self, fits: NDArray[np.int8], options: NDArray[np.bool_]) -> tuple[_IntArray, _IntArray]:
        """The best of them, line by line."""
        parent, columns = np.arange(len(options)), options.argmax(axis=2)
        quality = np.zeros(options.shape, dtype=np.int8)
        quality[:, :, :-1] = fits
        total = np.zeros(len(options))
        for line in (options.sum(axis=2) > 1).any(axis=0).nonzero()[0].tolist():
            row, column = options[parent, line].nonzero()
            total = total[row] + quality[parent[row], line, column]
            if len(row) > _MOST:
                best = np.sort(np.argsort(-total, kind="stable")[:_MOST])
                row, column, total = row[best], column[best], total[best]
            parent, columns = parent[row], columns[row]
            columns[:, line] = column
        return parent, columns
