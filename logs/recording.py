"""What an estimator may see of a log, read into memory."""

import os
from dataclasses import dataclass

from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import Compass, ImageFeatures, InitialPose, LandmarkScan, Measurement, Odometry
from logs.pictures import has_pictures, picture_features
from logs.progress import Progress, unwatched
from logs.reader import LogFile
from logs.schema import seconds
from logs.whole_scans import whole_scans

_KINDS: tuple[type[Measurement], ...] = (Odometry, InitialPose, Compass, LandmarkScan, ImageFeatures)
"""What goes first at equal stamps: how the robot moves from there on, what it is told, what it sees."""

_PROGRESS_EVERY = 500
_LATE_NS = 1_000_000_000  # an image's way through a robot is shorter; a longer one is a clock that was set


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What an estimator may see of a log: everything but the truth, in the order of the measurements' own stamps.

    warnings: what of the log makes localizing harder than it looks.
    """

    name: str
    field: FieldMap
    camera: Camera | None
    measurements: tuple[Measurement, ...]
    warnings: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        return (self.measurements[-1].stamp_ns - self.measurements[0].stamp_ns) * 1e-9


def load_recording(log: LogFile, field: FieldMap | None = None, progress: Progress = unwatched) -> Recording:
    """`field` stands in for the log's own map. Where the log holds pictures and nobody's word of what is seen in them,
    they are looked at. FieldlocError where there is no map or nothing to localize with.
    """
    field = log.field_map() if field is None else field
    if field is None:
        raise FieldlocError(f"{log.path}: holds no map; name one with --field, for example --field kidsize")
    total = sum(count for source, count in log.sources)
    measurements: list[Measurement] = []
    newest_ns = dict.fromkeys(_KINDS, 0)
    late: list[int] = []
    for measurement in log.measurements():
        kind = type(measurement)
        measurements.append(measurement)
        newest_ns[kind] = max(newest_ns[kind], measurement.stamp_ns)
        late.append(newest_ns[kind] - measurement.stamp_ns)
        if len(measurements) % _PROGRESS_EVERY == 0:
            progress(len(measurements), total, "reading")
    if not any(isinstance(measurement, (ImageFeatures, LandmarkScan)) for measurement in measurements) and has_pictures(
        log
    ):
        measurements += picture_features(log, field, progress)
    if not any(not isinstance(measurement, Odometry) for measurement in measurements):
        topics = ", ".join(log.roles[role] for role in ("landmarks", "image_features", "compass", "initial_pose"))
        raise FieldlocError(f"{log.path}: nothing to localize with: no usable message on {topics}")
    measurements.sort(key=lambda measurement: (measurement.stamp_ns, _KINDS.index(type(measurement))))
    measurements = whole_scans(measurements)
    cameras = list(log.records(Camera))
    warnings = []
    if not any(isinstance(measurement, Odometry) for measurement in measurements):
        warnings.append(f"no usable message on {log.roles['odometry']}: between what is seen the robot may go anywhere")
    if behind := [ns for ns in late if ns > _LATE_NS]:
        warnings.append(
            f"{len(behind)} measurements were logged after others of their topic that are stamped up to "
            f"{seconds(max(behind))} later: all are taken in the order of their stamps"
        )
    if any(camera != cameras[0] for camera in cameras):
        warnings.append(f"{log.roles['camera']} changes on the way: the first one is taken for all images")
    return Recording(
        os.fsencode(log.path.stem).decode(errors="replace"),  # some file names are no text
        field,
        cameras[0] if cameras else None,
        tuple(measurements),
        tuple(f"{log.path}: {warning}" for warning in warnings),
    )
