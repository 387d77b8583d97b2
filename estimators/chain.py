"""The whole past of one robot: poses in a row, the motion between neighbours, the factors on each."""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from estimators.motion import CALIBRATION, STANDSTILL, Increment
from estimators.sensor import lever, seen_from
from fieldloc import pose as se2
from fieldloc.factors import Factor
from fieldloc.mixture import IntArray, MixtureFactor
from fieldloc.pose import FloatArray

Factors = Callable[[int, int], tuple[Factor, ...]]
ANYWHERE = np.diag([100.0, 100.0, 10.0]) ** 2
"""Covariance (3, 3) of the motion of a robot that was carried."""


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """n nodes. motions[k] leads from node k to k + 1; factors are (node, factor).

    guess: (n, 3) poses to start a solver from.
    """

    stamps_ns: tuple[int, ...]
    motions: tuple[Increment, ...]
    factors: tuple[tuple[int, Factor], ...]
    guess: FloatArray

    def velocities(self, calibration: FloatArray) -> FloatArray:
        """(n, 3) of the robot just before each node, robot frame, m/s and rad/s, by an odometry of that calibration
        (CALIBRATION,)."""
        if not self.motions:
            return np.zeros((len(self.stamps_ns), 3))
        moved = np.array([motion.before_from_after for motion in self.motions])
        by_calibration = np.array([motion.by_calibration for motion in self.motions])
        return velocities(moved, by_calibration @ calibration, np.diff(self.stamps_ns).astype(np.float64) * 1e-9)

    def levers(self, calibration: FloatArray) -> FloatArray:
        """(n, 3, 4) of the sensor's calibration at each node (estimators.sensor.lever): see estimators.solution."""
        return lever(self.velocities(calibration))

    def seen_from(self, poses: FloatArray, calibration: Sequence[float], sensor: Sequence[float]) -> FloatArray:
        """(n, 3) where a sensor of that calibration (4,) was when it saw what it says at the nodes of those poses."""
        return seen_from(poses, np.array(sensor), self.velocities(np.array(calibration)))


def levers(stamps_ns: Sequence[int], motions: Sequence[Increment]) -> FloatArray:
    """(n, 3, 4) as Chain.levers, by an odometry that is taken at its word."""
    return Chain(tuple(stamps_ns), tuple(motions), (), np.zeros((0, 3))).levers(np.zeros(CALIBRATION))


def velocities(moved: FloatArray, miscalibrated: FloatArray, durations_s: FloatArray) -> FloatArray:
    """(n, 3) just before each of n nodes, from the motions (n - 1, 3) between them, what a calibration changes of these
    (n - 1, 3), and how long they took (n - 1,)."""
    out = se2.log(se2.retract(moved, miscalibrated)) / durations_s[:, None]
    return np.concatenate([out[:1] if len(out) else np.zeros((1, 3)), out])


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """What a chain is made of before anything is decided: n nodes, motions between them, what was seen at them.

    factors: (node, factor) that are taken as they are. mixtures: (node, mixture) in order of observation.
    """

    stamps_ns: tuple[int, ...]
    motions: tuple[Increment, ...]
    factors: tuple[tuple[int, Factor], ...]
    mixtures: tuple[tuple[int, MixtureFactor], ...]

    def sights(self, choices: IntArray) -> list[int]:
        """Nodes, in order, at which something was recognised that says where the robot is."""
        chosen = zip(self.mixtures, choices.tolist(), strict=True)
        return [node for (node, mixture), choice in chosen if choice >= 0 and not mixture.by_compass]

    def between(self, choices: IntArray, node: int) -> tuple[int, int]:
        """The nodes of the last sight before a node and of the first from it on."""
        sights = self.sights(choices)
        at = bisect_left(sights, node)
        return sights[at - 1] if at > 0 else node - 1, sights[at] if at < len(sights) else node

    def anchored(self, choices: IntArray, breaks: Sequence[int]) -> bool:
        """Whether there is such a sight between any two breaks."""
        sights = self.sights(choices)
        edges = [bisect_left(sights, node) for node in (0, *breaks, len(self.stamps_ns))]
        return all(begin < end for begin, end in pairwise(edges))

    def chain(self, choices: IntArray, breaks: Iterable[int], guess: FloatArray, factors_of: Factors) -> Chain:
        """choices: (t,) the solution that each mixture is taken for, -1 for none. breaks: nodes to which the robot was
        carried. factors_of: a mixture's factors by its index and the solution."""
        factors = list(self.factors)
        for index, ((node, _), choice) in enumerate(zip(self.mixtures, choices.tolist(), strict=True)):
            if choice >= 0:
                factors += [(node, factor) for factor in factors_of(index, choice)]
        return Chain(self.stamps_ns, self.carried(breaks), tuple(factors), guess)

    def carried(self, breaks: Iterable[int]) -> tuple[Increment, ...]:
        """The motions of a robot that was carried to these nodes."""
        motions = list(self.motions)
        for node in breaks:
            motions[node - 1] = replace(motions[node - 1], covariance=ANYWHERE)
        return tuple(motions)


class ChainRecorder:
    """Collects a chain while motion and factors come in. Motion between nodes is added up."""

    def __init__(self, node_interval_s: float) -> None:
        self._interval_ns = int(node_interval_s * 1e9)
        self._stamps_ns: list[int] = []
        self._motions: list[Increment] = []
        self._factors: list[tuple[int, Factor]] = []
        self._mixtures: list[tuple[int, MixtureFactor]] = []
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
        self._factors.append((self._node_at(stamp_ns, pose), factor))

    def observe(self, mixture: MixtureFactor, stamp_ns: int) -> None:
        """A mixture at a stamp that `advance` has reached."""
        self._mixtures.append((self._node_at(stamp_ns, None), mixture))

    def relearn(self, relearned: Callable[[MixtureFactor], MixtureFactor]) -> None:
        """Change all mixtures."""
        self._mixtures = [(node, relearned(mixture)) for node, mixture in self._mixtures]

    def move(self, motions: Sequence[Increment]) -> None:
        """Between all nodes so far, in place of what was added up."""
        self._motions = list(motions)

    @property
    def stamps_ns(self) -> Sequence[int]:
        return self._stamps_ns

    def recorded(self) -> Recorded:
        return Recorded(tuple(self._stamps_ns), tuple(self._motions), tuple(self._factors), tuple(self._mixtures))

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
                motions[since - 1] = replace(motions[since - 1], covariance=ANYWHERE)
        for start, end in backwards:
            for k in reversed(range(start, end)):
                guess[k] = se2.compose(guess[k + 1], se2.inverse(self._motions[k].before_from_after))
        return Chain(tuple(self._stamps_ns), tuple(motions), tuple(self._factors), np.array(guess))

    def _node_at(self, stamp_ns: int, pose: FloatArray | None) -> int:
        if not self._stamps_ns or stamp_ns > self._stamps_ns[-1]:
            self._node(stamp_ns, pose)
        self._guess[-1] = pose
        return len(self._stamps_ns) - 1

    def _node(self, stamp_ns: int, pose: FloatArray | None) -> None:
        if self._stamps_ns:
            self._motions.append(self._pending)
        self._pending = STANDSTILL
        self._stamps_ns.append(stamp_ns)
        self._guess.append(pose)
