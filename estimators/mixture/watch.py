"""What befalls the hypotheses, as a few sentences."""

import numpy as np

from estimators.base import Event, EventKind
from estimators.mixture.bank import Bank
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_MAJOR = 0.01
_MINOR = 0.001  # one that was major is it no more
_DECIDED = 0.99
_OPEN = 0.9  # decided no more


class Watch:
    """Looks at the hypotheses after each observation."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self._major: set[int] = set()
        self._place_decided = self._side_decided = False

    def begin(self, stamp_ns: int, text: str) -> None:
        """After a start, told or found."""
        self._say(stamp_ns, "start", text)

    def forget(self, decided: bool) -> None:
        """All that was known is no more. decided: now there is one place only."""
        self._major = set()
        self._place_decided = self._side_decided = decided

    def merges(self, stamp_ns: int, before: Bank, into: IntArray) -> None:
        """before: not yet merged; (h,) row of the merged bank in which each now is."""
        parents, weights = before.parents, np.exp(before.totals)
        major = (weights >= _MAJOR) & (parents >= 0)
        families = {(row, parent) for row, parent in zip(into[major].tolist(), parents[major].tolist(), strict=True)}
        if joined := len(families) - len({row for row, _ in families}):
            self._say(stamp_ns, "merge", f"{joined + 1} hypotheses came together")

    def look(self, stamp_ns: int, weights: FloatArray, tracks: IntArray, first: tuple[int, int], other: float) -> None:
        """weights, tracks: (h, c). first: row and copy of the best. other: probability of the other sides."""
        known = bool(self._major)
        major = set(tracks[weights >= _MAJOR].tolist())
        alive = major if len(weights) == 1 and weights.shape[1] == 1 else set(tracks[weights >= _MINOR].tolist())
        if known and (new := major - self._major):
            self._say(stamp_ns, "split", f"{len(new)} more to choose from: {len(major)} places are likely")
        self._major = (self._major & alive) | major
        place, side = float(weights[first]), 1.0 - other
        if place >= _DECIDED and not self._place_decided:
            self._say(stamp_ns, "decision", "one place is 99 % likely")
            self._place_decided = self._side_decided = True
        elif side >= _DECIDED and not self._side_decided:
            self._say(stamp_ns, "decision", "one side is 99 % likely")
            self._side_decided = True
        self._place_decided &= place >= _OPEN
        self._side_decided &= side >= _OPEN

    def recovered(self, stamp_ns: int) -> None:
        self._say(stamp_ns, "recovery", "the robot was carried: it was found elsewhere")

    def _say(self, stamp_ns: int, kind: EventKind, text: str) -> None:
        self.events.append(Event(stamp_ns, kind, text))
