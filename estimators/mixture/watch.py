"""What befalls the hypotheses, as a few sentences: of those only that differ by what a person would call a place."""

import math

import numpy as np
from numpy.typing import NDArray

from estimators.base import Event, EventKind
from estimators.mixture import report
from estimators.mixture.bank import Bank
from estimators.mixture.sides import Sides, distance
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_PLACE_M = 0.5
_LIKELY = 0.05
_GONE = 0.01
_LOG_GONE = math.log(_GONE)
_DECIDED = 0.99
_OPEN = 0.9  # decided no more


class Watch:
    """Looks at the hypotheses after each observation."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self._known: set[int] = set()  # tracks of the places that were spoken of
        self._place_decided = self._side_decided = False

    def begin(self, stamp_ns: int, text: str) -> None:
        """After a start, told or found."""
        self._say(stamp_ns, "start", text)

    def recovered(self, stamp_ns: int) -> None:
        self._say(stamp_ns, "recovery", "the robot was carried: it was found elsewhere")

    def forget(self, decided: bool) -> None:
        """All that was known is no more. decided: now there is one place only."""
        self._known = set()
        self._place_decided = self._side_decided = decided

    def merges(self, stamp_ns: int, before: Bank, into: IntArray, tracks: IntArray) -> None:
        """before: the hypotheses (h,) not yet merged; row of the merged bank in which each now is. tracks: of their
        parents."""
        if not self._known or len(tracks) < 2:
            return
        known = {parent for parent, numbers in enumerate(tracks.tolist()) if not self._known.isdisjoint(numbers)}
        alive = np.flatnonzero(before.totals >= _LOG_GONE)
        pairs = zip(into[alive].tolist(), before.parents[alive].tolist(), strict=True)
        families = {(row, parent) for row, parent in pairs if parent in known}
        if joined := len(families) - len({row for row, _ in families}):
            self._say(stamp_ns, "merge", f"{joined + 1} places have become one")

    def after(
        self, stamp_ns: int, bank: Bank, sides: Sides, first: tuple[int, int], tracks: IntArray, lost: float
    ) -> None:
        """An observation. first: row and copy of the best; tracks (h, c); lost: probability of none of them."""
        weights, (row, copy) = np.exp(bank.log_weights), first
        if len(bank) == 1:  # its copies are places of their own
            other = float(weights.sum() - weights[first]) + lost * (1.0 - 1.0 / len(sides))
            if self._knows(weights[0], tracks[0], float(weights[first]), 1.0 - other):
                return
        else:
            other = report.mirrored(sides.of_one(copy, bank.poses[row]), bank, sides, lost)
        best = row * len(sides) + copy
        order = np.argsort(-bank.log_weights, axis=None, kind="stable")
        order = np.append(best, order[order != best])
        poses = sides.unfold(bank.poses).reshape(-1, 3)[order]
        self.look(stamp_ns, weights.ravel()[order], poses, tracks.ravel()[order], other)

    def _knows(self, weights: FloatArray, tracks: IntArray, place: float, side: float) -> bool:
        """Whether there is nothing to say of hypotheses (n,) at n places, the best of that probability, on a side of
        that: so it is most of the time."""
        here = weights >= _LIKELY
        decided = (self._place_decided and self._side_decided) if side >= _DECIDED else place >= _OPEN
        undecided = not self._side_decided and side < _DECIDED
        return (decided or undecided) and self._known == set(tracks[here].tolist())

    def look(self, stamp_ns: int, weights: FloatArray, poses: FloatArray, tracks: IntArray, other: float) -> None:
        """weights (n,), poses (n, 3) and tracks (n,) of all copies, the best one first. other: probability of the other
        sides."""
        place = float(weights[distance(poses, poses[0]) < _PLACE_M].sum())
        side = 1.0 - other
        if place >= _DECIDED and not self._place_decided:
            self._say(stamp_ns, "decision", "one place is 99 % likely")
            self._place_decided = self._side_decided = True
        elif side >= _DECIDED and not self._side_decided:
            self._say(stamp_ns, "decision", "one side is 99 % likely")
            self._side_decided = True
        self._place_decided &= place >= _OPEN
        self._side_decided &= side >= _OPEN
        self._split(stamp_ns, poses, tracks, weights)

    def _split(self, stamp_ns: int, poses: FloatArray, tracks: IntArray, weights: FloatArray) -> None:
        alive = weights >= _GONE
        known: NDArray[np.bool_] = np.isin(tracks, list(self._known)) & alive
        before = int(known.sum())
        for row in np.flatnonzero((weights >= _LIKELY) & ~known):
            if (distance(poses[known], poses[row]) >= _PLACE_M).all():
                known[row] = True
        count = int(known.sum())
        if before and count > before:
            self._say(stamp_ns, "split", f"{before} places have become {count}")
        self._known = set(tracks[known].tolist())

    def _say(self, stamp_ns: int, kind: EventKind, text: str) -> None:
        self.events.append(Event(stamp_ns, kind, text))
