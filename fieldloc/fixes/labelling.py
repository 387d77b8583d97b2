"""Which landmark is which, and from where: unidentified landmarks by range and bearing.

Sugihara 1988 poses the problem (his identical landmarks). A quick search proposes identifications, the likeliest first;
each is fitted exactly, and what else its pose would allow is proposed in turn.
"""

import heapq
import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from fieldloc.fixes.inputs import exactly, semidefinite
from fieldloc.fixes.landmarks import LandmarkFix, landmark_fix
from fieldloc.fixes.pair_search import GATE_2, MISSED, Match, search_pairs
from fieldloc.pose import FloatArray, compose, wrap

_SUSPICIOUS = float(chdtri(2, 0.01))
_OUTLIER_SHARE = 0.02
_FORGOTTEN = 20.0  # log weight below the best one's, where a solution is as good as impossible
_FITS_PER_SOLUTION = 3
_DETOUR = 2  # more observations than allowed may stay unexplained on the way to a solution


@dataclass(frozen=True, slots=True)
class LabelledFix(LandmarkFix):
    """A fix that also says what was seen.

    matches: per observation the landmark's index on the map, None where the observation stays unexplained.
    log_weight: log-likelihood of all observations, comparable across the solutions of one scan. Those that stay
        unexplained are taken for outliers: 2 % of all observations, spread evenly over bearings and over ranges up to
        the farthest one seen. The others are shared evenly by the map's landmarks.
    chi2_each: 0 for what stays unexplained.
    """

    matches: tuple[int | None, ...] = ()


def label_landmarks(
    positions: FloatArray,
    range_bearing: FloatArray,
    covariance: FloatArray,
    positions_covariance: FloatArray | None = None,
    robot_from_sensor: FloatArray | None = None,
    *,
    max_unexplained: int | None = None,
    max_solutions: int = 32,
) -> tuple[LabelledFix, ...]:
    """All identifications of the observations with landmarks of the map, and the poses that follow, best first.

    positions: (m, 2) of all landmarks on the map, metres, field frame; positions_covariance: (m, 2, 2) of these.
    range_bearing: (n, 2) metres, radians, n >= 2; covariance: (n, 2, 2) of these, per landmark.
    max_unexplained: how many observations may be no landmark of the map; a quarter of them, rounded down, if not given.
    Left out is what a gate at 99.99 % rejects, what is e^20 times less likely than the best, and what is not among the
    likeliest, at most three times `max_solutions` identifications that are fitted. An outlier close to a landmark can
    mislead the search: with a fifth of the observations outliers it misses the right solution about once in a hundred.
    Raises ValueError for shapes that do not fit and a covariance that is not positive definite.
    """
    n, m = len(range_bearing), len(positions)
    exactly(positions, (m, 2), "positions")
    exactly(range_bearing, (n, 2), "range_bearing")
    semidefinite(exactly(covariance, (n, 2, 2), "covariance"), 2)
    if np.any(np.linalg.det(covariance) <= 0.0):
        raise ValueError("covariance of a range and bearing is not positive definite")
    survey = np.zeros((m, 2, 2))
    if positions_covariance is not None:
        survey = semidefinite(exactly(positions_covariance, (m, 2, 2), "positions_covariance"), 2)
    finite = bool(np.isfinite(range_bearing).all() and np.isfinite(positions).all())
    if n < 2 or m < 2 or not finite or range_bearing[:, 0].min() <= 0.0:
        return ()
    mount = np.zeros(3) if robot_from_sensor is None else exactly(robot_from_sensor, (3,), "robot_from_sensor")
    scan = _Scan(positions, survey, range_bearing, covariance, mount)
    allowed = n // 4 if max_unexplained is None else min(max_unexplained, n - 2)
    queue = scan.seeds(allowed)
    seen = {match for _, match in queue}
    heapq.heapify(queue)
    found: list[LabelledFix] = []
    cheapest = math.inf
    for _ in range(_FITS_PER_SOLUTION * max_solutions):
        if not queue or queue[0][0] > cheapest + 2.0 * _FORGOTTEN:
            break
        for fix in scan.fit(heapq.heappop(queue)[1]):
            explained = sum(j is not None for j in fix.matches)
            if explained >= n - allowed and fix.chi2 < chdtri(2 * explained - 3, MISSED):
                found.append(fix)
                cheapest = min(cheapest, fix.chi2 + (n - explained) * scan.unexplained_cost)
            for cost, match in scan.neighbours(fix, allowed + _DETOUR):
                if match not in seen:
                    seen.add(match)
                    heapq.heappush(queue, (cost, match))
    found.sort(key=lambda fix: -fix.log_weight)
    return tuple(fix for fix in found[:max_solutions] if fix.log_weight > found[0].log_weight - _FORGOTTEN)


class _Scan:
    """One scan and the map it must fit."""

    def __init__(
        self, positions: FloatArray, survey: FloatArray, seen: FloatArray, covariance: FloatArray, mount: FloatArray
    ) -> None:
        self._positions, self._survey, self._mount = positions, survey, mount
        self._seen, self._covariance = seen, covariance
        m = len(positions)
        self._log_match = math.log((1.0 - _OUTLIER_SHARE) / m)
        self._log_outlier = math.log(_OUTLIER_SHARE / (math.tau * float(seen[:, 0].max())))
        self.unexplained_cost = -2.0 * (self._log_outlier + math.log(m)) - np.log(np.linalg.det(covariance)).mean()
        self.unexplained_cost = max(self.unexplained_cost, GATE_2)

    def seeds(self, allowed: int) -> list[tuple[float, Match]]:
        """Identifications that explain all but about `allowed` observations at a glance, with their cost; each once."""
        r, b = self._seen[:, 0], self._seen[:, 1]
        along = np.stack([np.cos(b), np.sin(b)], axis=-1)
        across = np.stack([-along[:, 1], along[:, 0]], axis=-1) * r[:, None]
        by_seen = np.stack([along, across], axis=-1)
        points_covariance = by_seen @ self._covariance @ np.swapaxes(by_seen, -1, -2)
        points = r[:, None] * along
        return search_pairs(self._positions, self._survey, points, points_covariance, allowed, self.unexplained_cost)

    def fit(self, match: Match) -> list[LabelledFix]:
        """The poses of one identification, well or badly as they fit."""
        index = np.array(match)
        explained = np.flatnonzero(index >= 0)
        if len(explained) < 2:
            return []
        which = index[explained]
        fixes = landmark_fix(
            self._positions[which],
            self._seen[explained],
            self._covariance[explained],
            self._survey[which] if self._survey.any() else None,
            self._mount,
        )
        outliers = len(match) - len(which)
        prior = len(which) * self._log_match + outliers * self._log_outlier
        chi2_each = np.zeros(len(match))
        out = []
        for fix in fixes:
            chi2_each[explained] = fix.chi2_each
            out.append(
                LabelledFix(
                    pose=fix.pose,
                    covariance=fix.covariance,
                    log_weight=fix.log_weight + prior,
                    solver="label_landmarks",
                    chi2=fix.chi2,
                    chi2_each=chi2_each.copy(),
                    nonlinearity=fix.nonlinearity,
                    matches=tuple(j if j >= 0 else None for j in match),
                )
            )
        return out

    def neighbours(self, fix: LabelledFix, allowed: int) -> list[tuple[float, Match]]:
        """Identifications that differ in one or two observations and still fit the pose, with their cost.

        Up to `allowed` observations stay unexplained.
        """
        match = [-1 if j is None else j for j in fix.matches]
        chi2 = self._chi2_of_all(fix)
        explained_cost = [chi2[o, j] if j >= 0 else self.unexplained_cost for o, j in enumerate(match)]
        total = sum(explained_cost)
        out: list[tuple[float, Match]] = []
        for o, j in np.argwhere(chi2 < GATE_2).tolist():
            if j == match[o]:
                continue
            other, cost = match.copy(), total - explained_cost[o] + chi2[o, j]
            other[o] = j
            if j in match:
                p = match.index(j)
                swapped = match[o] >= 0 and chi2[p, match[o]] < GATE_2
                other[p] = match[o] if swapped else -1
                cost += (chi2[p, match[o]] if swapped else self.unexplained_cost) - explained_cost[p]
            if other.count(-1) <= allowed:
                out.append((float(cost), tuple(other)))
        worst = int(np.argmax(fix.chi2_each))
        if match.count(-1) < allowed and fix.chi2_each[worst] > _SUSPICIOUS:
            match[worst] = -1
            out.append((float(total - explained_cost[worst] + self.unexplained_cost), tuple(match)))
        return out

    def _chi2_of_all(self, fix: LabelledFix) -> FloatArray:
        """(n, m): how badly each observation fits each landmark from the pose, its uncertainty included."""
        sensor = compose(fix.pose, self._mount)
        to = self._positions - sensor[:2]
        d = np.maximum(np.hypot(to[:, 0], to[:, 1]), 1e-9)
        u = to / d[:, None]
        v = np.stack([-u[:, 1], u[:, 0]], axis=-1) / d[:, None]
        by_landmark = np.stack([u, v], axis=1)
        arm = sensor[:2] - fix.pose[:2]
        by_heading = -by_landmark @ np.array([-arm[1], arm[0]]) - np.array([0.0, 1.0])
        by_pose = np.concatenate([-by_landmark, by_heading[..., None]], axis=-1)
        expected = by_pose @ fix.covariance @ np.swapaxes(by_pose, -1, -2)
        expected += by_landmark @ self._survey @ np.swapaxes(by_landmark, -1, -2)
        total = self._covariance[:, None] + expected
        error_range = self._seen[:, :1] - d
        error_bearing = wrap(self._seen[:, 1:] - np.arctan2(to[:, 1], to[:, 0]) + sensor[2])
        rr, rb, bb = total[..., 0, 0], total[..., 0, 1], total[..., 1, 1]
        return np.asarray(
            (bb * error_range**2 - 2 * rb * error_range * error_bearing + rr * error_bearing**2) / (rr * bb - rb**2)
        )
