"""A quick look at which observed points may be which landmarks: the pair search of Grimson & Lozano-Perez 1987.

Distances between two points do not depend on the pose, so a pair of observations is laid onto every pair of landmarks
that far apart, and the pose that follows is kept if it brings the other observations near landmarks. All in one
sweep of arrays, with errors that are the same in all directions until the last step.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fieldloc.pose import FloatArray

IntArray = NDArray[np.int64]
ComplexArray = NDArray[np.complex128]
Match = tuple[int, ...]
"""Per observation the landmark's index, -1 where unexplained."""

MISSED = 1e-4  # of what is right, by each gate
_ROUNDS = 2
_AT_ONCE = 1_000_000  # numbers
GATE_1, GATE_2 = float(chdtri(1, MISSED)), float(chdtri(2, MISSED))


def search_pairs(
    positions: FloatArray,
    survey: FloatArray,
    points: FloatArray,
    points_covariance: FloatArray,
    allowed: int,
    unexplained_cost: float,
) -> list[tuple[float, Match]]:
    """Identifications that leave about `allowed` observations unexplained, each once, with their cost.

    positions: (m, 2), survey: (m, 2, 2) of the landmarks. points: (n, 2), points_covariance: (n, 2, 2) as seen, in
    the sensor's frame. The cost is chi2 at a rough pose, and `unexplained_cost` for each observation without landmark.
    """
    if len(positions) < 2 or len(points) < 2:
        return []
    sweep = _Sweep(positions, survey, points, points_covariance, allowed, unexplained_cost)
    best: dict[Match, float] = {}
    for seen, on_map in sweep.pairs():
        for rows in _blocks(len(on_map), len(points) * len(positions)):
            for cost, match in sweep.refine(sweep.verify(seen[rows], on_map[rows])):
                best[match] = min(cost, best.get(match, math.inf))
    return [(cost, match) for match, cost in best.items()]


def _blocks(count: int, numbers: int) -> Iterator[slice]:
    """Of rows of so many numbers."""
    size = max(1, _AT_ONCE // numbers)
    return (slice(first, first + size) for first in range(0, count, size))


class _Sweep:
    def __init__(
        self,
        positions: FloatArray,
        survey: FloatArray,
        points: FloatArray,
        covariance: FloatArray,
        allowed: int,
        unexplained_cost: float,
    ) -> None:
        self._map = _complex(positions - positions.mean(axis=0))
        self._points, self._covariance = points, covariance
        self._seen = _complex(points)
        self._survey = np.trace(survey, axis1=-2, axis2=-1)
        self._trace = np.trace(covariance, axis1=-2, axis2=-1) + np.trace(survey.max(axis=0))
        self._allowed, self._unexplained_cost = allowed, unexplained_cost

    def pairs(self) -> Iterator[tuple[IntArray, IntArray]]:
        """Pairs of observations (s, 2) of which at least one holds no outlier, and of landmarks (s, 2) as far apart.

        Each outlier spoils one of as many separate pairs as there may be outliers, and one more is left over. Those
        that leave the fewest poses are taken; and once more, for `verify` can be misled by an outlier near a landmark.
        """
        i, k = np.triu_indices(len(self._points), 1)
        along = self._points[k] - self._points[i]
        apart2 = (along * along).sum(axis=1)
        i, k, along, apart2 = (each[apart2 > 0.0] for each in (i, k, along, apart2))
        noise = self._covariance[i] + self._covariance[k]
        variance = np.einsum("pi,pij,pj->p", along, noise, along) / apart2
        across = np.trace(noise, axis1=1, axis2=2) - variance
        one, other = np.triu_indices(len(self._map), 1)
        distance, survey = np.abs(self._map[one] - self._map[other]), self._survey[one] + self._survey[other]

        def as_far(pairs: IntArray | slice) -> NDArray[np.bool_]:
            """(p, l) which landmarks are as far apart as the observations."""
            off = distance - np.sqrt(apart2[pairs, None])
            return np.asarray(off * off < GATE_1 * (variance[pairs, None] + survey))

        counts = [np.count_nonzero(as_far(part), axis=1) for part in _blocks(len(i), len(one))]
        # how many poses follow, and how uncertain their headings are
        cost = np.concatenate([*counts, np.zeros(0)]) * (1.0 + 100.0 * across / apart2)
        chosen = self._separate(i, k, cost.argsort(kind="stable"))
        for part in _blocks(len(chosen), len(one)):
            pair, row = as_far(chosen[part]).nonzero()
            pair, first, second = chosen[part][pair], one[row], other[row]
            seen = np.stack([i[pair], k[pair]], axis=-1)
            yield np.concatenate([seen, seen]), np.stack([np.append(first, second), np.append(second, first)], axis=-1)

    def _separate(self, i: IntArray, k: IntArray, order: IntArray) -> IntArray:
        """Which pairs of observations to take, in that order."""
        if 2 * (self._allowed + 1) > len(self._points):
            return order
        taken: list[int] = []
        for _ in range(_ROUNDS):
            used: set[int] = set()
            for pair in order.tolist():
                both = {int(i[pair]), int(k[pair])}
                if pair not in taken and not used & both and len(used) < 2 * (self._allowed + 1):
                    used |= both
                    taken.append(pair)
        return np.array(taken, dtype=np.intp)

    def verify(self, pairs: IntArray, on_map: IntArray) -> IntArray:
        """Lay pairs of observations (s, 2) onto pairs of landmarks (s, 2), and match the others to the nearest: (h, n).

        The nearest ones come first, and each that finds its landmark joins the alignment on which the next one relies.
        """
        n, rows = len(self._seen), np.arange(len(pairs))[:, None]
        seen, weight = self._seen[pairs], 1.0 / self._trace[pairs]
        far = np.abs(self._seen - 0.5 * seen.sum(axis=1, keepdims=True)) + self._trace
        far[rows, pairs] = np.inf
        order = far.argsort(axis=1)
        matches = np.full((len(pairs), n), -1)
        matches[rows, pairs] = on_map
        missed = np.zeros(len(pairs), dtype=np.intp)
        sums = _sums(self._map[on_map], seen, weight).sum(axis=-1)
        for step in range(n - 2):
            o = order[:, step]
            lands, _, slack = _aligned(sums, self._seen[o])
            nearest, off2 = self._nearest(lands)
            near = off2 < GATE_2 * (self._trace[o] + slack)
            missed += ~near
            (kept,) = (missed <= self._allowed).nonzero()
            o, near, nearest = o[kept], near[kept], nearest[kept]
            order, missed, matches = order[kept], missed[kept], matches[kept]
            matches[np.arange(len(kept)), o] = np.where(near, nearest, -1)
            sums = sums[:, kept] + _sums(self._map[nearest], self._seen[o], near / self._trace[o])
        return matches

    def refine(self, matches: IntArray) -> list[tuple[float, Match]]:
        """Align each identification (h, n) as a whole, without what fits worst, and match once more, one to one."""
        if not len(matches):
            return []
        rows = np.arange(len(matches))
        weight = (matches >= 0) / self._trace
        for _ in range(self._allowed + 1):
            sums = _sums(self._map[matches], self._seen, weight).sum(axis=-1, keepdims=True)
            lands, turn, slack = _aligned(sums, self._seen)
            residual = lands - self._map[matches]
            off = (residual.real**2 + residual.imag**2) * weight
            worst = off.argmax(axis=1)
            bad = (off[rows, worst] > GATE_2 / 2) & ((weight > 0).sum(axis=1) > len(self._seen) - self._allowed)
            if not bad.any():
                break
            weight[rows[bad], worst[bad]] = 0.0
        nearest, _ = self._nearest(lands)
        # chi2 of the miss in the sensor's frame, with room for the error of the alignment
        miss = (self._map[nearest] - lands) * turn.conj()
        more = 0.5 * (slack + self._survey[nearest])
        xx = self._covariance[:, 0, 0] + more
        yy = self._covariance[:, 1, 1] + more
        xy = self._covariance[:, 0, 1]
        chi2 = (yy * miss.real**2 - 2 * xy * miss.real * miss.imag + xx * miss.imag**2) / (xx * yy - xy**2)
        out = np.where(chi2 < GATE_2, nearest, -1)
        out[_is_nearer_to_another(out, chi2)] = -1
        cost = np.where(out >= 0, chi2, self._unexplained_cost).sum(axis=1)
        # one more than allowed: a closer look may still find it a landmark
        enough = (out < 0).sum(axis=1) <= self._allowed + 1
        return list(zip(cost[enough].tolist(), map(tuple, out[enough].tolist()), strict=True))

    def _nearest(self, points: ComplexArray) -> tuple[IntArray, FloatArray]:
        """Landmark nearest to each of the points (...), and squared distance."""
        x, y = points.real[..., None] - self._map.real, points.imag[..., None] - self._map.imag
        x *= x
        y *= y
        x += y
        nearest = x.argmin(axis=-1)
        return nearest, np.take_along_axis(x, nearest[..., None], axis=-1)[..., 0]


def _is_nearer_to_another(matches: IntArray, chi2: FloatArray) -> NDArray[np.bool_]:
    """(h, n) whose landmark fits another observation better, or as well and that one comes first."""
    same = (matches[:, :, None] == matches[:, None]) & (matches >= 0)[:, :, None]
    better = chi2[:, None] < chi2[:, :, None]
    first = np.tri(matches.shape[1], k=-1, dtype=np.bool_)
    return np.asarray((same & (better | ((chi2[:, None] == chi2[:, :, None]) & first))).any(axis=2))


def _sums(there: ComplexArray, seen: ComplexArray, weight: FloatArray) -> ComplexArray:
    """(5, ...) of which sums make the alignment of points seen with where they are on the map."""
    weighted = weight * there
    return np.stack([weight + 0j, weighted, weight * seen, weighted * seen.conj(), weight * np.abs(seen) ** 2 + 0j])


def _aligned(sums: ComplexArray, seen: ComplexArray) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Where points (...) land on the map by rigid alignments (5, ...), how these turn, and the mean square of what the
    errors of what was aligned move each point by."""
    total = np.maximum(sums[0].real, 1e-300)
    anchor, seen_anchor = sums[1] / total, sums[2] / total
    turn = sums[3] - sums[1] * seen_anchor.conj()
    turn /= np.maximum(np.abs(turn), 1e-300)
    inertia = np.maximum(sums[4].real - total * np.abs(seen_anchor) ** 2, 1e-300)
    lever = seen - seen_anchor
    return anchor + turn * lever, turn, 1.0 / total + np.abs(lever) ** 2 / inertia


def _complex(points: FloatArray) -> ComplexArray:
    """x + iy."""
    return np.asarray(points[..., 0] + 1j * points[..., 1])
