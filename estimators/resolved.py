"""What a whole log says of where the robot was, and how sure that is."""

from dataclasses import dataclass

import numpy as np

from estimators.base import Ambiguity, Hypothesis
from estimators.joint import Settled
from estimators.solution import Solution
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_SAME = np.array([0.3, 0.3, 0.3])  # m, m, rad: last poses that are so near are one hypothesis
_SHOWN = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Resolution:
    """The likeliest reading of a log, on its likeliest copies of the field.

    choices: (t,) solution per observed mixture, -1 for none. breaks_ns: when the robot was carried. candidates: the
    readings that were solved, this one first; log_evidence, probabilities: (c,) of them. copies: (s, k) probability of
    each copy under the map's symmetries, the reported one first, in each of the stretches between breaks; moves:
    (s, k, 3) the symmetries that take the reported one there.
    """

    solution: Solution
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

    def ambiguity(self, stamp_ns: int) -> Ambiguity:
        """Of the last pose."""
        poses = [self.solution.poses[-1]]
        covariances = [self.solution.covariances[-1]]
        weights = [float(self.probabilities[0])]
        for one, probability in zip(self.candidates[1:], self.probabilities[1:].tolist(), strict=True):
            pose = one.solution.poses[-1]
            apart = [bool((np.abs(se2.local(pose, other)) > _SAME).any()) for other in poses]
            if all(apart):
                poses.append(pose)
                covariances.append(one.solution.covariances[-1])
                weights.append(probability)
            else:
                weights[apart.index(False)] += probability
        shares = np.outer(weights, self.copies[-1])
        at = se2.compose(self.moves[-1], np.array(poses)[:, None])
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
        return Ambiguity(stamp_ns, hypotheses, self.mirrored, 0.0)
