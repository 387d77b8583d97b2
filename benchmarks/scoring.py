"""How right an estimator was that says what it cannot tell apart: moments of a game, and what becomes of many."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.games import PlayedGame, truth_at
from estimators.base import Ambiguity, Ambiguous, Estimator, Hypothesis
from estimators.config import Config
from fieldloc import pose as se2
from fieldloc.pose import FloatArray
from logs.replay import Run

RIGHT_M, RIGHT_RAD = 0.3, np.radians(15.0)
_EVERY_NS = 100_000_000
_BINS = 10
_CHI2_3 = 21.11  # a true pose's squared Mahalanobis distance is beyond it once in ten thousand


@dataclass(frozen=True, slots=True)
class Moment:
    """What the estimator said, and how right it was.

    since_s: since the evidence before it. found: its first hypothesis or one of that one's copies is where the robot
    is, by RIGHT_*; right: itself is. away_m, away_rad: of the nearest copy. other_side: one of the copies is nearer.
    nees: of the estimate, nees_folded: of its best copy.
    told: probabilities of the places that the hypotheses are at, true: whether the robot was at each.
    """

    stamp_ns: int
    since_s: float
    found: bool
    right: bool
    away_m: float
    away_rad: float
    other_side: bool
    mirrored: float
    lost: float
    nees: float
    nees_folded: float
    told: FloatArray
    true: NDArray[np.bool_]


def watch(game: PlayedGame, make: Callable[[Config], Estimator], config: Config) -> tuple[list[Moment], float]:
    """Ten moments a second at most, and the processor seconds' worth of updates that the game took (mixtures too)."""
    estimator = make(config)
    if not isinstance(estimator, Ambiguous):
        raise ValueError(f"{type(estimator).__name__} does not say how sure it is")
    moments: list[Moment] = []
    update_s, last_ns = 0.0, -_EVERY_NS
    for step in Run(game.recording, estimator, game.start, config).steps():
        update_s += step.update_s or 0.0
        stamp_ns = step.measurement.stamp_ns
        if step.update_s is None or stamp_ns - last_ns < _EVERY_NS:
            continue
        said, truth = estimator.ambiguity(), truth_at(game, stamp_ns)
        if said is not None and said.hypotheses and truth is not None:
            last_ns = stamp_ns
            moments.append(_moment(game, stamp_ns, said, truth))
    return moments, update_s


def expected_calibration_error(told: FloatArray, true: NDArray[np.bool_]) -> float:
    """Ten bins of equal width; the mean distance of what was told from how often it was true, by how many there are."""
    if not len(told):
        return np.nan
    bins = _bins(told)
    gaps = [abs(float(np.sum(told[bins == b]) - np.sum(true[bins == b]))) for b in range(_BINS)]
    return sum(gaps) / len(told)


def reliability(told: FloatArray, true: NDArray[np.bool_]) -> Iterator[tuple[str, ...]]:
    """A row a bin: from, to, how many, told on average, true how often."""
    bins = _bins(told)
    for b in range(_BINS):
        if (here := bins == b).any():
            yield (
                f"{b / _BINS:.1f} to {(b + 1) / _BINS:.1f}",
                str(here.sum()),
                f"{told[here].mean():.3f}",
                f"{true[here].mean():.3f}",
            )


def _bins(told: FloatArray) -> NDArray[np.intp]:
    """One half is one half, whichever way it was rounded."""
    return np.minimum((np.round(told, 6) * _BINS).astype(np.intp), _BINS - 1)


def both_sides(moments: Iterable[Moment]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """What was told of either side, and on which the robot was; only where it was on one of the two at all."""
    found = [moment for moment in moments if moment.found]
    told = np.array([moment.mirrored for moment in found])
    true = np.array([moment.other_side for moment in found], dtype=np.bool_)
    return np.concatenate([told, 1.0 - told]), np.concatenate([true, ~true])


def first_right_s(moments: list[Moment], since_ns: int, for_s: float = 1.0) -> float:
    """Seconds until it is right and stays so for a while; infinity if never."""
    begun_ns = None
    for moment in moments:
        if moment.stamp_ns < since_ns:
            continue
        if not moment.right:
            begun_ns = None
        elif begun_ns is None:
            begun_ns = moment.stamp_ns
        if begun_ns is not None and moment.stamp_ns - begun_ns >= for_s * 1e9:
            return (begun_ns - since_ns) * 1e-9
    return np.inf


def _moment(game: PlayedGame, stamp_ns: int, said: Ambiguity, truth: FloatArray) -> Moment:
    best = said.hypotheses[0]
    # as if the robot stood at a copy of its true place, itself the first
    symmetries = np.concatenate([np.zeros((1, 3)), game.recording.field.symmetries])
    copies = se2.compose(symmetries, truth)
    away = best.pose - copies
    away[:, 2] = se2.wrap(away[:, 2])
    far_m, far_rad = np.hypot(away[:, 0], away[:, 1]), np.abs(away[:, 2])
    near = (far_m < RIGHT_M) & (far_rad < RIGHT_RAD)
    nearest = int(np.argmin(far_m / RIGHT_M + far_rad / RIGHT_RAD))
    nees = np.sum(away * np.linalg.solve(best.covariance, away.T).T, axis=1)
    before = [evidence_ns for evidence_ns in game.evidence_ns if evidence_ns <= stamp_ns]
    return Moment(
        stamp_ns,
        (stamp_ns - before[-1]) * 1e-9 if before else -1.0,
        bool(near.any()),
        bool(near[0]),
        float(far_m[nearest]),
        float(far_rad[nearest]),
        nearest != 0,
        said.mirrored,
        said.lost,
        float(nees[0]),
        float(nees.min()),
        *_places(said.hypotheses, truth),
    )


def _places(hypotheses: tuple[Hypothesis, ...], truth: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """What is told of each place and whether it is true, the likeliest first: hypotheses that are one place to RIGHT_*
    are told together, and true if one of them is."""
    poses = np.array([one.pose for one in hypotheses])
    weights, holds = np.array([one.weight for one in hypotheses]), np.array([_holds(one, truth) for one in hypotheses])
    left, told, true = np.ones(len(poses), dtype=np.bool_), [], []
    for row, pose in enumerate(poses):
        if left[row]:
            away = poses - pose
            here = left & (np.hypot(away[:, 0], away[:, 1]) < RIGHT_M) & (np.abs(se2.wrap(away[:, 2])) < RIGHT_RAD)
            left &= ~here
            told.append(weights[here].sum())
            true.append(holds[here].any())
    return np.array(told), np.array(true, dtype=np.bool_)


def _holds(hypothesis: Hypothesis, truth: FloatArray) -> bool:
    """Whether the robot is where it says: by its own covariance, which no hypothesis is punished for being sure of
    where it is right to RIGHT_*."""
    away = truth - hypothesis.pose
    away[2] = se2.wrap(away[2])
    if np.hypot(away[0], away[1]) < RIGHT_M and abs(away[2]) < RIGHT_RAD:
        return True
    return bool(away @ np.linalg.solve(hypothesis.covariance, away) < _CHI2_3)
