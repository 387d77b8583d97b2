"""The noise of each sensor's scans, as it is learned on the way."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fieldloc import pose as se2
from fieldloc.covariance import propagate
from fieldloc.measurements import LandmarkScan
from fieldloc.mixture import IntArray
from fieldloc.one_pose import composed
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation, inflation
from fieldloc.scan_alone import fitted, linear, seen_of
from fieldloc.scan_distortion import KNOWN, DistortionLearner, DistortionPrior, ScanDistortion
from fieldloc.scan_expansion import likeliest_near
from fieldloc.scan_mixture import ScanMixture
from fieldloc.scan_model import ScanModel
from fieldloc.scan_noise import UNLEARNED, NoisePrior, ScanNoise
from fieldloc.scan_noise_learning import NoiseLearner, ScanErrors

_EVERY_S = 0.5  # what comes sooner is much the same
_SENSORS = 16
_STEPS = 2  # to where a scan fits best
_FLAT = 1e-2 * np.eye(3)  # of information: two landmarks in line leave a direction open
_HERE = (100.0, 0.0, 0.0, 100.0, 0.0, 100.0)  # the inverse
_SURE = 0.9  # probability of the likeliest assignment, beside all others
_ABOUT = np.diag([0.1, 0.1, 0.05]) ** 2  # m, m, rad: how well poses are known from which landmarks are told apart


@dataclass(frozen=True, slots=True, eq=False)
class LearnedNoise:
    """Of the sensor that is mounted there (3,), from so many scans. log_sigmas: (3,) standard deviations of the
    logarithms of the shares own_range, own_bearing and shared_range. distortion_sigmas: (4,) of the distortion.
    place_sigmas: (2,) metres that this leaves open of where the sensor is, ahead and to the left of the robot."""

    robot_from_sensor: FloatArray
    noise: ScanNoise
    log_sigmas: FloatArray
    distortion: ScanDistortion
    distortion_sigmas: FloatArray
    place_sigmas: FloatArray
    scans: int


class _Learners(NamedTuple):
    """Of one sensor."""

    noise: NoiseLearner
    distortion: DistortionLearner


class ScanNoises:
    """Sensors are told apart by where they are mounted; beyond sixteen places nothing is learned."""

    def __init__(self, prior: NoisePrior, distortion: DistortionPrior, correlation: ErrorCorrelation) -> None:
        self._prior, self._distortion, self._correlation = prior, distortion, correlation
        self._learners: dict[bytes, _Learners] = {}
        self._learned_ns: dict[bytes, int] = {}
        self._seen_ns: dict[bytes, int] = {}

    def of(self, scan: LandmarkScan) -> tuple[ScanNoise, ScanDistortion]:
        """Of its sensor, as known now."""
        learners = self._of(scan.robot_from_sensor.tobytes())
        return learners.noise.noise, learners.distortion.distortion

    def wider_shared(self, scan: LandmarkScan) -> FloatArray:
        """(2,) by how much to widen variances of what is shared, as the scan before had much the same."""
        if self._prior == UNLEARNED:
            return np.ones(2)
        mount = scan.robot_from_sensor.tobytes()
        before_ns = self._seen_ns.get(mount)
        if len(scan.labels):
            self._seen_ns[mount] = scan.stamp_ns
        age_s = np.array(math.inf if before_ns is None else max(scan.stamp_ns - before_ns, 0) * 1e-9)
        by = (self._correlation.range_s, self._correlation.bearing_s)
        return np.array([float(inflation(age_s, correlation_s)) for correlation_s in by])

    def learn(self, mixture: ScanMixture, pose: FloatArray) -> None:
        """From what a robot at the pose (3,) has seen of landmarks that leave no doubt which they are."""
        scan = mixture.scan
        mount = scan.robot_from_sensor.tobytes()
        if (learners := self._learners.get(mount)) is None or len(scan.labels) < 2:
            return
        before_ns = self._learned_ns.get(mount)
        age_s = math.inf if before_ns is None else (scan.stamp_ns - before_ns) * 1e-9
        if age_s < _EVERY_S:
            return
        at = composed(pose, scan.robot_from_sensor)
        # which is which, what was seen before tells as well as what was not
        model = replace(mixture.model, wider=np.ones_like(mixture.model.wider), wider_shared=np.ones(2))
        matches = likeliest_near(model, at, _ABOUT, _SURE)
        if matches is None or len(rows := np.flatnonzero(matches >= 0)) < 2:
            return
        met = errors_at_best(model, at, matches, rows, scan, mixture.field_map.positions_covariance)
        range_bearing = scan.range_bearing[rows]
        unknown = learners.distortion.uncertainty(range_bearing)
        news = 1.0 / float(inflation(np.array(age_s), self._correlation.range_s))
        precision = learners.noise.learn(met, news, unknown)
        learners.distortion.learn(range_bearing, met.error, news * precision)
        self._learned_ns[mount] = scan.stamp_ns

    def learned(self) -> tuple[LearnedNoise, ...]:
        """Of all sensors so far."""
        return tuple(
            LearnedNoise(
                np.frombuffer(mount),
                noise.noise,
                noise.log_sigmas,
                distortion.distortion,
                distortion.sigmas,
                np.sqrt(np.diagonal(propagate(se2.rotation(np.frombuffer(mount)[2]), distortion.place_covariance))),
                noise.count,
            )
            for mount, (noise, distortion) in self._learners.items()
        )

    def _of(self, mount: bytes) -> _Learners:
        if mount in self._learners:
            return self._learners[mount]
        fresh = _Learners(NoiseLearner(self._prior), DistortionLearner(self._distortion))
        if len(self._learners) < _SENSORS and (self._prior, self._distortion) != (UNLEARNED, KNOWN):
            self._learners[mount] = fresh
        return fresh


def errors_at_best(
    model: ScanModel, at: FloatArray, matches: IntArray, rows: IntArray, scan: LandmarkScan, survey: FloatArray
) -> ScanErrors:
    """Errors of the rows of a scan, seen from where they are least, about (3,)."""
    if model.survey is None:
        x, y, heading = at.tolist()
        seen = seen_of(model, matches, None)
        found = fitted(seen, (x, y, heading), _HERE, _STEPS)
        lines, heading = np.array(linear(seen, found)), found[2]
        error, jacobian = lines[:, :2], lines[:, 2:].reshape(-1, 2, 3)
    else:
        for _ in range(_STEPS):
            terms = model.terms(at[None], matches[None], None)
            error, jacobian, weight = terms.error[0, rows], terms.jacobian[0, rows, :, :3], terms.weight[0, rows]
            information = np.einsum("nki,nkl,nlj->ij", jacobian, weight, jacobian)
            gradient = np.einsum("nki,nkl,nl->i", jacobian, weight, error)
            at = se2.retract(at, -np.linalg.solve(information + _FLAT, gradient))
        terms = model.terms(at[None], matches[None], None)
        error, jacobian, heading = terms.error[0, rows], terms.jacobian[0, rows, :, :3], float(at[2])
    by_place = jacobian[:, :, :2] @ se2.rotation(-heading)  # up to the sign
    n = len(rows)
    other = np.zeros((n, 2, n, 2))
    other[np.arange(n), :, np.arange(n)] = propagate(by_place, survey[matches[rows]])
    return ScanErrors(error, jacobian, scan.covariance[rows], other.reshape(2 * n, 2 * n))
