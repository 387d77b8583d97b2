"""The hypotheses of a run over time as arrays: whose probability is how large when. What is drawn of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.base import Ambiguity
from fieldloc.pose import FloatArray
from logs.thinning import extremes
from logs.trajectory import IntArray

COLOURS = 8
"""Tracks are told apart by so many."""

_LEAST_PEAK = 0.05  # of a track that is drawn by itself
_MOST_TRACKS = 150


@dataclass(frozen=True, slots=True, eq=False)
class Shares:
    """All hold from their stamp to the next and add up to one: weights (n, k) of the tracks (k,) that were ever likely,
    in the order of their beginnings; rest (n,) of all others; lost (n,).

    stamps_ns: (n,) rising. mirrored: (n,). colours: (k,) numbers below COLOURS, as different as can be where tracks
    live at the same time.
    """

    stamps_ns: IntArray
    tracks: IntArray
    weights: FloatArray
    rest: FloatArray
    lost: FloatArray
    mirrored: FloatArray
    colours: NDArray[np.intp]

    def lives(self) -> list[tuple[int, int]]:
        """First and last index of each track."""
        alive = [np.flatnonzero(column > 0.0) for column in self.weights.T]
        return [(int(rows[0]), int(rows[-1])) for rows in alive]


def shares(ambiguities: Sequence[Ambiguity], most_times: int = 1500) -> Shares:
    """Of too many ambiguities those where P(mirrored) or the best weight is extreme among their neighbours."""
    chosen = [ambiguities[i] for i in _times(ambiguities, most_times)]
    rows = np.array([i for i, one in enumerate(chosen) for _ in one.hypotheses], dtype=np.intp)
    every = np.array([h.track for one in chosen for h in one.hypotheses], dtype=np.int64)
    weight = np.clip(np.array([h.weight for one in chosen for h in one.hypotheses], dtype=np.float64), 0.0, 1.0)
    drawn = _drawn(rows, every, weight)
    column = {track: i for i, track in enumerate(drawn.tolist())}
    columns = np.array([column.get(track, -1) for track in every.tolist()], dtype=np.intp)
    weights = np.zeros((len(chosen), len(drawn)))
    known = columns >= 0
    np.add.at(weights, (rows[known], columns[known]), weight[known])
    lost = np.clip(np.array([one.lost for one in chosen]), 0.0, 1.0)
    out = Shares(
        np.array([one.stamp_ns for one in chosen], dtype=np.int64),
        drawn,
        weights,
        np.clip(1.0 - lost - weights.sum(axis=1), 0.0, 1.0),
        lost,
        np.clip(np.array([one.mirrored for one in chosen]), 0.0, 1.0),
        np.zeros(len(drawn), dtype=np.intp),
    )
    out.colours[:] = _colours(out.lives())
    return out


def _times(ambiguities: Sequence[Ambiguity], most: int) -> list[int]:
    if len(ambiguities) <= most:
        return list(range(len(ambiguities)))
    mirrored = np.array([one.mirrored for one in ambiguities])
    best = np.array([one.hypotheses[0].weight if one.hypotheses else 0.0 for one in ambiguities])
    bins = max(1, most // 4)
    ends = np.array([0, len(ambiguities) - 1])
    chosen: list[int] = np.unique(np.concatenate([extremes(mirrored, bins), extremes(best, bins), ends])).tolist()
    return chosen


def _drawn(rows: NDArray[np.intp], tracks: IntArray, weight: FloatArray) -> IntArray:
    """Tracks that were ever likely, in the order of their beginnings; of too many those that were it longest."""
    known, first, number = np.unique(tracks, return_index=True, return_inverse=True)
    number = number.reshape(-1)
    peak, total = np.zeros(len(known)), np.bincount(number, weight, len(known))
    np.maximum.at(peak, number, weight)
    likely = np.flatnonzero(peak >= _LEAST_PEAK)
    likely = likely[np.argsort(-total[likely], kind="stable")[:_MOST_TRACKS]]
    born = np.lexsort((known[likely], rows[first[likely]]))
    return np.asarray(known[likely[born]])


def _colours(lives: Sequence[tuple[int, int]]) -> list[int]:
    """Of each track, the one that nobody has had for the longest time."""
    free_from = [-COLOURS + i for i in range(COLOURS)]
    out = []
    for _, end in lives:
        colour = int(np.argmin(free_from))
        free_from[colour] = max(end, free_from[colour] + 1)
        out.append(colour)
    return out
