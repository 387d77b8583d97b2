"""Where hypotheses come from: the numbers that they keep, and all choices since the start."""

from dataclasses import dataclass
from typing import NamedTuple, Optional

import numpy as np
from numpy.typing import NDArray

from estimators.mixture.bank import Bank
from estimators.mixture.sides import Sides
from estimators.modes import ModeSequence, Way
from estimators.motion import CALIBRATION
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray


class Leaf(NamedTuple):
    """A hypothesis' last choice, at an observation (from 0). What no living leaf leads to goes with the garbage.

    pose, covariance, extra: after it, as `Bank` has them. margin: as `Way` has it.
    """

    before: Optional["Leaf"]
    observation: int
    choice: int
    began: bool
    pose: FloatArray
    covariance: FloatArray
    extra: FloatArray
    margin: float


@dataclass(slots=True)
class Lineage:
    """tracks: (h, c) a number for each hypothesis on each copy that is alive, -1 elsewhere. leaves: of each hypothesis,
    if remembered."""

    remember: bool
    tracks: IntArray
    leaves: list[Leaf | None]
    observed: int = 0
    _next: int = 0

    @staticmethod
    def none(copies: int, remember: bool) -> "Lineage":
        return Lineage(remember, np.zeros((0, copies), dtype=np.intp), [])

    def begin(self, bank: Bank) -> None:
        """Of hypotheses that come from nowhere; forgets all choices."""
        self.observed = 0
        self.tracks = np.full(bank.log_weights.shape, -1)
        self.leaves = [None] * len(bank)
        self._number(np.isfinite(bank.log_weights))

    def follow(self, bank: Bank, best: int, choice: bool, margin: float = 0.0) -> None:
        """Of the bank after an observation. best: row of the best one before it. choice: whether there was one; margin:
        of that, as `Way` has it."""
        if len(bank) == 1 and bank.parents[0] == 0 and self.tracks.size == 1:
            self._remember(bank, best, choice, margin)  # the only one goes on
            return
        parents = bank.parents
        alive = np.isfinite(bank.log_weights)
        kept = len(parents) == len(self.tracks) and bool((parents == np.arange(len(parents))).all())
        if kept and bool(((self.tracks >= 0) == alive).all()):
            pass  # as ever, where nothing splits
        else:
            old = np.concatenate([self.tracks, np.full((1, self.tracks.shape[1]), -1)])[parents]
            old[~alive] = -1
            for column, weights in zip(old.T, bank.log_weights.T, strict=True):
                # of several children the likeliest keeps the number
                order = np.argsort(-weights, kind="stable")
                _, first = np.unique(column[order], return_index=True)
                again = np.ones(len(column), dtype=np.bool_)
                again[order[first]] = False
                column[again] = -1
            self.tracks = old
            self._number(alive & (old < 0))
        self._remember(bank, best, choice, margin)

    def _remember(self, bank: Bank, best: int, choice: bool, margin: float) -> None:
        if not choice:
            self.leaves = [self.leaves[parent] for parent in bank.parents.tolist()] if self.remember else []
            return
        if self.remember:
            self._choose(bank, best, margin)
        self.observed += 1

    def _number(self, where: NDArray[np.bool_]) -> None:
        count = int(np.count_nonzero(where))
        self.tracks[where] = np.arange(self._next, self._next + count)
        self._next += count

    def _choose(self, bank: Bank, best: int, margin: float) -> None:
        before, index = self.leaves, self.observed
        lost_from = before[best] if before else None
        # one that is found elsewhere was the best one before, until it was carried
        self.leaves = [
            Leaf(
                before[parent] if parent >= 0 else lost_from if found else None,
                index,
                choice,
                parent < 0,
                pose,
                covariance.copy(),  # of all else it is a part of
                extra,
                margin,
            )
            for parent, choice, found, pose, covariance, extra in zip(
                bank.parents.tolist(),
                bank.choices.tolist(),
                bank.found.tolist(),
                bank.poses,
                bank.covariances[:, :3, :3],
                bank.extra,
                strict=True,
            )
        ]

    def sequences(self, bank: Bank, sides: Sides, count: int) -> tuple[ModeSequence, ...]:
        """The likeliest first, one for each hypothesis on each copy that is alive."""
        weights = bank.log_weights.ravel()
        order = np.argsort(-weights, kind="stable")[:count]
        order = order[np.isfinite(weights[order])]
        log_weights = weights[order] - np.logaddexp.reduce(weights, initial=-np.inf)
        return tuple(
            self._sequence(self.leaves[place // len(sides)], place % len(sides), log_weight)
            for place, log_weight in zip(order.tolist(), log_weights.tolist(), strict=True)
        )

    def _sequence(self, leaf: Leaf | None, copy: int, log_weight: float) -> ModeSequence:
        count = self.observed
        choices = np.full(count, -1, dtype=np.intp)
        way = Way(np.zeros((count, 3)), np.zeros((count, 3, 3)), np.zeros((count, CALIBRATION)), np.zeros(count))
        births = []
        while leaf is not None:
            at = leaf.observation
            choices[at] = leaf.choice
            way.poses[at], way.covariances[at], way.margins[at] = leaf.pose, leaf.covariance, leaf.margin
            way.calibrations[at] = leaf.extra[:CALIBRATION]
            if leaf.began:
                births.append(leaf.observation)
            leaf = leaf.before
        return ModeSequence(log_weight, choices, tuple(reversed(births)), copy, way)
