"""A log through an estimator: the loop that the robot runs (estimators.loop), with a file as the source."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from estimators.base import Ambiguity, Ambiguous, Estimate, Estimator, Event
from estimators.config import Config
from estimators.loop import FAILURES, Loop, Start, first_line
from estimators.smoother import Smoother
from fieldloc.errors import FieldlocError
from fieldloc.measurements import Measurement, Odometry
from fieldloc.pose import FloatArray
from fieldloc.scan_noises import LearnedNoise
from logs.kept import KeptAmbiguities
from logs.progress import Progress, unwatched
from logs.recording import Recording
from logs.schema import seconds

_DEFAULTS = Config()
_PROGRESS_EVERY = 500


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

    start: as of `estimators.loop.Loop`. config: how long errors stay alike, how reliably things are seen. FieldlocError
    where the map has no such region.
    """

    def __init__(
        self, recording: Recording, estimator: Estimator, start: Start = None, config: Config = _DEFAULTS
    ) -> None:
        self.recording = recording
        self.estimator = estimator
        self._loop = Loop(recording.field, recording.camera, estimator, start, config)

    def steps(self) -> Iterator[Step]:
        """Measurement by measurement, once. FieldlocError where the estimator fails."""
        estimator, loop = self.estimator, self._loop
        looks_back = isinstance(estimator, Smoother)
        first_ns = self.recording.measurements[0].stamp_ns
        with self._failing(first_ns):
            loop.begin(first_ns)
        for measurement in self.recording.measurements:
            update_s, now = None, None
            with self._failing(measurement.stamp_ns):
                before = time.perf_counter()
                loop.take(measurement)
                if not isinstance(measurement, Odometry):
                    update_s = time.perf_counter() - before
                if update_s is not None or not looks_back:  # nobody waits for it who looks back
                    now = estimator.estimate()
                if now is not None:
                    _check(now)
            yield Step(measurement, now, update_s)

    def trajectory(self) -> tuple[Estimate, ...] | None:
        """The past in the light of all steps taken, None where the estimator cannot look back."""
        if not isinstance(self.estimator, Smoother):
            return None
        with self._failing(None):
            self.estimator.relearn(self._loop.builder.relearned)
            estimates = self.estimator.trajectory()
            for now in estimates:
                _check(now)
        return estimates

    @property
    def scan_noises(self) -> tuple[LearnedNoise, ...]:
        """How noisy the scans of each sensor have turned out to be."""
        return self._loop.builder.scan_noises()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What could not be used so far."""
        warnings = [*self._loop.builder.warnings()]
        if unusable := self._loop.unusable:
            kind, stamp_ns, why = unusable[0]
            first = f"{kind} at {seconds(stamp_ns)} cannot be computed with: {why}"
            warnings.append(f"{len(unusable)} measurements left out, the first: {first}")
        return tuple(f"{self.recording.name}: {warning}" for warning in warnings)

    @contextmanager
    def _failing(self, at_ns: int | None) -> Iterator[None]:
        try:
            yield
        except FAILURES as error:
            when = "solving" if at_ns is None else f"at {seconds(at_ns)}"
            name = type(self.estimator).__name__
            raise FieldlocError(f"{self.recording.name}: {name} failed {when}: {first_line(error)}") from error


def replay(
    recording: Recording,
    estimator: Estimator,
    start: Start = None,
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
