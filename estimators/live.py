"""A robot's own loop: what it measures as it comes in, and where the robot is now.

Images come tenths of a second after the odometry of their moment. So everything waits until what is stamped earlier has
had time to come, as long as that has taken lately; the pose is led on to the present by the odometry that waits.
"""

import heapq
from dataclasses import replace
from typing import Protocol

from estimators.base import Ambiguity, Ambiguous, Estimate, Estimator
from estimators.config import Config
from estimators.loop import Loop, Start, Unusable, first_line
from estimators.mixture import MixtureFilter
from estimators.motion import CALIBRATION, STANDSTILL, HeldVelocity
from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.magnitudes import check_magnitudes
from fieldloc.measurements import Measurement, Odometry
from fieldloc.pose import FloatArray

_DEFAULTS = Config()
_LATE_AT_FIRST_NS = 100_000_000
_LATEST_NS = 1_000_000_000  # what comes later is left out, or the clock was set
_CLOCK_WAS_SET = 20  # so many in a row
_LATER = 1.25  # times as late as the latest so far, one may come
_KEPT = 0.9999  # of how late that was, with each measurement


class LiveEstimator(Estimator, Protocol):
    """An estimator that tells what it has learned of the odometry: `mixture`, `ekf` and `particles` do."""

    @property
    def learned(self) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance of what is kept beside the pose, the odometry's calibration first."""


class Localizer:
    """Where the robot is, from its measurements in the order in which they arrive.

    camera: of the images; None where there are none. start: a pose (3,) known to about 0.1 m and 5 deg, or a region or
    its name (`fieldloc.regions`), at the first measurement; None: anywhere on the field. estimator: None for the
    mixture filter. FieldlocError where the map has no such region.

    late: how many measurements came so late that they were left out. A clock that is set while the robot runs costs a
    few of them; estimates are stamped by it as it is.
    """

    def __init__(
        self,
        field: FieldMap,
        camera: Camera | None = None,
        start: Start = None,
        config: Config = _DEFAULTS,
        estimator: LiveEstimator | None = None,
    ) -> None:
        self._estimator: LiveEstimator = MixtureFilter(config) if estimator is None else estimator
        self._loop = Loop(field, camera, self._estimator, start, config)
        self._config = config
        self._waiting: list[tuple[int, bool, int, Measurement]] = []
        self._count = 0
        self._newest_ns: int | None = None
        self._done_ns = 0
        self._wait_ns = float(_LATE_AT_FIRST_NS)
        self._shift_ns = 0  # from the measurements' clock to one that never was set
        self._odometry: Odometry | None = None  # the last that the estimator has heard
        self._out_of_time = 0  # in a row
        self.late = 0

    def take(self, measurement: Measurement) -> None:
        """Whatever arrives; what no arithmetic can use is left out.

        One of `estimators.loop.FAILURES` where the estimator fails.
        """
        if isinstance(measurement, Odometry) and not self._is_usable(measurement):
            return
        if self._shift_ns:
            measurement = replace(measurement, stamp_ns=measurement.stamp_ns + self._shift_ns)
        stamp_ns = measurement.stamp_ns
        if self._newest_ns is None:
            self._newest_ns = self._done_ns = stamp_ns
            self._loop.begin(stamp_ns)
        behind_ns = self._newest_ns - stamp_ns
        if behind_ns > _LATEST_NS:
            self.late += 1
            self._out_of_time += 1
            if self._out_of_time >= _CLOCK_WAS_SET:
                self._shift_ns += behind_ns
            return
        self._out_of_time = 0
        self._wait_ns = max(_LATER * behind_ns, _KEPT * self._wait_ns)
        if stamp_ns < self._done_ns:
            self.late += 1  # for the next one there will be more time
            return
        self._count += 1
        heapq.heappush(self._waiting, (stamp_ns, not isinstance(measurement, Odometry), self._count, measurement))
        self._newest_ns = max(self._newest_ns, stamp_ns)
        while self._waiting and self._waiting[0][0] <= self._newest_ns - self._wait_ns:
            self._do(heapq.heappop(self._waiting)[-1])

    def estimate(self) -> Estimate | None:
        """Where the robot is at the newest stamp that has arrived; None while nothing is known."""
        now = self._estimator.estimate()
        if now is None or self._newest_ns is None:
            return None
        held = HeldVelocity(self._config.motion)
        motion = held.advance(now.stamp_ns) or STANDSTILL
        if self._odometry is not None:
            held.hold(self._odometry)
        waiting = (each[-1] for each in sorted(self._waiting, key=lambda each: each[:3]))
        for odometry in waiting:
            if isinstance(odometry, Odometry):
                motion = motion.then(held.advance(odometry.stamp_ns) or STANDSTILL)
                held.hold(odometry)
        motion = motion.then(held.advance(self._newest_ns) or STANDSTILL)
        motion = motion.calibrated(self._estimator.learned[0][:CALIBRATION])
        pose = se2.compose(now.pose, motion.before_from_after)
        covariance = motion.carry(now.robot_covariance, motion.before_from_after) + motion.covariance
        return Estimate(self._newest_ns - self._shift_ns, pose, se2.rotate_covariance(covariance, float(pose[2])))

    def ambiguity(self) -> Ambiguity | None:
        """All places where the robot may be, with their weights and P(mirrored), at the last stamp that was heeded;
        None while nothing is known, or from an estimator that has one place only."""
        return self._estimator.ambiguity() if isinstance(self._estimator, Ambiguous) else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What could not be used so far."""
        out = list(self._loop.builder.warnings())
        if unusable := self._loop.unusable:
            kind, stamp_ns, why = unusable[0]
            out.append(f"{len(unusable)} measurements left out, the first: {kind} at {stamp_ns} ns: {why}")
        if self.late:
            out.append(f"{self.late} measurements came too late")
        return tuple(out)

    def _do(self, measurement: Measurement) -> None:
        self._done_ns = measurement.stamp_ns
        self._loop.take(measurement)
        if isinstance(measurement, Odometry):
            self._odometry = measurement

    def _is_usable(self, measurement: Measurement) -> bool:
        try:
            check_magnitudes(measurement)
        except ValueError as error:
            self._loop.unusable.append(Unusable(type(measurement).__name__, measurement.stamp_ns, first_line(error)))
            return False
        return True
