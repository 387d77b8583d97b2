"""What a whole log says of where the robot was, and how sure that is."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.base import Ambiguity, Event, Hypothesis
from estimators.chain import Chain
from estimators.joint import Settled
from estimators.solution import Solution
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_SAME = np.array([0.3, 0.3, 0.3])  # m, m, rad: last poses that are so near are one hypothesis
_SHOWN = 1e-6
_APART_NS = 500_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Resolution:
    """The likeliest reading of a log, on its likeliest copies of the field.

    chain: what the solution is of. choices: (t,) solution per observed mixture, -1 for none. breaks_ns: when the robot
    was carried. candidates: the readings that were solved, this one first; log_evidence, probabilities: (c,) of them.
    copies: (s, k) probability of each copy under the map's symmetries, the reported one first, in each of the stretches
    between breaks; moves: (s, k, 3) the symmetries that take the reported one there.
    """

    solution: Solution
    chain: Chain
    choices: IntArray
    breaks_ns: tuple[int, ...]
    candidates: tuple[Settled, ...]
    log_evidence: FloatArray
    probabilities: FloatArray
    copies: FloatArray
    moves: FloatArray

    @property
    def mirrored(self) -> float:
        """Probability that the robot stands at a copy of the reported pose in the end."""
        return float(1.0 - self.copies[-1, 0])

    @property
    def events(self) -> tuple[Event, ...]:
        return tuple(
            Event(stamp_ns, "carried", "the robot was put down elsewhere, by all that was seen")
            for stamp_ns in self.breaks_ns
        )

    def ambiguities(self, stamps_ns: Sequence[int]) -> tuple[Ambiguity, ...]:
        """Of the whole way, by the stamps of its nodes: one at least each half second, and of all about breaks."""
        edges = np.searchsorted(stamps_ns, self.breaks_ns)
        wanted = {0, len(stamps_ns) - 1, *edges.tolist(), *np.maximum(edges - 1, 0).tolist()}
        out: list[Ambiguity] = []
        for node, stamp_ns in enumerate(stamps_ns):
            if node in wanted or stamp_ns >= out[-1].stamp_ns + _APART_NS:
                out.append(self.ambiguity(stamp_ns, node))
        return tuple(out)

    def ambiguity(self, stamp_ns: int, node: int = -1) -> Ambiguity:
        """Of the pose at a node and its stamp, the last one if none is named."""
        stretch = bisect_right(self.breaks_ns, stamp_ns)
        poses = [self.solution.poses[node]]
        covariances = [self.solution.covariances[node]]
        weights = [float(self.probabilities[0])]
        for one, probability in zip(self.candidates[1:], self.probabilities[1:].tolist(), strict=True):
            pose = one.solution.poses[node]
            apart = [bool((np.abs(se2.local(pose, other)) > _SAME).any()) for other in poses]
            if all(apart):
                poses.append(pose)
                covariances.append(one.solution.covariances[node])
                weights.append(probability)
            else:
                weights[apart.index(False)] += probability
        shares = np.outer(weights, self.copies[stretch])
        at = se2.compose(self.moves[stretch], np.array(poses)[:, None])
        order = np.argsort(-shares, axis=None, kind="stable")
        order = order[order > 0] if len(order) > 1 else order[:0]
        rows, copies = np.unravel_index(np.concatenate([[0], order]), shares.shape)
        hypotheses = tuple(
            Hypothesis(
                float(shares[row, copy]),
                at[row, copy],
                se2.rotate_covariance(covariances[row], at[row, copy, 2]),
                int(row) * shares.shape[1] + int(copy),
            )
            for row, copy in zip(rows, copies, strict=True)
            if shares[row, copy] >= _SHOWN
        )
        return Ambiguity(stamp_ns, hypotheses, float(1.0 - self.copies[stretch, 0]), 0.0)
