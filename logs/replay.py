"""A log through an estimator: the loop that the robot runs, with a file as the source."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from estimators.base import (
    Ambiguity,
    Ambiguous,
    Estimate,
    Estimator,
    Event,
    Guessing,
    MixtureEstimator,
    Seeing,
    Settled,
    Watching,
)
from estimators.config import Config
from estimators.smoother import Smoother
from fieldloc.errors import FieldlocError
from fieldloc.factors import Factor
from fieldloc.field import FieldMap
from fieldloc.measurements import ImageFeatures, Measurement, Observation, Odometry
from fieldloc.mixture import MixtureFactor
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.pose import FloatArray
from fieldloc.regions import Region, anywhere, region
from fieldloc.resolution import Belief, sure
from fieldloc.scan_noises import LearnedNoise
from logs.kept import KeptAmbiguities
from logs.progress import Progress, unwatched
from logs.recording import Recording
from logs.schema import seconds

_DEFAULTS = Config()
_START_COVARIANCE = np.diag([0.1, 0.1, np.radians(5.0)]) ** 2
_PROGRESS_EVERY = 500
_FAILURES = (ValueError, ArithmeticError, RuntimeError)  # of numpy, scipy and gtsam at numbers beyond all reason


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """Estimates by stamp; seconds that each measurement other than odometry took (k,); what could not be used.

    ambiguities, events: what an estimator said of its hypotheses while it ran (`KeptAmbiguities`), if it has any; one
    that looks back, in the end.
    """

    estimates: tuple[Estimate, ...]
    update_s: FloatArray
    total_s: float
    warnings: tuple[str, ...]
    ambiguities: tuple[Ambiguity, ...] = ()
    events: tuple[Event, ...] = ()
    sensors: tuple[LearnedNoise, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A measurement and what the estimator believes after it, None while it knows nothing.

    update_s: what it took, None for odometry.
    """

    measurement: Measurement
    estimate: Estimate | None
    update_s: float | None


class Run:
    """An estimator on its way through a recording.

    start: at the first measurement, a pose (3,) known to about 0.1 m and 5 deg, or a region or its name
    (`fieldloc.regions`). config: how long errors stay alike, how reliably things are seen. FieldlocError where the map
    has no such region.
    """

    def __init__(
        self,
        recording: Recording,
        estimator: Estimator,
        start: FloatArray | Region | str | None = None,
        config: Config = _DEFAULTS,
    ) -> None:
        self.recording = recording
        self.estimator = estimator
        self._told = start if isinstance(start, np.ndarray) else None
        self._region = _region(start, recording.field)
        self._builder = MixtureBuilder(
            recording.field,
            recording.camera,
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
        self._unusable: list[str] = []

    def steps(self) -> Iterator[Step]:
        """Measurement by measurement, once. FieldlocError where the estimator fails."""
        estimator = self.estimator
        looks_back = isinstance(estimator, Smoother)
        first_ns = self.recording.measurements[0].stamp_ns
        with self._failing(first_ns):
            if self._several is not None:
                self._several.start_in(self._region, first_ns)
            if self._told is not None:
                estimator.start(Estimate(first_ns, self._told, _START_COVARIANCE))
        for measurement in self.recording.measurements:
            update_s, now = None, None
            with self._failing(measurement.stamp_ns):
                if isinstance(measurement, Odometry):
                    estimator.predict(measurement)
                else:
                    before = time.perf_counter()
                    estimator.advance(measurement.stamp_ns)
                    self._observe(measurement)
                    update_s = time.perf_counter() - before
                if update_s is not None or not looks_back:  # nobody waits for it who looks back
                    now = estimator.estimate()
                if now is not None:
                    _check(now)
            yield Step(measurement, now, update_s)

    def _observe(self, measurement: Observation) -> None:
        estimator = self.estimator
        factors: tuple[Factor, ...] = ()
        if self._watching is not None and isinstance(measurement, ImageFeatures):
            self._watching.looked()
        try:
            if (mixture := self._builder.build(measurement)) is None:
                return
            if self._several is None:
                factors = sure(mixture, _belief(self._where(mixture)), self._region.log_density)
        except _FAILURES as error:  # numbers beyond all arithmetic
            kind = type(measurement).__name__
            at = seconds(measurement.stamp_ns)
            self._unusable.append(f"{kind} at {at} cannot be computed with: {_first_line(error)}")
            return
        if self._several is not None:
            self._several.observe(mixture)
        for factor in factors:
            estimator.update(factor)
        now = self._where(mixture)
        if now is None:
            self._builder.remember(measurement, mixture, None)
        elif isinstance(measurement, ImageFeatures) and self._is_sure():
            self._builder.remember(measurement, mixture, now.pose, now.robot_covariance)
        else:
            self._builder.remember(measurement, mixture, now.pose)

    def _where(self, mixture: MixtureFactor) -> Estimate | None:
        """What the estimator thinks of the pose that the mixture is about."""
        if mixture.by_sight and self._seeing is not None:
            return self._seeing.seen_from()
        if self._guessing is not None:
            return self._guessing.likeliest()
        return self.estimator.estimate()

    def _is_sure(self) -> bool:
        return self._settled.settled if self._settled is not None else self.estimator.estimate() is not None

    def trajectory(self) -> tuple[Estimate, ...] | None:
        """The past in the light of all steps taken, None where the estimator cannot look back."""
        if not isinstance(self.estimator, Smoother):
            return None
        with self._failing(None):
            self.estimator.relearn(self._builder.relearned)
            estimates = self.estimator.trajectory()
            for now in estimates:
                _check(now)
        return estimates

    @property
    def scan_noises(self) -> tuple[LearnedNoise, ...]:
        """How noisy the scans of each sensor have turned out to be."""
        return self._builder.scan_noises()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What could not be used so far."""
        warnings = [*self._builder.warnings()]
        if self._unusable:
            warnings.append(f"{len(self._unusable)} measurements left out, the first: {self._unusable[0]}")
        return tuple(f"{self.recording.name}: {warning}" for warning in warnings)

    @contextmanager
    def _failing(self, at_ns: int | None) -> Iterator[None]:
        try:
            yield
        except _FAILURES as error:
            when = "solving" if at_ns is None else f"at {seconds(at_ns)}"
            name = type(self.estimator).__name__
            raise FieldlocError(f"{self.recording.name}: {name} failed {when}: {_first_line(error)}") from error


def replay(
    recording: Recording,
    estimator: Estimator,
    start: FloatArray | Region | str | None = None,
    config: Config = _DEFAULTS,
    progress: Progress = unwatched,
) -> Replay:
    """Feed the recording to the estimator, as `Run` does.

    FieldlocError if the estimator never got to an estimate, or failed on the way.
    """
    began = time.perf_counter()
    run = Run(recording, estimator, start, config)
    estimates: list[Estimate] = []
    update_s: list[float] = []
    ambiguous = estimator if isinstance(estimator, Ambiguous) else None
    kept = KeptAmbiguities()
    for done, step in enumerate(run.steps()):
        if step.update_s is not None:
            update_s.append(step.update_s)
            if ambiguous is not None and (now := ambiguous.ambiguity()) is not None:
                kept.take(now)
        if step.estimate is not None:
            if estimates and estimates[-1].stamp_ns == step.estimate.stamp_ns:
                estimates.pop()
            estimates.append(step.estimate)
        if done % _PROGRESS_EVERY == 0:
            progress(done, len(recording.measurements))
    if estimates and isinstance(estimator, Smoother):
        progress(0, 0, "solving")
        estimates = list(run.trajectory() or ())
        if past := estimator.ambiguities():
            kept = KeptAmbiguities()
            for now in past:
                kept.take(now)
    if not estimates:
        raise FieldlocError(f"{recording.name}: {_never_started(recording, unsure=bool(kept.all()))}")
    events = () if ambiguous is None else tuple(sorted(ambiguous.events, key=lambda event: event.stamp_ns))
    total_s = time.perf_counter() - began
    return Replay(tuple(estimates), np.array(update_s), total_s, run.warnings, kept.all(), events, run.scan_noises)


def _region(start: FloatArray | Region | str | None, field: FieldMap) -> Region:
    if isinstance(start, str):
        return region(start, field)
    return start if isinstance(start, Region) else anywhere(field)


def _first_line(error: Exception) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def _belief(now: Estimate | None) -> Belief | None:
    """None also for one that is no number: who gave it is told so where it is checked."""
    if now is None or not (np.isfinite(now.pose).all() and np.isfinite(now.covariance).all()):
        return None
    return Belief(now.pose, now.robot_covariance)


def _check(estimate: Estimate) -> None:
    if not np.isfinite(estimate.pose).all():
        raise ValueError("its pose is not finite")


def _never_started(recording: Recording, unsure: bool) -> str:
    told = "give it with --start X,Y,HEADING_DEG"
    if unsure:
        return f"of all places that the start may be, none has become likely enough to be called an estimate; {told}"
    if len(recording.field.symmetries):
        return f"the field looks the same from several poses, so nothing seen tells the start; {told}"
    return f"nothing seen determines a whole pose, so there is no start; {told}"
