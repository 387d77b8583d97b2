"""A log through an estimator: the loop that the robot runs, with a file as the source."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimators.base import Estimate, Estimator
from estimators.smoother import Smoother
from fieldloc import pose as se2
from fieldloc.association import Belief
from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.factor_builder import FactorBuilder
from fieldloc.field import FieldMap
from fieldloc.measurements import Compass, ImageFeatures, InitialPose, LandmarkScan, Measurement, Odometry
from fieldloc.pose import FloatArray
from logs.reader import LogFile

Progress = Callable[[int, int], None]
"""Told now and then how many of how many measurements are done."""

_PROGRESS_EVERY = 500
_KINDS = (Odometry, LandmarkScan, ImageFeatures, Compass, InitialPose)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What an estimator may see of a log: everything but the truth, in the order of the measurements' own stamps."""

    name: str
    field: FieldMap
    camera: Camera | None
    measurements: tuple[Measurement, ...]

    @property
    def duration_s(self) -> float:
        return (self.measurements[-1].stamp_ns - self.measurements[0].stamp_ns) * 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """Estimates by stamp; seconds that each measurement other than odometry took (k,); what could not be used."""

    estimates: tuple[Estimate, ...]
    update_s: FloatArray
    total_s: float
    warnings: tuple[str, ...]


def load_recording(log: LogFile, field: FieldMap | None = None) -> Recording:
    """`field` stands in for the log's own map. FieldlocError where there is no map or nothing to localize with."""
    field = log.field_map() if field is None else field
    if field is None:
        raise FieldlocError(f"{log.path}: holds no map; name one with --field, for example --field kidsize")
    measurements: list[Measurement] = []
    for kind in _KINDS:
        measurements += log.records(kind)
    if not any(not isinstance(measurement, Odometry) for measurement in measurements):
        topics = ", ".join(log.roles[role] for role in ("landmarks", "image_features", "compass", "initial_pose"))
        raise FieldlocError(f"{log.path}: nothing to localize with: no usable message on {topics}")
    measurements.sort(key=lambda measurement: measurement.stamp_ns)
    camera = next(log.records(Camera), None)
    return Recording(log.path.stem, field, camera, tuple(measurements))


def replay(
    recording: Recording, estimator: Estimator, start_pose: FloatArray | None = None, progress: Progress | None = None
) -> Replay:
    """Feed the recording to the estimator. start_pose: (3,) at the first measurement, known to about 0.1 m and 5 deg.

    FieldlocError if the estimator never got to an estimate.
    """
    began = time.perf_counter()
    builder = FactorBuilder(recording.field, recording.camera)
    if start_pose is not None:
        estimator.start(Estimate(recording.measurements[0].stamp_ns, start_pose, _START_COVARIANCE))
    estimates: list[Estimate] = []
    update_s: list[float] = []
    for done, measurement in enumerate(recording.measurements):
        if isinstance(measurement, Odometry):
            estimator.predict(measurement)
        else:
            before = time.perf_counter()
            estimator.advance(measurement.stamp_ns)
            for factor in builder.build(measurement, _belief(estimator)):
                estimator.update(factor)
            update_s.append(time.perf_counter() - before)
        if (now := estimator.estimate()) is not None:
            if estimates and estimates[-1].stamp_ns == now.stamp_ns:
                estimates.pop()
            estimates.append(now)
        if progress is not None and done % _PROGRESS_EVERY == 0:
            progress(done, len(recording.measurements))
    if not estimates:
        raise FieldlocError(f"{recording.name}: {_never_started(recording)}")
    smoothed = estimator.trajectory() if isinstance(estimator, Smoother) else tuple(estimates)
    return Replay(smoothed, np.array(update_s), time.perf_counter() - began, builder.warnings())


_START_COVARIANCE = np.diag([0.1, 0.1, np.radians(5.0)]) ** 2


def _belief(estimator: Estimator) -> Belief | None:
    now = estimator.estimate()
    return None if now is None else Belief(now.pose, se2.rotate_covariance(now.covariance, -now.pose[2]))


def _never_started(recording: Recording) -> str:
    if len(recording.field.symmetries):
        return "the field looks the same from several poses, so nothing seen tells the start; give it with --start"
    return "nothing seen determines a whole pose, so there is no start; give it with --start"
