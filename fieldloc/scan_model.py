"""A scan held against a map, in the sensor's frame: what each landmark seen says of a pose if it is this or that.

Arrays over poses (h), observations (n) and landmarks of the map (m). A tangent is that of the sensor's pose. Errors are
each landmark's own, and two that all of a scan share, which are unknowns beside the pose: all ranges too long by so
many standard deviations, all bearings turned by so many.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.scan_moments import Upper, determinant, moments

BoolArray = NDArray[np.bool_]

GATE = 18.42  # chi-square, 2 degrees of freedom: a right one fails once in ten thousand
NAMED_GATE = 36.0  # one whose label says which it is; what is worth less than clutter then counts as that
_LOG_TWO_PI = float(np.log(2 * np.pi))
NEAREST_M = 1e-6  # on the landmark any direction will do


class Terms(NamedTuple):
    """Observations, as range and bearing, against one landmark each (c, n); zero where it is none.

    log_peak (c, n): density without an error, relative to clutter, by the covariance that is not widened. error
    (c, n, 2); weight (c, n, 2, 2): inverse of its covariance, widened. jacobian (c, n, 2, 3), or (c, n, 2, 5) with the
    two shared errors, of unit variance. of_shared: (c, n, 3) what it says of these two by the covariance that is not
    widened, upper triangle; None where nothing is shared.
    """

    log_peak: FloatArray
    error: FloatArray
    weight: FloatArray
    jacobian: FloatArray
    of_shared: FloatArray | None


class Errors(NamedTuple):
    """Of observations as landmarks (k,) at poses (h, 3): range_m and bearing_rad (n, h, k); (ux, uy) the line of sight
    in the field, d the distance, (h, k)."""

    landmarks: IntArray
    ux: FloatArray
    uy: FloatArray
    d: FloatArray
    range_m: FloatArray
    bearing_rad: FloatArray


class Row(NamedTuple):
    """An observation by plain numbers: its own covariance of range and bearing; one standard deviation each of what is
    shared, as it is and widened; the rest as `ScanModel` has it."""

    range_m: float
    bearing_rad: float
    rr: float
    rb: float
    bb: float
    longer: float
    turned: float
    longer_widened: float
    turned_widened: float
    log_peak: float
    gate: float


@dataclass(frozen=True, eq=False)
class ScanModel:
    """range_bearing (n, 2) as LandmarkScan, covariance (n, 2, 2) of each one's own error; may (n, m): which can be
    which, by their labels.

    positions (m, 2), survey (m, 2, 2) of the map, None where it is exact. log_match (n,): logarithm of the prior that
    an observation is of one given landmark of those it may be; log_clutter (n,) of prior and density if it is of none.
    wider (m, 2): by how much variances of range and bearing are widened for each landmark. shared: (n, 2) standard
    deviations in range and bearing of what all share, the same for all bearings; None for nothing. wider_shared: (2,)
    by how much these variances are widened.
    """

    range_bearing: FloatArray
    covariance: FloatArray
    may: BoolArray
    positions: FloatArray
    survey: FloatArray | None
    log_match: FloatArray
    log_clutter: FloatArray
    wider: FloatArray
    shared: FloatArray | None = None
    wider_shared: FloatArray = field(default_factory=lambda: np.ones(2))

    def widening(self, row: IntArray, landmark: IntArray) -> FloatArray | None:
        """(n, 2) by how much to widen what was seen: as the longest known of the landmarks that it may be from there;
        None where all is news.

        The same for all poses, or those would win by and by that see with an error what the robot is not known to see.
        """
        if not self._repeats:
            return None
        out = np.ones((len(self.range_bearing), 2))
        np.maximum.at(out, row, self.wider[landmark])
        return out

    def widening_of(self, matches: IntArray) -> FloatArray | None:
        """(n, 2) the same where each observation may be one landmark only (n,), -1 for none."""
        if not self._repeats:
            return None
        return np.where((matches >= 0)[:, None], np.maximum(self.wider[matches], 1.0), 1.0)

    def news(self, matches: IntArray) -> float:
        """Share of what was seen, on the average, that was not seen before, if it was one of the matches (c, n)."""
        if not self._repeats or not len(matches):
            return 1.0
        wider = np.where(matches >= 0, self.wider[matches, 0], 1.0).max(axis=0)
        return float((1.0 / wider).sum()) / len(wider)

    def terms(self, poses: FloatArray, matches: IntArray, wider: FloatArray | None) -> Terms:
        """matches: (c, n) landmark of each observation, -1 for none, seen from the poses (c, 3).

        It works too where each of the c is of a scan of its own: all that is (n, ...) is (c, n, ...) then.
        """
        matched = matches >= 0
        to = self.positions[matches] - poses[:, None, :2]
        dx, dy = to[..., 0], to[..., 1]
        d = np.maximum(np.hypot(dx, dy), NEAREST_M)
        bearing = np.arctan2(dy, dx) - poses[:, 2:]
        error = np.empty((*matches.shape, 2))
        error[..., 0], error[..., 1] = d - self.range_bearing[..., 0], _turned(bearing - self.range_bearing[..., 1])
        size = 3 if self.shared is None else 5
        jacobian = np.zeros((*matches.shape, 2, size))
        c, s = np.cos(bearing), np.sin(bearing)
        jacobian[..., 0, 0], jacobian[..., 0, 1] = -c, -s
        jacobian[..., 1, 0], jacobian[..., 1, 1], jacobian[..., 1, 2] = s / d, -c / d, -1.0
        own = self.covariance[..., 0, 0], self.covariance[..., 0, 1], self.covariance[..., 1, 1]
        survey = None if self.survey is None else self._survey_as_seen(matches, dx / d, dy / d, d)
        rr, rb, bb = _with(own, survey)
        det = rr * bb - rb * rb
        wrr, wrb, wbb, share = rr, rb, bb, matched / det
        if wider is not None:
            wrr, wrb, wbb = _widened_with(own, survey, wider[:, 0], wider[:, 1])
            share = matched / (wrr * wbb - wrb * wrb)
        weight = np.empty((*matches.shape, 2, 2))
        weight[..., 0, 0], weight[..., 1, 1] = share * wbb, share * wrr
        weight[..., 0, 1] = weight[..., 1, 0] = -share * wrb
        of_shared = None
        if self.shared is not None:
            by_range, by_bearing = self.shared[..., 0], self.shared[..., 1]
            jacobian[..., 0, 3], jacobian[..., 1, 4] = self.shared_widened[..., 0], self.shared_widened[..., 1]
            of_shared = np.empty((*matches.shape, 3))
            share = matched / det
            of_shared[..., 0] = by_range * by_range * bb * share
            of_shared[..., 1] = -by_range * by_bearing * rb * share
            of_shared[..., 2] = by_bearing * by_bearing * rr * share
        peak = np.where(matched, self.log_peak - 0.5 * np.log(det), 0.0)
        return Terms(peak, error, weight, jacobian, of_shared)

    @property
    def shared_plain(self) -> FloatArray:
        """(n, 2); zeros for nothing."""
        return np.zeros((len(self.range_bearing), 2)) if self.shared is None else self.shared

    @cached_property
    def shared_widened(self) -> FloatArray:
        """(n, 2); zeros for nothing."""
        return np.asarray(self.shared_plain * np.sqrt(self.wider_shared))

    def near_any(self, poses: FloatArray) -> BoolArray:
        """(n, m): what may be what from one of the poses (h, 3) at least, by errors that are not widened."""
        errors = self.errors(poses, np.arange(len(self.positions)))
        gain = self.log_gains(errors, None, self.whole_covariance)
        best = np.max(gain, axis=1, initial=-np.inf)
        edge = self.log_peak - 0.5 * np.log(np.linalg.det(self.whole_covariance)) - 0.5 * self.gates
        return np.asarray(best > edge[:, None]) & self.may

    def errors(self, poses: FloatArray, landmarks: IntArray) -> Errors:
        """Of observations as landmarks (k,), at poses (h, 3)."""
        dx, dy = (self.positions[landmarks, k] - poses[:, k : k + 1] for k in (0, 1))
        d = np.maximum(np.hypot(dx, dy), NEAREST_M)
        by_bearing = _turned((np.arctan2(dy, dx) - poses[:, 2:]) - self.range_bearing[:, 1:, None])
        return Errors(landmarks, dx / d, dy / d, d, d - self.range_bearing[:, :1, None], by_bearing)

    def log_gains(self, errors: Errors, wider: FloatArray | None, covariance: FloatArray) -> FloatArray:
        """(n, h, k) log density of observations as landmarks, relative to clutter, by covariances (n, 2, 2)."""
        plain, (rr, rb, bb) = self.noise_at(errors, wider, covariance)
        error_r, error_b = errors.range_m, errors.bearing_rad
        det = rr * bb - rb * rb
        out = error_r * error_r * (bb / det)
        if rb.any():
            out -= error_r * error_b * (2.0 * rb / det)
        out += error_b * error_b * (rr / det)
        out *= -0.5
        out += self.log_peak[:, None, None] - 0.5 * np.log(determinant(plain))
        return np.asarray(out)

    def noise_at(self, errors: Errors, wider: FloatArray | None, covariance: FloatArray) -> tuple[Upper, Upper]:
        """Covariances as they are and widened, (n, h, k) or what broadcasts to it."""
        own = covariance[:, 0, 0, None, None], covariance[:, 0, 1, None, None], covariance[:, 1, 1, None, None]
        survey = None
        if self.survey is not None:
            survey = self._survey_as_seen(errors.landmarks, errors.ux, errors.uy, errors.d)
        plain = _with(own, survey)
        if wider is None:
            return plain, plain
        return plain, _widened_with(own, survey, wider[:, 0, None, None], wider[:, 1, None, None])

    def _survey_as_seen(self, landmark: IntArray, ux: FloatArray, uy: FloatArray, d: FloatArray) -> Upper:
        """The map's errors in range and bearing (...), u the line of sight in the field."""
        assert self.survey is not None
        flat = self.survey[landmark].reshape(*np.shape(landmark), 4)
        sxx, sxy, syy = flat[..., 0], flat[..., 1], flat[..., 3]
        return (
            ux * ux * sxx + 2.0 * ux * uy * sxy + uy * uy * syy,
            (ux * uy * (syy - sxx) + (ux * ux - uy * uy) * sxy) / d,
            (uy * uy * sxx - 2.0 * ux * uy * sxy + ux * ux * syy) / d**2,
        )

    @cached_property
    def points(self) -> tuple[FloatArray, FloatArray]:
        """Where landmarks were seen (n, 2), sensor's frame, and covariances (n, 2, 2) of that, not widened, up to the
        turn that they share."""
        own = self.own if self.shared is None else moments(self.range_bearing, self._with_shared([1.0, 0.0]))
        r = own[2]
        xx, xy, yy = own[5:8] + r * (own[11:14] + r * own[8:11])
        return own[:2].T, np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)

    @cached_property
    def whole_covariance(self) -> FloatArray:
        """(n, 2, 2) of each by itself, with what it shares."""
        return self.covariance if self.shared is None else self._with_shared([1.0, 1.0])

    def _with_shared(self, share: list[float]) -> FloatArray:
        assert self.shared is not None
        return np.asarray(self.covariance + (self.shared**2 * share)[:, :, None] * np.eye(2))

    @cached_property
    def named(self) -> IntArray | None:
        """(n,) landmark of each observation, where their labels say so and none is there twice."""
        if not (self.allowed == 1).all():
            return None
        landmark = self.may.argmax(axis=1)
        return landmark if len(set(landmark.tolist())) == len(landmark) else None

    @cached_property
    def candidates(self) -> tuple[IntArray, IntArray]:
        """Observations and the landmarks that they may be by their labels, (k,) each."""
        row, landmark = np.nonzero(self.may)
        return row, landmark

    @cached_property
    def seen_candidates(self) -> FloatArray:
        """(14, k) `seen` of the candidates."""
        return self.seen[:, self.candidates[0]]

    @cached_property
    def log_peak(self) -> FloatArray:
        """(n,) log density without an error, relative to clutter, of a covariance of determinant 1."""
        return self.log_match - self.log_clutter - _LOG_TWO_PI

    @cached_property
    def gates(self) -> FloatArray:
        return np.where(self.allowed == 1, NAMED_GATE, GATE)

    @cached_property
    def allowed(self) -> IntArray:
        """(n,) how many landmarks each may be by its label."""
        return np.asarray(self.may.sum(axis=1), dtype=np.intp)

    @cached_property
    def rows(self) -> list[Row]:
        """Of n."""
        r, b = self.range_bearing.T.tolist()
        rr, rb, _, bb = self.covariance.reshape(-1, 4).T.tolist()
        plain, widened = self.shared_plain.T.tolist(), self.shared_widened.T.tolist()
        return list(map(Row, r, b, rr, rb, bb, *plain, *widened, self.log_peak.tolist(), self.gates.tolist()))

    @cached_property
    def options(self) -> list[list[int]]:
        """Of n, the landmarks that each may be by its label."""
        if self.named is not None:
            return [[landmark] for landmark in self.named.tolist()]
        out: list[list[int]] = [[] for _ in self.range_bearing]
        for row, landmark in zip(*(side.tolist() for side in self.candidates), strict=True):
            out[row].append(landmark)
        return out

    @cached_property
    def _repeats(self) -> bool:
        return bool((self.wider > 1.0).any())

    @cached_property
    def seen(self) -> FloatArray:
        return self.own if self.shared is None else moments(self.range_bearing, self.whole_covariance)

    @cached_property
    def own(self) -> FloatArray:
        return moments(self.range_bearing, self.covariance)


def _with(own: Upper, survey: Upper | None) -> Upper:
    return own if survey is None else (own[0] + survey[0], own[1] + survey[1], own[2] + survey[2])


def _widened_with(own: Upper, survey: Upper | None, by_range: FloatArray, by_bearing: FloatArray) -> Upper:
    """What is wrong with a place on the map is the same again for longer than anything else: no news either."""
    rr, rb, bb = _widened(own, by_range, by_bearing)
    return (
        (rr, rb, bb)
        if survey is None
        else (rr + by_range * survey[0], rb + by_range * survey[1], bb + by_range * survey[2])
    )


def _widened(own: Upper, by_range: FloatArray, by_bearing: FloatArray) -> Upper:
    return own[0] * by_range, own[1] * np.sqrt(by_range * by_bearing), own[2] * by_bearing


def _turned(angle_rad: FloatArray) -> FloatArray:
    """In [-pi, pi], faster than `wrap`."""
    return np.asarray(angle_rad - 2 * np.pi * np.rint(angle_rad * (0.5 / np.pi)))
