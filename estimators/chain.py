"""The whole past of one robot: poses in a row, the motion between neighbours, the factors on each."""

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from estimators.motion import STANDSTILL, Increment
from fieldloc import pose as se2
from fieldloc.factors import Factor
from fieldloc.pose import FloatArray

_ANYWHERE = np.diag([100.0, 100.0, 10.0]) ** 2  # of the motion of a robot that was carried


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """n nodes. motions[k] leads from node k to k + 1; factors are (node, factor).

    guess: (n, 3) poses to start a solver from.
    """

    stamps_ns: tuple[int, ...]
    motions: tuple[Increment, ...]
    factors: tuple[tuple[int, Factor], ...]
    guess: FloatArray


class ChainRecorder:
    """Collects a chain while motion and factors come in. Motion between nodes is added up."""

    def __init__(self, node_interval_s: float) -> None:
        self._interval_ns = int(node_interval_s * 1e9)
        self._stamps_ns: list[int] = []
        self._motions: list[Increment] = []
        self._factors: list[tuple[int, Factor]] = []
        self._guess: list[FloatArray | None] = []
        self._pending = STANDSTILL

    def advance(self, stamp_ns: int, motion: Increment | None, pose: FloatArray | None) -> None:
        """Motion up to a stamp, and where an online filter thinks that it led, None where it does not know."""
        if motion is not None:
            self._pending = self._pending.then(motion)
        if not self._stamps_ns or stamp_ns >= self._stamps_ns[-1] + self._interval_ns:
            self._node(stamp_ns, pose)

    def add(self, factor: Factor, stamp_ns: int, pose: FloatArray | None) -> None:
        """A factor at a stamp that `advance` has reached."""
        if not self._stamps_ns or stamp_ns > self._stamps_ns[-1]:
            self._node(stamp_ns, pose)
        self._guess[-1] = pose
        self._factors.append((len(self._stamps_ns) - 1, factor))

    def chain(self, carried_ns: Iterable[tuple[int, int]] = ()) -> Chain | None:
        """None while no pose is known. Before the first known pose the guess goes back along the motion.

        carried_ns: from when to when the robot was not where it was thought to be. It may have come from anywhere to
        the first node of such a time, and in its course the guess goes back from its end.
        """
        first = next((k for k, pose in enumerate(self._guess) if pose is not None), None)
        if first is None:
            return None
        guess = [np.zeros(3)] * len(self._guess)
        for k in range(first, len(guess)):
            known = self._guess[k]
            guess[k] = se2.compose(guess[k - 1], self._motions[k - 1].before_from_after) if known is None else known
        motions = self._motions.copy()
        backwards = [(0, first)]
        for since_ns, found_ns in carried_ns:
            since, found = bisect_left(self._stamps_ns, since_ns), bisect_left(self._stamps_ns, found_ns)
            backwards.append((since, min(found, len(guess) - 1)))
            if since > 0:
                motions[since - 1] = replace(motions[since - 1], covariance=_ANYWHERE)
        for start, end in backwards:
            for k in reversed(range(start, end)):
                guess[k] = se2.compose(guess[k + 1], se2.inverse(self._motions[k].before_from_after))
        return Chain(tuple(self._stamps_ns), tuple(motions), tuple(self._factors), np.array(guess))

    def _node(self, stamp_ns: int, pose: FloatArray | None) -> None:
        if self._stamps_ns:
            self._motions.append(self._pending)
        self._pending = STANDSTILL
        self._stamps_ns.append(stamp_ns)
        self._guess.append(pose)
