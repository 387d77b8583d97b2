"""Places to follow a robot from: where each of the forward filter's readings of a log begins."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.chain import Recorded
from estimators.modes import ModeSequence
from estimators.tracks import NO_HINT, Seed
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_PARTS = 40  # of a log, at most
_PER_PART = 50  # mixtures
_TRIED = 2
_SAME = np.array([0.5, 0.5, 0.3])  # m, m, rad


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


def surest(recorded: Recorded, log_area: float) -> tuple[tuple[float, Seed], ...]:
    """What tells the place by itself: the surest of the most detailed mixtures in each part of the log, with how sure.

    They know nothing of what a filter has thought. log_area: log of the volume of all places (m^2 rad). How sure is the
    probability of the likeliest solution, with those that are the same place, for a robot that may be anywhere.
    """
    details = np.array([mixture.log_outlier if not mixture.by_compass else 0.0 for _, mixture in recorded.mixtures])
    nothing = np.full(len(details), NO_HINT)
    out: list[tuple[float, Seed]] = []
    for part in np.array_split(np.arange(len(details)), min(_PARTS, -(-len(details) // _PER_PART))):
        best: tuple[float, Seed] | None = None
        # things of which there are many in sight are unlikely to be all by chance
        for index in part[np.argsort(details[part], kind="stable")][:_TRIED]:
            mixture = recorded.mixtures[index][1]
            found = mixture.solutions()
            if mixture.by_compass or not len(found.ids):
                continue
            same = (np.abs(se2.local(found.poses[0], found.poses)) < _SAME).all(axis=1)
            everything = np.logaddexp(mixture.log_integral, mixture.log_outlier + log_area)
            sure = float(np.exp(found.log_weights[same] - everything).sum())
            if best is None or sure > best[0]:
                seed = _seed(recorded, int(index), int(found.ids[0]), nothing)
                best = best if seed is None else (sure, seed)
        if best is not None:
            out.append(best)
    return tuple(sorted(out, key=lambda one: -one[0]))


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
