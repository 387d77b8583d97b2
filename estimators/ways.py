"""A chain's motions in stages: from one node of interest to the next, and from each to the nodes in between."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.motion import CALIBRATION, Increment
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_LONGEST = 32  # nodes


@dataclass(frozen=True, slots=True, eq=False)
class Ways:
    """stops: (s,) nodes, the first and the last one among them. since: (n,) which stop each node is at or after.

    stages: (s - 1,) motions from stop to stop. moved (n, 3), by_calibration (n, 3, CALIBRATION): of the way from the
    stop before to each node; left, left_by_calibration: on to the next one. Zero at stops.
    """

    stops: IntArray
    since: IntArray
    stages: tuple[Increment, ...]
    moved: FloatArray
    by_calibration: FloatArray
    left: FloatArray
    left_by_calibration: FloatArray

    @classmethod
    def of(cls, motions: Sequence[Increment], nodes: IntArray) -> "Ways":
        """With stops at these nodes at least."""
        count = len(motions) + 1
        stops = np.unique(np.concatenate([nodes, np.arange(0, count, _LONGEST), [0, count - 1]])).astype(np.intp)
        since = np.searchsorted(stops, np.arange(count), side="right") - 1
        step = np.array([motion.before_from_after for motion in motions]).reshape(-1, 3)
        noise = np.array([motion.covariance for motion in motions]).reshape(-1, 3, 3)
        change = np.array([motion.by_calibration for motion in motions]).reshape(-1, 3, CALIBRATION)
        moved, by_calibration = np.zeros((count, 3)), np.zeros((count, 3, CALIBRATION))
        left, left_change = np.zeros((count, 3)), np.zeros((count, 3, CALIBRATION))
        first, lasts = stops[:-1], np.diff(stops)
        whole = [np.zeros((len(first), *like.shape[1:])) for like in (step, noise, change)]
        for k in range(1, int(lasts.max(initial=0)) + 1):
            rows = np.flatnonzero(lasts >= k)
            k_from = first[rows] + k - 1
            back = se2.adjoint(se2.inverse(step[k_from]))
            whole[0][rows] = se2.compose(whole[0][rows], step[k_from])
            whole[1][rows] = back @ whole[1][rows] @ np.swapaxes(back, 1, 2) + noise[k_from]
            whole[2][rows] = back @ whole[2][rows] + change[k_from]
            inner = rows[lasts[rows] > k]
            moved[first[inner] + k], by_calibration[first[inner] + k] = whole[0][inner], whole[2][inner]
        inner = np.flatnonzero(np.isin(np.arange(count), stops, invert=True))
        rows = since[inner]
        left[inner] = se2.between(moved[inner], whole[0][rows])
        # what a calibration changes on the way so far is carried on by the rest of it
        carried = se2.adjoint(se2.inverse(left[inner])) @ by_calibration[inner]
        left_change[inner] = whole[2][rows] - carried
        stages = tuple(map(Increment, *whole))
        return cls(stops, since, stages, moved, by_calibration, left, left_change)
