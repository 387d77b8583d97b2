"""The noise of each sensor's scans, as it is learned on the way."""

import math
from dataclasses import dataclass, replace

import numpy as np

from fieldloc import pose as se2
from fieldloc.measurements import LandmarkScan
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation, inflation
from fieldloc.scan_expansion import expand
from fieldloc.scan_mixture import ScanMixture
from fieldloc.scan_noise import AS_STATED, UNLEARNED, NoisePrior, ScanNoise
from fieldloc.scan_noise_learning import NoiseLearner, ScanErrors

_EVERY_S = 0.5  # what comes sooner is much the same
_SENSORS = 16
_SURE = 0.9  # probability of the likeliest assignment, beside all others
_ABOUT = np.diag([0.1, 0.1, 0.05]) ** 2  # m, m, rad: how well poses are known from which landmarks are told apart


@dataclass(frozen=True, slots=True, eq=False)
class LearnedNoise:
    """Of the sensor that is mounted there (3,), from so many scans. log_sigmas: (3,) standard deviations of the
    logarithms of the shares own_range, own_bearing and shared_range."""

    robot_from_sensor: FloatArray
    noise: ScanNoise
    log_sigmas: FloatArray
    scans: int


class ScanNoises:
    """Sensors are told apart by where they are mounted; beyond sixteen places nothing is learned."""

    def __init__(self, prior: NoisePrior, correlation: ErrorCorrelation) -> None:
        self._prior, self._correlation = prior, correlation
        self._learners: dict[bytes, NoiseLearner] = {}
        self._learned_ns: dict[bytes, int] = {}
        self._seen_ns: dict[bytes, int] = {}

    def of(self, scan: LandmarkScan) -> tuple[ScanNoise, FloatArray]:
        """The noise of its sensor, and (2,) by how much to widen variances of what is shared, as the scan before had
        much the same."""
        if self._prior == UNLEARNED:
            return AS_STATED, np.ones(2)
        mount = scan.robot_from_sensor.tobytes()
        if mount not in self._learners and len(self._learners) < _SENSORS:
            self._learners[mount] = NoiseLearner(self._prior)
        learner = self._learners.get(mount, NoiseLearner(self._prior))
        before_ns = self._seen_ns.get(mount)
        if len(scan.labels):
            self._seen_ns[mount] = scan.stamp_ns
        age_s = np.array(math.inf if before_ns is None else max(scan.stamp_ns - before_ns, 0) * 1e-9)
        by = (self._correlation.range_s, self._correlation.bearing_s)
        return learner.noise, np.array([float(inflation(age_s, correlation_s)) for correlation_s in by])

    def learn(self, mixture: ScanMixture, pose: FloatArray) -> None:
        """From what a robot at the pose (3,) has seen of landmarks that leave no doubt which they are."""
        scan = mixture.scan
        mount = scan.robot_from_sensor.tobytes()
        if (learner := self._learners.get(mount)) is None or len(scan.labels) < 2:
            return
        before_ns = self._learned_ns.get(mount)
        age_s = math.inf if before_ns is None else (scan.stamp_ns - before_ns) * 1e-9
        if age_s < _EVERY_S:
            return
        at = se2.compose(pose, scan.robot_from_sensor)
        # which is which, what was seen before tells as well as what was not
        model = replace(mixture.model, wider=np.ones_like(mixture.model.wider), wider_shared=np.ones(2))
        near, every = expand(model, at[None], _ABOUT[None])
        if not len(every) or np.exp(near.evidence - near.evidence.max()).sum() > 1.0 / _SURE:
            return
        matches = every[np.argmax(near.evidence)]
        rows = np.flatnonzero(matches >= 0)
        if len(rows) < 2:
            return
        terms = model.terms(at[None], matches[None], None)
        by_place = terms.jacobian[0, rows, :, :2] @ se2.rotation(-at[2])  # up to the sign
        survey = mixture.field_map.positions_covariance[matches[rows]]
        met = ScanErrors(
            terms.error[0, rows],
            terms.jacobian[0, rows, :, :3],
            scan.covariance[rows],
            by_place @ survey @ np.swapaxes(by_place, -1, -2),
        )
        learner.learn(met, 1.0 / float(inflation(np.array(age_s), self._correlation.range_s)))
        self._learned_ns[mount] = scan.stamp_ns

    def learned(self) -> tuple[LearnedNoise, ...]:
        """Of all sensors so far."""
        return tuple(
            LearnedNoise(np.frombuffer(mount), learner.noise, learner.log_sigmas, learner.count)
            for mount, learner in self._learners.items()
        )
