"""A quick look at which observed points may be which landmarks: the pair search of Grimson & Lozano-Perez 1987.

Distances between two points do not depend on the pose, so a pair of observations is laid onto every pair of landmarks
that far apart, and the pose that follows is kept if it brings the other observations near landmarks. All in one
sweep of arrays, with errors that are the same in all directions until the last step.
"""

import math
from collections.abc import Iterator
from itertools import combinations

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
    sweep = _Sweep(positions, survey, points, points_covariance, allowed, unexplained_cost)
    best: dict[Match, float] = {}
    for i, k, on_map in sweep.pairs():
        for cost, match in sweep.refine(sweep.verify(i, k, on_map)):
            best[match] = min(cost, best.get(match, math.inf))
    return [(cost, match) for match, cost in best.items()]


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
        self._positions, self._survey = positions, survey
        self._map = _complex(positions)
        self._points, self._covariance = points, covariance
        self._seen = _complex(points)
        self._trace = np.trace(covariance, axis1=-2, axis2=-1) + np.trace(survey.max(axis=0))
        self._allowed, self._unexplained_cost = allowed, unexplained_cost

    def pairs(self) -> Iterator[tuple[int, int, IntArray]]:
        """Pairs of observations of which at least one holds no outlier, and the pairs of landmarks (s, 2) as far apart.

        Each outlier spoils one of as many separate pairs as there may be outliers, and one more is left over. Those
        that leave the fewest poses are taken; and once more, for `verify` can be misled by an outlier near a landmark.
        """
        n = len(self._points)
        distance = np.abs(self._map[None] - self._map[:, None])
        np.fill_diagonal(distance, np.inf)
        spread = np.trace(self._survey, axis1=-2, axis2=-1)
        survey = spread[:, None] + spread
        options: list[tuple[float, int, int, IntArray]] = []
        for i, k in combinations(range(n), 2):
            along = self._points[k] - self._points[i]
            apart = math.hypot(along[0], along[1])
            if apart == 0.0:
                continue
            along /= apart
            noise = self._covariance[i] + self._covariance[k]
            variance = float(along @ noise @ along)
            across = float(np.trace(noise)) - variance
            on_map = np.argwhere((distance - apart) ** 2 < GATE_1 * (variance + survey))
            # how many poses follow, and how uncertain their headings are
            options.append((len(on_map) * (1.0 + 100.0 * across / apart**2), i, k, on_map))
        options.sort(key=lambda option: option[0])
        if 2 * (self._allowed + 1) > n:
            yield from ((i, k, on_map) for _, i, k, on_map in options)
            return
        taken: set[tuple[int, int]] = set()
        for _ in range(_ROUNDS):
            used: set[int] = set()
            for _, i, k, on_map in options:
                if (i, k) not in taken and i not in used and k not in used and len(used) < 2 * (self._allowed + 1):
                    used |= {i, k}
                    taken.add((i, k))
                    yield i, k, on_map

    def verify(self, i: int, k: int, on_map: IntArray) -> IntArray:
        """Lay observations i and k onto each pair of landmarks (s, 2), and match the others to the nearest: (h, n).

        The nearest ones come first, and each that finds its landmark joins the alignment on which the next one relies.
        """
        pair = [i, k]
        n = len(self._seen)
        matches = np.full((len(on_map), n), -1)
        matches[:, pair] = on_map
        weight = np.zeros((len(on_map), n))
        weight[:, pair] = 1.0 / self._trace[pair]
        missed = np.zeros(len(on_map))
        far = np.abs(self._seen - self._seen[pair].mean())
        for o in [int(o) for o in np.argsort(far + self._trace) if o not in pair]:
            anchor, seen_anchor, turn, slack = self._align(matches, weight)
            off = np.abs((anchor + turn * (self._seen[o] - seen_anchor))[:, None] - self._map)
            nearest = np.argmin(off, axis=1)
            near = off[np.arange(len(off)), nearest] ** 2 < GATE_2 * (self._trace[o] + slack[:, o])
            matches[:, o] = np.where(near, nearest, -1)
            weight[:, o] = near / self._trace[o]
            missed += ~near
            keep = missed <= self._allowed
            matches, weight, missed = matches[keep], weight[keep], missed[keep]
        return matches

    def refine(self, matches: IntArray) -> list[tuple[float, Match]]:
        """Align each identification (h, n) as a whole, without what fits worst, and match once more, one to one."""
        if not len(matches):
            return []
        rows = np.arange(len(matches))
        weight = (matches >= 0) / self._trace
        for _ in range(self._allowed + 1):
            anchor, seen_anchor, turn, slack = self._align(matches, weight)
            residual = np.abs(
                anchor[:, None] + turn[:, None] * (self._seen - seen_anchor[:, None]) - self._map[matches]
            )
            off = residual**2 * weight
            worst = np.argmax(off, axis=1)
            bad = (off[rows, worst] > GATE_2 / 2) & ((weight > 0).sum(axis=1) > len(self._seen) - self._allowed)
            if not bad.any():
                break
            weight[rows[bad], worst[bad]] = 0.0
        lands = anchor[:, None] + turn[:, None] * (self._seen - seen_anchor[:, None])
        to = self._map[None, None] - lands[..., None]
        nearest = np.argmin(np.abs(to), axis=-1)
        # chi2 of the miss in the sensor's frame, with room for the error of the alignment
        miss = np.take_along_axis(to, nearest[..., None], axis=-1)[..., 0] * np.conj(turn)[:, None]
        more = 0.5 * (slack + np.trace(self._survey, axis1=-2, axis2=-1)[nearest])
        xx = self._covariance[:, 0, 0] + more
        yy = self._covariance[:, 1, 1] + more
        xy = self._covariance[:, 0, 1]
        chi2 = (yy * miss.real**2 - 2 * xy * miss.real * miss.imag + xx * miss.imag**2) / (xx * yy - xy**2)
        out = np.where(chi2 < GATE_2, nearest, -1)
        for o in range(1, out.shape[1]):
            for p in range(o):
                same = (out[:, o] == out[:, p]) & (out[:, o] >= 0)
                out[same & (chi2[:, o] >= chi2[:, p]), o] = -1
                out[same & (chi2[:, o] < chi2[:, p]), p] = -1
        cost = np.where(out >= 0, chi2, self._unexplained_cost).sum(axis=1)
        # one more than allowed: a closer look may still find it a landmark
        enough = (out < 0).sum(axis=1) <= self._allowed + 1
        return list(zip(cost[enough].tolist(), map(tuple, out[enough].tolist()), strict=True))

    def _align(
        self, matches: IntArray, weight: FloatArray
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray, FloatArray]:
        """Rigid alignments (h): landmark = anchor + turn (seen - seen_anchor), weighted by (h, n).

        The last one is the mean square (h, n) of what their errors move each observation by.
        """
        total = np.maximum(weight.sum(axis=1), 1e-300)
        there = self._map[matches]
        anchor = (weight * there).sum(axis=1) / total
        seen_anchor = (weight * self._seen).sum(axis=1) / total
        lever = self._seen - seen_anchor[:, None]
        turn = (weight * (there - anchor[:, None]) * np.conj(lever)).sum(axis=1)
        turn /= np.maximum(np.abs(turn), 1e-300)
        squared = np.abs(lever) ** 2
        inertia = np.maximum((weight * squared).sum(axis=1), 1e-300)
        return anchor, seen_anchor, turn, 1.0 / total[:, None] + squared / inertia[:, None]


def _complex(points: FloatArray) -> ComplexArray:
    """x + iy."""
    return np.asarray(points[..., 0] + 1j * points[..., 1])
