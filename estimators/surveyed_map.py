"""A map with its landmarks where the logs of a robot say that they are, and how much of it they say."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimators.calibrated import TOLD_NOTHING
from estimators.fused import fused
from estimators.surveyed import Survey, survey_covariance
from fieldloc.covariance import propagate
from fieldloc.field import FieldMap, Landmark
from fieldloc.pose import FloatArray

_ROUNDS = 8
_SETTLED_M = 2e-4


@dataclass(frozen=True, slots=True)
class FoundLandmark:
    """dx_m, dy_m: from where the map has it. sigma_m, prior_sigma_m: of either, the root of their mean variance, now
    and before. log_gain: by how much moving it improves the logs' log-likelihood, the others free. told: whether the
    logs say anything of it; else it is where it was, known as it was."""

    label: str
    dx_m: float
    dy_m: float
    sigma_m: float
    prior_sigma_m: float
    log_gain: float
    told: bool


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedMap:
    """field: with all landmarks as known now, covariances included. landmarks: in the map's order.

    covariance: (2m, 2m) of all landmarks together, x and y of each in turn. common, prior_common: (3,) standard
    deviations of what moves all that were told in the same way, x and y in metres and a turn about their middle, now
    and before: much the same, as no log tells a map that is moved as a whole from poses that are.
    disagreement: as of estimators.fused.
    """

    field: FieldMap
    landmarks: tuple[FoundLandmark, ...]
    covariance: FloatArray
    common: FloatArray
    prior_common: FloatArray
    disagreement: float

    @property
    def told(self) -> bool:
        return any(one.told for one in self.landmarks)


def with_survey_sigma(field: FieldMap, sigma_m: float) -> FieldMap:
    """The map with that standard deviation, in x as in y, for landmarks of which it knows none."""
    wide = sigma_m**2 * np.eye(2)
    marks = tuple(mark if mark.covariance.any() else replace(mark, covariance=wide) for mark in field.landmarks)
    return replace(field, landmarks=marks)


def held(done: SurveyedMap) -> FieldMap:
    """The map with the landmarks that were told as if they were exact: the logs that tell them are to be read by what
    fits them, and how noisy these are shows best so."""
    exact = np.zeros((2, 2))
    pairs = zip(done.field.landmarks, done.landmarks, strict=True)
    return replace(
        done.field, landmarks=tuple(replace(mark, covariance=exact) if one.told else mark for mark, one in pairs)
    )


def surveyed_map(field: FieldMap, surveys: Sequence[Survey]) -> SurveyedMap:
    """What several logs say together; field: the map as all of them had it beforehand. ValueError for no survey.

    Each has poses and a robot of its own, and all the same landmarks: what it says of them is asked where all together
    have them. If they contradict each other, all that they say is that much less sure.
    """
    if not surveys:
        raise ValueError("no log to survey the map from")
    prior, found = survey_covariance(field), surveys[0].positions
    for _ in range(_ROUNDS):
        for one in surveys:
            one.settle(found)
        together = fused(field.positions.ravel(), prior, [one.says(field.positions) for one in surveys])
        before, found = found, together.mean.reshape(-1, 2)
        if np.abs(found - before).max() < _SETTLED_M:
            break
    covariance = together.covariance
    now, before = _own(covariance), _own(prior)
    seen = np.any([one.seen() for one in surveys], axis=0)
    rows = tuple(map(_found, field.landmarks, found, now, before, seen.tolist()))
    marks = tuple(
        replace(mark, position=at, covariance=own) if row.told else mark
        for mark, at, own, row in zip(field.landmarks, found, now, rows, strict=True)
    )
    told = np.array([row.told for row in rows])
    common, prior_common = _common(found, covariance, told), _common(found, prior, told)
    return SurveyedMap(replace(field, landmarks=marks), rows, covariance, common, prior_common, together.disagreement)


def _own(covariance: FloatArray) -> FloatArray:
    """(m, 2, 2) of each landmark by itself."""
    count = len(covariance) // 2
    at = np.arange(count)
    return covariance.reshape(count, 2, count, 2)[at, :, at]


def _found(mark: Landmark, at: FloatArray, now: FloatArray, before: FloatArray, seen: bool) -> FoundLandmark:
    sigma_m, prior_m = (float(np.sqrt(0.5 * np.trace(covariance))) for covariance in (now, before))
    if not seen or sigma_m >= TOLD_NOTHING * prior_m:
        return FoundLandmark(mark.label, 0.0, 0.0, prior_m, prior_m, 0.0, told=False)
    off = at - mark.position
    gain = 0.5 * float(off @ (np.linalg.inv(now) + np.linalg.inv(before)) @ off)
    return FoundLandmark(mark.label, float(off[0]), float(off[1]), sigma_m, prior_m, gain, told=True)


def _common(positions: FloatArray, covariance: FloatArray, told: NDArray[np.bool_]) -> FloatArray:
    """(3,) standard deviations of the shift and turn that fit the errors of those told; zeros for fewer than two."""
    if np.count_nonzero(told) < 2:
        return np.zeros(3)
    x, y = (positions[told] - positions[told].mean(axis=0)).T
    moves = np.concatenate([np.tile(np.eye(2), (len(x), 1)), np.column_stack([-y, x]).reshape(-1, 1)], axis=1)
    which = np.repeat(told, 2)
    return np.asarray(np.sqrt(np.diagonal(propagate(np.linalg.pinv(moves), covariance[np.ix_(which, which)]))))
