"""Which landmark is which, and from where: unidentified landmarks by their bearings alone.

Sugihara's identical landmarks (1988): three of the bearings are laid onto every ordered triple of landmarks, and each
pose that follows is kept if it explains the other bearings. Triples grow with the cube of the map, and each is held
against all of it: fine for a field's posts and a few dozen landmarks.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from scipy.special import chdtri

from fieldloc.covariance import check_covariance
from fieldloc.fixes.inputs import exactly, posts_covariance_of
from fieldloc.fixes.labelling import LabelledFix
from fieldloc.fixes.pair_search import GATE_1, MISSED, IntArray, Match
from fieldloc.fixes.resection import resection_fix, three_point_resection
from fieldloc.pose import FloatArray, wrap

_OUTLIER_SHARE = 0.02
_FORGOTTEN = 20.0  # log weight below the best one's, where a solution is as good as impossible
_CHUNK = 20_000  # triples at a time: some tens of megabytes on a map of fifty
_WIDTH = 3_000  # identifications followed at a time
_ROUNDS = 2

Bounds = tuple[float, float, float, float]


def label_bearings(
    positions: FloatArray,
    bearings_rad: FloatArray,
    covariance: FloatArray,
    positions_covariance: FloatArray | None = None,
    robot_from_sensor: FloatArray | None = None,
    *,
    within: Bounds | None = None,
    max_unexplained: int | None = None,
    max_solutions: int = 64,
) -> tuple[LabelledFix, ...]:
    """All identifications of the bearings with landmarks of the map, and the poses that follow, best first.

    positions: (m, 2) of all landmarks on the map, metres, field frame; positions_covariance: (m, 2, 2) of these.
    bearings_rad: (n,), n >= 3, counter-clockwise from the sensor's forward axis; covariance: (n, n) of these.
    within: (xmin, ymin, xmax, ymax) where the sensor can be; anywhere if not given. From somewhere, three bearings fit
        almost any triple of landmarks, so this is what leaves few solutions.
    max_unexplained: how many bearings may be no landmark of the map; a third of them less one if not given.
    Of each 20,000 triples the 3,000 likeliest identifications are followed from bearing to bearing, and the
    `max_solutions` likeliest of all are fitted. log_weight is as in `LabelledFix`, with outliers spread evenly over all
    bearings.
    Raises ValueError for shapes that do not fit and a covariance that is not positive definite.
    """
    n, m = len(bearings_rad), len(positions)
    exactly(positions, (m, 2), "positions")
    exactly(bearings_rad, (n,), "bearings_rad")
    exactly(covariance, (n, n), "covariance")
    posts_covariance_of(positions_covariance, m)
    if n < 3 or m < 3 or not (np.isfinite(bearings_rad).all() and np.isfinite(positions).all()):
        return ()
    noise = check_covariance(covariance, n)
    allowed = max(n // 3 - 1, 0) if max_unexplained is None else min(max_unexplained, n - 3)
    spread = np.zeros(m) if positions_covariance is None else np.trace(positions_covariance, axis1=-2, axis2=-1)
    best: dict[Match, float] = {}
    search = _Search(positions, spread, bearings_rad, noise, allowed)
    for triple in _triples(bearings_rad, allowed):
        for cost, match in search.matches(triple, within):
            best[match] = min(cost, best.get(match, math.inf))
    found: list[LabelledFix] = []
    for match, _ in sorted(best.items(), key=lambda item: item[1])[:max_solutions]:
        index = np.array(match)
        explained = np.flatnonzero(index >= 0)
        which = index[explained]
        prior = len(which) * math.log((1.0 - _OUTLIER_SHARE) / m)
        prior += (n - len(which)) * math.log(_OUTLIER_SHARE / math.tau)
        fixes = resection_fix(
            positions[which],
            bearings_rad[explained],
            noise[np.ix_(explained, explained)],
            None if positions_covariance is None else positions_covariance[which],
            robot_from_sensor,
        )
        chi2_each = np.zeros(n)
        for fix in fixes:
            if len(which) > 3 and fix.chi2 > chdtri(len(which) - 3, MISSED):
                continue
            chi2_each[explained] = fix.chi2_each
            found.append(
                LabelledFix(
                    pose=fix.pose,
                    covariance=fix.covariance,
                    log_weight=fix.log_weight + prior,
                    solver="label_bearings",
                    chi2=fix.chi2,
                    chi2_each=chi2_each,
                    nonlinearity=fix.nonlinearity,
                    matches=tuple(j if j >= 0 else None for j in match),
                )
            )
    found.sort(key=lambda fix: -fix.log_weight)
    return tuple(fix for fix in found if fix.log_weight > found[0].log_weight - _FORGOTTEN)


def _triples(bearings: FloatArray, allowed: int) -> Iterator[tuple[int, int, int]]:
    """Triples of bearings of which at least one holds no outlier, those that point most widely apart first.

    And once more, for a robot close to one of the landmarks is hard to place from that triple.
    """

    def spread(triple: tuple[int, ...]) -> float:
        return min(abs(math.sin(bearings[i] - bearings[j])) for i, j in combinations(triple, 2))

    options = sorted(combinations(range(len(bearings)), 3), key=spread, reverse=True)
    if 3 * (allowed + 1) > len(bearings):
        yield from options
        return
    taken: set[tuple[int, int, int]] = set()
    for _ in range(_ROUNDS):
        used: set[int] = set()
        for triple in options:
            if triple not in taken and used.isdisjoint(triple) and len(used) < 3 * (allowed + 1):
                used.update(triple)
                taken.add(triple)
                yield triple


@dataclass(frozen=True, slots=True)
class _Beam:
    """Identifications under way: matches (h, n), poses (h, 3), their covariance (h, 3, 3), cost (h), misses (h)."""

    matches: IntArray
    poses: FloatArray
    covariance: FloatArray
    cost: FloatArray
    missed: IntArray

    def take(self, rows: IntArray) -> "_Beam":
        return _Beam(self.matches[rows], self.poses[rows], self.covariance[rows], self.cost[rows], self.missed[rows])


class _Search:
    """Every ordered triple of landmarks for three of the bearings, then one bearing after the other.

    The cost is -2 log-likelihood up to a constant; each bearing corrects the pose that it confirms, as a Kalman filter
    would, so that the next one is held against a better pose.
    """

    def __init__(
        self, positions: FloatArray, spread: FloatArray, bearings: FloatArray, noise: FloatArray, allowed: int
    ) -> None:
        self._positions, self._spread, self._allowed = positions, spread, allowed
        self._bearings, self._noise = bearings, noise
        # an outlier is spread over all bearings, and there are as many ways to be no outlier as there are landmarks
        self._missed_cost = 2.0 * math.log((1.0 - _OUTLIER_SHARE) / _OUTLIER_SHARE * math.tau / len(positions))

    def matches(self, triple: tuple[int, int, int], within: Bounds | None) -> Iterator[tuple[float, Match]]:
        """The likeliest identifications that follow from three of the bearings, with their cost."""
        everything = np.array(list(permutations(range(len(self._positions)), 3)))
        for start in range(0, len(everything), _CHUNK):
            beam = self._start(list(triple), everything[start : start + _CHUNK], within)
            for o in range(len(self._bearings)):
                if o not in triple:
                    beam = self._extend(beam, o)
            yield from zip(beam.cost.tolist(), map(tuple, beam.matches.tolist()), strict=True)

    def _start(self, seen: list[int], on_map: IntArray, within: Bounds | None) -> _Beam:
        poses, solved = three_point_resection(self._positions[on_map], self._bearings[seen])
        if within is not None:
            x, y = poses[:, 0], poses[:, 1]
            solved &= (x >= within[0]) & (x <= within[2]) & (y >= within[1]) & (y <= within[3])
        on_map, poses = on_map[solved], poses[solved]
        _, rows, far = _expected(self._positions[on_map], poses)
        # row scale: metres against radians, so that the determinant tells a danger circle from a small field
        known = np.abs(np.linalg.det(rows)) * far.mean(axis=1) ** 2 > 1e-6
        rows, far, on_map, poses = rows[known], far[known], on_map[known], poses[known]
        noise = self._noise[np.ix_(seen, seen)] + np.eye(3) * (self._spread[on_map] / far**2)[:, None, :]
        gain = np.linalg.inv(rows)
        matches = np.full((len(on_map), len(self._bearings)), -1)
        matches[:, seen] = on_map
        nothing = np.zeros(len(on_map))
        return _Beam(matches, poses, gain @ noise @ np.swapaxes(gain, -1, -2), nothing, nothing.astype(np.int64))

    def _extend(self, beam: _Beam, o: int) -> _Beam:
        """With one more bearing: each landmark it can be, or none."""
        expected, rows, distance = _expected(self._positions, beam.poses)
        off = wrap(self._bearings[o] - expected)
        by_pose = rows @ beam.covariance
        variance = np.sum(by_pose * rows, axis=-1) + self._noise[o, o] + self._spread / distance**2
        chi2 = off**2 / variance
        fits = chi2 < GATE_1
        taken = np.zeros((len(fits), fits.shape[1] + 1), dtype=np.bool_)
        np.put_along_axis(taken, beam.matches, True, axis=1)  # -1 falls on the column too many
        h, j = np.nonzero(fits & ~taken[:, :-1])
        gain = by_pose[h, j] / variance[h, j, None]
        matched = beam.take(h)
        matched.matches[:, o] = j
        matched = _Beam(
            matched.matches,
            matched.poses + gain * off[h, j, None],
            matched.covariance - gain[:, :, None] * by_pose[h, j][:, None, :],
            matched.cost + chi2[h, j] + np.log(variance[h, j]),
            matched.missed,
        )
        missed = beam.take(np.flatnonzero(beam.missed < self._allowed))
        both = _Beam(
            np.concatenate([matched.matches, missed.matches]),
            np.concatenate([matched.poses, missed.poses]),
            np.concatenate([matched.covariance, missed.covariance]),
            np.concatenate([matched.cost, missed.cost + self._missed_cost]),
            np.concatenate([matched.missed, missed.missed + 1]),
        )
        return both.take(np.argsort(both.cost)[:_WIDTH])


def _expected(positions: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bearings (h, m) of landmarks (m, 2) or (h, m, 2) from poses (h, 3), their derivatives (h, m, 3), distances."""
    to = positions - poses[:, None, :2]
    distance = np.maximum(np.hypot(to[..., 0], to[..., 1]), 1e-9)
    squared = distance**2
    rows = np.stack([to[..., 1] / squared, -to[..., 0] / squared, np.full_like(squared, -1.0)], axis=-1)
    return np.arctan2(to[..., 1], to[..., 0]) - poses[:, None, 2], rows, distance
