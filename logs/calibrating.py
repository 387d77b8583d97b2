"""What the logs of one robot say of the robot: solved one by one, put together, written as settings."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from estimators.calibrated import Quantity, RobotCalibration, calibrated, known_section
from estimators.calibrated_noise import calibrated_noise, known_noise
from estimators.config import Config
from estimators.legs import Legs
from estimators.sensor import seen_from
from estimators.smoother import Smoother
from estimators.solution import Solution
from estimators.surveyed import Survey
from estimators.surveyed_map import SurveyedMap, held, surveyed_map
from fieldloc import pose as se2
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import ImageFeatures
from fieldloc.mount_correction import PARTS, MountCorrection
from fieldloc.mount_fit import MountFit, fit_mount
from fieldloc.pose import FloatArray
from fieldloc.scan_distortion import ScanDistortion
from fieldloc.scan_noises import LearnedNoise
from logs.atomic import atomic_text
from logs.progress import Progress, unwatched
from logs.reader import LogFile
from logs.recording import Recording, load_recording
from logs.replay import replay
from logs.surveying import on_one_map, survey
from logs.table import NOTHING, Cell, Table
from logs.table_text import format_columns

_SECTIONS = ("calibration", "sensor", "motion", "scan_distortion", "mount")
_OF_WHAT = {"mount": "camera", "motion": "noise", "scan_distortion": "scans'"}
_MOST_IMAGES = 1000  # of all logs, evenly; neighbours say much the same


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedRobot:
    """logs: names of those that it is from. noise: of its odometry, where that does not state it. scans: of the sensor
    that scans, where there is one. mount: of the camera, where there are images. warnings: what is wrong with the logs.
    landmarks: where they are, if that was asked.
    """

    logs: tuple[str, ...]
    robot: RobotCalibration
    noise: tuple[Quantity, ...]
    scans: tuple[Quantity, ...]
    mount: tuple[Quantity, ...]
    wobble: tuple[float, ...]
    warnings: tuple[str, ...]
    landmarks: SurveyedMap | None = None

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return (*self.robot.quantities, self.robot.late, *self.noise, *self.scans, *self.mount)

    def settings(self, config: Config) -> Config:
        """The settings with what is known now."""
        known = self.robot.settings(config)
        if self.noise:
            known = replace(known, motion=known_noise(config.motion, self.noise))
        if self.scans:
            values, sigmas = zip(*((one.value, one.next_sigma) for one in self.scans), strict=True)
            known = replace(known, scan_distortion=known_section(config.scan_distortion, values, sigmas))
        if not self.mount:
            return known
        return replace(known, mount=_mount(self.mount, self.wobble))


@dataclass(frozen=True, slots=True, eq=False)
class _Views:
    """Images with the poses (n, 3) that they were taken from and covariances (n, 3, 3), robot frame."""

    images: tuple[ImageFeatures, ...]
    poses: FloatArray
    covariances: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    solution: Solution
    legs: Legs
    views: _Views
    sensors: tuple[LearnedNoise, ...]
    survey: Survey | None
    warnings: tuple[str, ...]


def calibrate(
    logs: Sequence[LogFile],
    config: Config,
    field: FieldMap | None = None,
    start: FloatArray | str | None = None,
    progress: Progress = unwatched,
    landmark_sigma_m: float | None = None,
) -> CalibratedRobot:
    """FieldlocError where a log cannot be localized in.

    landmark_sigma_m: standard deviation of where the landmarks are that the map takes as exact, None not to ask where
    they are. FieldlocError also where they are asked and the logs have different maps, or no ranges to landmarks.
    """
    recordings = (load_recording(log, field, progress) for log in logs)
    return calibrate_recordings(recordings, config, start, progress, landmark_sigma_m)


def calibrate_recordings(
    recordings: Iterable[Recording],
    config: Config,
    start: FloatArray | str | None = None,
    progress: Progress = unwatched,
    landmark_sigma_m: float | None = None,
) -> CalibratedRobot:
    """As `calibrate`; ValueError for none."""
    whole = list(recordings)
    if not whole:
        raise ValueError("no logs to calibrate from")
    before = None if landmark_sigma_m is None else on_one_map(whole, landmark_sigma_m)
    if before is not None:
        whole = [replace(recording, field=before) for recording in whole]
    solved, learned = _all_solved(whole, config, start, progress, before)
    fit, found = _fitted(solved, whole, config, progress), _surveyed(solved, before)
    if fit is not None or found is not None:
        # found with the camera where it was thought to be, poses lean that way and hide a part of its error; landmarks
        # beside their places look like noise
        again = config if fit is None else replace(config, mount=_mount(_quantities(fit, config), _wobble(fit)))
        if found is not None:
            whole = [replace(recording, field=held(found)) for recording in whole]
        solved, learned = _all_solved(whole, again, start, progress, before)
        fit, found = _fitted(solved, whole, config, progress), _surveyed(solved, before)
    scanning = solved[-1].sensors
    place = scanning[0].place_sigmas if len(scanning) == 1 else None
    robot = calibrated([one.solution for one in solved], config, place)
    quantities = () if fit is None else _quantities(fit, config)
    wobble = () if fit is None else _wobble(fit)
    warnings = tuple(warning for one in solved for warning in one.warnings)
    scans = _scans(config, learned)
    noise = calibrated_noise([one.legs for one in solved], config.motion)
    names = tuple(one.name for one in whole)
    return CalibratedRobot(names, robot, noise, scans, quantities, wobble, warnings, found)


def _all_solved(
    recordings: Sequence[Recording],
    config: Config,
    start: FloatArray | str | None,
    progress: Progress,
    before: FieldMap | None,
) -> tuple[list[_Solved], Config]:
    """Each with what those before say of the sensor's distortion, and the settings with what all of them say of it."""
    solved, learned = [], config
    for recording in recordings:
        solved.append(_solved(recording, learned, start, progress, before, config))
        learned = _learned(learned, solved[-1].sensors)
    return solved, learned


def _surveyed(solved: Sequence[_Solved], before: FieldMap | None) -> SurveyedMap | None:
    surveys = [one.survey for one in solved if one.survey is not None]
    return surveyed_map(before, surveys) if before is not None and surveys else None


def _learned(config: Config, sensors: Sequence[LearnedNoise]) -> Config:
    """What a log says of its sensor's distortion is what is known before the next. The settings have place for one
    sensor: of several nothing is kept."""
    if len(sensors) != 1:
        return config
    (one,) = sensors
    sigmas = np.minimum(one.distortion_sigmas, config.scan_distortion.sigmas()).tolist()
    return replace(config, scan_distortion=known_section(config.scan_distortion, one.distortion, sigmas))


def _scans(before: Config, learned: Config) -> tuple[Quantity, ...]:
    if learned is before:
        return ()
    prior, found = before.scan_distortion, learned.scan_distortion
    numbers = (prior.means(), found.means(), found.sigmas(), prior.sigmas())
    every = zip(ScanDistortion._fields, *(each.tolist() for each in numbers), strict=True)
    return tuple(Quantity.found("scan_distortion", name, *each) for name, *each in every)


def _solved(
    recording: Recording,
    config: Config,
    start: FloatArray | str | None,
    progress: Progress,
    before: FieldMap | None,
    prior: Config,
) -> _Solved:
    """before: the map whose landmarks are to be surveyed, None for none; prior: what is known before all logs."""
    smoother = Smoother(config)
    done = replay(recording, smoother, start, config, progress)
    if smoother.solution is None:
        raise FieldlocError(f"{recording.name}: it says nothing of the robot: no start was found")
    stamps_ns = [one.stamp_ns for one in done.estimates]
    views = _views(recording.measurements, stamps_ns, smoother.solution)
    found = None
    if before is not None and smoother.chain is not None:
        found = survey(recording, smoother.chain, smoother.solution, done.sensors, before, prior)
    warnings = (*recording.warnings, *done.warnings)
    return _Solved(smoother.solution, smoother.legs, views, done.sensors, found, warnings)


def _views(measurements: Sequence[object], stamps_ns: Sequence[int], solution: Solution) -> _Views:
    node = {stamp_ns: row for row, stamp_ns in enumerate(stamps_ns)}
    images = [one for one in measurements if isinstance(one, ImageFeatures) and (one.lines or one.posts)]
    images = [one for one in images if node.get(one.stamp_ns, 0) > 0]
    rows = np.array([node[one.stamp_ns] for one in images], dtype=np.intp)
    poses = solution.poses[rows].reshape(-1, 3)
    before = solution.poses[rows - 1].reshape(-1, 3)
    elapsed_s = (np.array(stamps_ns)[rows] - np.array(stamps_ns)[rows - 1]).reshape(-1, 1) * 1e-9
    velocities = se2.log(se2.between(before, poses)) / elapsed_s
    seen = seen_from(poses, np.array(solution.sensor), velocities)
    return _Views(tuple(images), seen, solution.covariances[rows].reshape(-1, 3, 3))


def _fitted(
    solved: Sequence[_Solved], recordings: Sequence[Recording], config: Config, progress: Progress
) -> MountFit | None:
    """The fit is to the mount as the settings have it. None without images."""
    cameras = [recording.camera for recording in recordings if recording.camera is not None]
    images = [replace(one, mount=config.mount.applied(one.mount)) for each in solved for one in each.views.images]
    if not images or not cameras:
        return None
    progress(0, 0, "the camera's mount")
    poses = np.concatenate([each.views.poses for each in solved])
    covariances = np.concatenate([each.views.covariances for each in solved])
    kept = np.unique(np.linspace(0, len(images) - 1, min(len(images), _MOST_IMAGES)).astype(np.intp))
    claimed = np.append(np.sqrt(np.diagonal(images[0].mount.covariance))[[0, 2, 3]], config.mount.log_focal_sigma)
    return fit_mount(
        [images[k] for k in kept],
        poses[kept],
        covariances[kept],
        config.mount.camera(cameras[-1]),
        recordings[-1].field,
        claimed,
    )


def _quantities(fit: MountFit, config: Config) -> tuple[Quantity, ...]:
    found = zip(
        PARTS, fit.error.tolist(), np.sqrt(np.diagonal(fit.covariance)).tolist(), fit.sigmas.tolist(), strict=True
    )
    before = {name: float(getattr(config.mount, name)) for name in PARTS}
    return tuple(
        Quantity.found("mount", name, before[name], before[name] + error, sigma, prior)
        for name, error, sigma, prior in found
    )


def _wobble(fit: MountFit) -> tuple[float, ...]:
    return tuple(fit.wobble.tolist())


def _mount(quantities: Sequence[Quantity], wobble: Sequence[float]) -> MountCorrection:
    """With what is left from image to image; what is the same in all of them is known as well as on another day."""
    left = [
        float(np.hypot(one.sigma, own)) if own > 0.0 else one.next_sigma
        for one, own in zip(quantities, wobble, strict=True)
    ]
    return MountCorrection(*(one.value for one in quantities), *left)


def calibration_table(done: CalibratedRobot) -> str:
    """For the terminal; no newline at the end."""
    titles = ("quantity", "value", "sigma", "sigma before", "unit", "log-likelihood")
    rows = tuple(tuple(map(Cell, _row(quantity))) for quantity in done.quantities)
    return format_columns(Table(tuple(("", title) for title in titles), rows)).lstrip("\n")


def write_settings(path: Path, done: CalibratedRobot, config: Config) -> None:
    """A TOML file that --config takes, with what was estimated beside its settings. It appears whole or not at all."""
    known = done.settings(config)
    with atomic_text(path) as file:
        file.write(
            f"# What {', '.join(done.logs)} says of the robot. A robot is not quite the same the next day: sigmas\n"
        )
        file.write("# here are a little wider than estimated.\n")
        sections = {name: getattr(known, name) for name in _SECTIONS}
        for section, values in sections.items():
            quantities = [one for one in done.quantities if one.section == section]
            if not quantities:
                continue
            file.write(f"\n[{section}]\n")
            for quantity in quantities:
                said = f"+- {quantity.sigma:.2g}" if quantity.told else "these logs say nothing of it"
                file.write(f"{quantity.name} = {getattr(values, quantity.name)!r}  # {quantity.unit}, {said}\n")
            for name in (item.name for item in fields(values) if "sigma" in item.name):
                file.write(f"{name} = {float(getattr(values, name))!r}\n")


def _row(quantity: Quantity) -> tuple[str, ...]:
    name = f"{_OF_WHAT.get(quantity.section, '')} {quantity.plain_name}".lstrip()
    value, before = f"{quantity.value:+.4f}", f"{quantity.prior_sigma:.4f}"
    if not quantity.told:
        return name, value, "not told", before, quantity.unit, NOTHING
    return name, value, f"{quantity.sigma:.4f}", before, quantity.unit, f"{quantity.log_gain:+.1f}"
