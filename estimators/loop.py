"""The loop that a robot runs: what it measures, in order of stamps, through an estimator."""

from typing import NamedTuple

import numpy as np

from estimators.base import (
    Estimate,
    Estimator,
    Guessing,
    MixtureEstimator,
    Seeing,
    Settled,
    Watching,
)
from estimators.config import Config
from fieldloc.camera import Camera
from fieldloc.factors import Factor
from fieldloc.field import FieldMap
from fieldloc.measurements import ImageFeatures, Measurement, Observation, Odometry
from fieldloc.mixture import MixtureFactor
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.pose import FloatArray
from fieldloc.regions import Region, anywhere, region
from fieldloc.resolution import Belief, sure

Start = FloatArray | Region | str | None
FAILURES = (ValueError, ArithmeticError, RuntimeError)
"""Of numpy, scipy and gtsam at numbers beyond all reason."""

_DEFAULTS = Config()
_START_COVARIANCE = np.diag([0.1, 0.1, np.radians(5.0)]) ** 2


class Unusable(NamedTuple):
    """An observation that could not be computed with, and why."""

    kind: str
    stamp_ns: int
    why: str


class Loop:
    """An estimator with all that makes mixtures or factors of measurements for it, and remembers what was seen.

    start: at the first measurement, a pose (3,) known to about 0.1 m and 5 deg, or a region or its name
    (`fieldloc.regions`); None: anywhere. FieldlocError where the map has no such region.
    """

    def __init__(
        self,
        field: FieldMap,
        camera: Camera | None,
        estimator: Estimator,
        start: Start = None,
        config: Config = _DEFAULTS,
    ) -> None:
        self.estimator = estimator
        self._told = start if isinstance(start, np.ndarray) else None
        self._region = _region(start, field)
        self.builder = MixtureBuilder(
            field,
            camera,
            config.correlation,
            config.detection,
            config.mount,
            config.scan_noise,
            config.scan_distortion,
        )
        # asked once: asking what an object can do costs more than most of what it does
        self._several = estimator if isinstance(estimator, MixtureEstimator) else None
        self._seeing = estimator if isinstance(estimator, Seeing) else None
        self._guessing = estimator if isinstance(estimator, Guessing) else None
        self._watching = estimator if isinstance(estimator, Watching) else None
        self._settled = estimator if isinstance(estimator, Settled) else None
        self.unusable: list[Unusable] = []

    def begin(self, stamp_ns: int) -> None:
        """To be called once, before anything is taken."""
        if self._several is not None:
            self._several.start_in(self._region, stamp_ns)
        if self._told is not None:
            self.estimator.start(Estimate(stamp_ns, self._told, _START_COVARIANCE))

    def take(self, measurement: Measurement) -> None:
        """One that cannot be computed with is left out and noted in `unusable`. One of FAILURES where the estimator
        fails."""
        if isinstance(measurement, Odometry):
            self.estimator.predict(measurement)
            return
        self.estimator.advance(measurement.stamp_ns)
        if self._watching is not None and isinstance(measurement, ImageFeatures):
            self._watching.looked()
        factors: tuple[Factor, ...] = ()
        try:
            if (mixture := self.builder.build(measurement)) is None:
                return
            if self._several is None:
                factors = sure(mixture, _belief(self._where(mixture)), self._region.log_density)
        except FAILURES as error:  # numbers beyond all arithmetic
            self.unusable.append(Unusable(type(measurement).__name__, measurement.stamp_ns, first_line(error)))
            return
        if self._several is not None:
            self._several.observe(mixture)
        for factor in factors:
            self.estimator.update(factor)
        self._remember(measurement, mixture)

    def _remember(self, measurement: Observation, mixture: MixtureFactor) -> None:
        now = self._where(mixture)
        if now is None:
            self.builder.remember(measurement, mixture, None)
        elif isinstance(measurement, ImageFeatures) and self._is_sure():
            self.builder.remember(measurement, mixture, now.pose, now.robot_covariance)
        else:
            self.builder.remember(measurement, mixture, now.pose)

    def _where(self, mixture: MixtureFactor) -> Estimate | None:
        """What the estimator thinks of the pose that the mixture is about."""
        if mixture.by_sight and self._seeing is not None:
            return self._seeing.seen_from()
        if self._guessing is not None:
            return self._guessing.likeliest()
        return self.estimator.estimate()

    def _is_sure(self) -> bool:
        return self._settled.settled if self._settled is not None else self.estimator.estimate() is not None


def first_line(error: Exception) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def _region(start: Start, field: FieldMap) -> Region:
    if isinstance(start, str):
        return region(start, field)
    return start if isinstance(start, Region) else anywhere(field)


def _belief(now: Estimate | None) -> Belief | None:
    """None also for one that is no number: who gave it is told so where it is checked."""
    if now is None or not (np.isfinite(now.pose).all() and np.isfinite(now.covariance).all()):
        return None
    return Belief(now.pose, now.robot_covariance)
