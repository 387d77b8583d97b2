"""Places to follow a robot from: where each of the forward filter's readings of a log begins."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.chain import Recorded
from estimators.modes import ModeSequence
from estimators.tracks import NO_HINT, Seed
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray


def seeds(recorded: Recorded, sequences: Sequence[ModeSequence], told: int | None, most: int) -> tuple[Seed, ...]:
    """One for each beginning of a hypothesis that is read on in a different way, the likeliest reading's first.

    told: index of the mixture that was told as the start, which hypotheses without a birth begin at.
    """
    out: list[Seed] = []
    known: list[tuple[int, bytes]] = []
    for sequence in sequences:
        births = [birth for birth in sequence.births if sequence.choices[birth] >= 0]
        begins = sorted({*births, *([told] if told is not None else [])})
        for begin, end in zip(begins, [*begins[1:], len(sequence.choices)], strict=True):
            hints = _hints(sequence.choices, begin, end)
            if (begin, hints.tobytes()) in known:
                continue
            known.append((begin, hints.tobytes()))
            if (seed := _seed(recorded, begin, int(sequence.choices[begin]), hints)) is not None:
                out.append(seed)
    return tuple(out[:most])


def whole_poses(recorded: Recorded, most: int) -> tuple[Seed, ...]:
    """The solutions of the first mixture that has any, for a log that no reading leads through."""
    nothing = np.full(len(recorded.mixtures), NO_HINT)
    for index, (_, mixture) in enumerate(recorded.mixtures):
        found = mixture.solutions()
        if len(found.ids):
            all_of_it = [_seed(recorded, index, int(choice), nothing) for choice in found.ids[:most]]
            return tuple(seed for seed in all_of_it if seed is not None)
    return ()


def on_copies(seeds: Sequence[Seed], recorded: Recorded, copies: FloatArray) -> tuple[Seed, ...]:
    """Each seed on each copy (c, 3) in turn. On a copy, a mixture that tells sides apart has not seen its solution."""
    out = []
    for seed in seeds:
        mixture = recorded.mixtures[seed.at][1]
        for copy in copies:
            if mixture.symmetric or not copy.any():
                out.append(replace(seed, copy=copy))
            else:
                out.append(replace(seed, copy=copy, choice=-1, log_weight=mixture.log_outlier))
    return tuple(out)


def _hints(choices: IntArray, begin: int, end: int) -> IntArray:
    out = np.full(len(choices), NO_HINT)
    out[begin:end] = choices[begin:end]
    return out


def _seed(recorded: Recorded, index: int, choice: int, hints: IntArray) -> Seed | None:
    node, mixture = recorded.mixtures[index]
    found = mixture.solutions()
    rows = np.flatnonzero(found.ids == choice)
    if not len(rows):
        return None
    row = rows[0]
    pose, covariance = found.poses[row], found.covariances[row]
    return Seed(index, node, choice, pose, covariance, np.zeros(3), float(found.log_weights[row]), hints)
