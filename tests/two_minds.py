"""Ambiguities and events as a filter would tell them, and an estimator that does."""

from collections.abc import Mapping

import numpy as np

from estimators.base import Ambiguity, Event, Hypothesis
from estimators.config import Config
from estimators.ekf import Ekf
from fieldloc import pose as se2
from fieldloc.pose import FloatArray

HALF_TURN = np.array([0.0, 0.0, np.pi])
COVARIANCE = np.diag([0.04, 0.01, 0.0025])


def ambiguity(
    stamp_ns: int,
    weights: Mapping[int, float],
    mirrored: float = 0.0,
    lost: float = 0.0,
    places: Mapping[int, FloatArray] | None = None,
) -> Ambiguity:
    """weights by track, in any order. places: poses by track; a track's own place on a line if not told."""
    places = places or {}
    best_first = sorted(weights, key=lambda track: -weights[track])
    return Ambiguity(
        stamp_ns,
        tuple(
            Hypothesis(weights[track], places.get(track, np.array([float(track), 0.5, 0.1])), COVARIANCE, track)
            for track in best_first
        ),
        mirrored,
        lost,
    )


class InTwoMinds(Ekf):
    """Takes the half turn of where it is for possible: as likely as where it is for 5 observations, then decided."""

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.events: list[Event] = []
        self.asked = 0

    def ambiguity(self) -> Ambiguity | None:
        now = self.estimate()
        if now is None:
            return None
        if self.asked in (0, 5):
            kind, text = ("start", "found") if self.asked == 0 else ("decision", "it is not the half turn")
            self.events.append(Event(now.stamp_ns, kind, text))  # type: ignore[arg-type]
        mirrored = 0.5 if self.asked < 5 else 0.01
        self.asked += 1
        places = {1: now.pose, 2: se2.compose(HALF_TURN, now.pose)}
        return ambiguity(now.stamp_ns, {1: 1.0 - mirrored, 2: mirrored}, mirrored, 0.0, places)
