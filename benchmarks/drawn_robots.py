"""Robots as the settings' priors have them, and short logs of theirs among landmarks, with the truth beside them.

A log is drawn from the estimators' own model: the robot does what its odometry says, in its own way, later, and with
noise along the way; it sees landmarks from a pose in the past, turned, with errors that stay alike for a while.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.config import Config
from estimators.motion import PARTS, HeldVelocity
from fieldloc import pose as se2
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan, Measurement, Odometry
from fieldloc.pose import FloatArray
from fieldloc.scan_distortion import PERFECT, ScanDistortion
from logs.recording import Recording

_STEP_NS, _ODOMETRY_STEPS, _SCAN_STEPS = 20_000_000, 5, 15
_BEGIN_NS = 10 * 10**9  # so that nothing is stamped before zero
_HALF_M = np.array([5.0, 3.5])
_LANDMARKS, _APART_M = 14, 1.2
_FARTHEST_M, _WIDEST_RAD = 6.0, np.radians(50.0)
_STATED = np.array([0.05, 0.017])  # of a range, and rad
_STAND, _SIDEWAYS, _SIDEWAYS_MPS, _TURN_RADPS = 0.1, 0.3, 0.2, 1.0
_LEAST, _MOST = 0.05, 9.0  # shares of stated variances that fieldloc.scan_noise_learning looks for


@dataclass(frozen=True, slots=True, eq=False)
class DrawnRobot:
    """calibration: (7,) of the odometry, sensor (4,) of the eyes, as in the settings. late_s: it does so much later
    what the odometry says. motion_scales: (PARTS,) of the variances. own, shared: (2,) variances of
    a landmark's own error in range and bearing, and of what a scan shares, as shares of the stated ones. distortion:
    of its scans."""

    calibration: FloatArray
    sensor: FloatArray
    late_s: float
    motion_scales: FloatArray
    own: FloatArray
    shared: FloatArray
    distortion: ScanDistortion = PERFECT


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """stamps_ns (n,), poses (n, 3): the truth, every 20 ms."""

    robot: DrawnRobot
    recording: Recording
    stamps_ns: NDArray[np.int64]
    poses: FloatArray

    def truth_at(self, stamps_ns: NDArray[np.int64]) -> FloatArray:
        """(m, 3) at other stamps (m,) that it covers."""
        row = np.clip(np.searchsorted(self.stamps_ns, stamps_ns, side="right") - 1, 0, len(self.stamps_ns) - 2)
        share = (stamps_ns - self.stamps_ns[row]) / _STEP_NS
        return se2.retract(self.poses[row], share[:, None] * se2.local(self.poses[row], self.poses[row + 1]))


def drawn_robot(config: Config, random: np.random.Generator) -> DrawnRobot:
    calibration, sensor, noise = config.calibration, config.sensor, config.scan_noise
    own = noise.own * np.exp(noise.own_log_sigma * random.standard_normal(2))
    own = np.clip(own, _LEAST, _MOST)
    shared_range = min(noise.shared * np.exp(noise.shared_log_sigma * random.standard_normal()), _MOST)
    return DrawnRobot(
        random.normal(calibration.means(), calibration.sigmas()),
        random.normal(sensor.means(), sensor.sigmas()),
        random.normal(calibration.odometry_delay_s, calibration.odometry_delay_sigma_s),
        np.exp(config.motion.log_scale_sigma * random.standard_normal(PARTS)),
        own,
        np.array([shared_range, max(1.0 - own[1], noise.shared)]),
        ScanDistortion(*random.normal(config.scan_distortion.means(), config.scan_distortion.sigmas()).tolist()),
    )


def drive(
    robot: DrawnRobot,
    config: Config,
    duration_s: float,
    random: np.random.Generator,
    field: FieldMap | None = None,
) -> Drive:
    """Among landmarks, from one place to another, now and then sideways, now and then standing. field: where these are,
    drawn unless told."""
    stamps_ns = _BEGIN_NS + _STEP_NS * np.arange(round(duration_s * 1e9 / _STEP_NS) + 1)
    field = _landmarks(random) if field is None else field
    held = HeldVelocity(config.motion)
    held.scales = robot.motion_scales
    held.advance(_BEGIN_NS)
    poses, odometry = np.zeros((len(stamps_ns), 3)), list[Measurement]()
    way = _Way(random)
    for k, stamp_ns in enumerate(stamps_ns[:-1].tolist()):
        if k % _ODOMETRY_STEPS == 0:
            said = Odometry(stamp_ns, way.command(poses[k]))
            held.hold(said)
            odometry.append(Odometry(stamp_ns - round(robot.late_s * 1e9), said.velocity))
        motion = held.advance(stamp_ns + _STEP_NS)
        assert motion is not None
        noise = np.linalg.cholesky(motion.covariance) @ random.standard_normal(3)
        step = se2.retract(motion.calibrated(robot.calibration).before_from_after, noise)
        poses[k + 1] = se2.compose(poses[k], step)
    scans = _scans(robot, config, field, stamps_ns, poses, random)
    measurements = [*odometry, *(scan for scan in scans if scan.stamp_ns >= odometry[0].stamp_ns)]
    measurements.sort(key=lambda one: (one.stamp_ns, isinstance(one, LandmarkScan)))
    return Drive(robot, Recording("drawn", field, None, tuple(measurements)), stamps_ns, poses)


class _Way:
    """Says what to do next, a leg of some seconds at a time."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random
        self._left, self._goal, self._most = 0, np.zeros(2), np.zeros(3)

    def command(self, pose: FloatArray) -> FloatArray:
        """(3,) velocity."""
        if self._left == 0:
            draw = self._random
            self._left = int(draw.integers(20, 60))
            self._goal = draw.uniform(-0.8, 0.8, 2) * _HALF_M
            stands = draw.random() < _STAND
            left = draw.uniform(-_SIDEWAYS_MPS, _SIDEWAYS_MPS) * (draw.random() < _SIDEWAYS)
            self._most = np.zeros(3) if stands else np.array([draw.uniform(0.2, 0.6), left, draw.uniform(0.5, 1.0)])
        self._left -= 1
        ahead, aside = se2.apply(se2.inverse(pose), self._goal)
        if np.hypot(ahead, aside) < 0.3:
            self._left = 0
        bearing = np.arctan2(aside, ahead)
        turn = np.clip(2.0 * bearing, -_TURN_RADPS, _TURN_RADPS)
        return np.asarray(self._most * [max(np.cos(bearing), 0.0), 1.0, turn])


def _landmarks(random: np.random.Generator) -> FieldMap:
    places = [np.zeros(2)]
    while len(places) <= _LANDMARKS:
        place = random.uniform(-1.2, 1.2, 2) * _HALF_M
        if min(np.linalg.norm(place - other) for other in places) > _APART_M:
            places.append(place)
    marks = tuple(Landmark(str(k), place, 0.1, np.zeros((2, 2))) for k, place in enumerate(places[1:]))
    return FieldMap("drawn", np.zeros((0, 2, 2)), np.zeros((0, 3)), marks)


def _scans(
    robot: DrawnRobot,
    config: Config,
    field: FieldMap,
    stamps_ns: NDArray[np.int64],
    poses: FloatArray,
    random: np.random.Generator,
) -> list[LandmarkScan]:
    """Errors in stated standard deviations are first-order processes; robot.own and .shared are their variances."""
    *place, bearing_offset_rad, delay_s = robot.sensor
    taken_ns = stamps_ns[_SCAN_STEPS::_SCAN_STEPS]
    correlation = np.array([config.correlation.range_s, config.correlation.bearing_s])
    with np.errstate(divide="ignore"):
        left = np.exp(-_SCAN_STEPS * _STEP_NS * 1e-9 / correlation)
    gain = np.sqrt(1.0 - left**2)
    own, shared = random.standard_normal((len(field.landmarks), 2)), random.standard_normal(2)
    out = []
    for stamp_ns, pose in zip(taken_ns.tolist(), poses[_SCAN_STEPS::_SCAN_STEPS], strict=True):
        own = left * own + gain * random.standard_normal(own.shape)
        shared = left * shared + gain * random.standard_normal(2)
        eyes = se2.compose(pose, np.array([*place, 0.0]))
        away = se2.apply(se2.inverse(eyes), field.positions)
        true = np.column_stack([np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])])
        sigmas = np.column_stack([_STATED[0] * true[:, 0], np.full(len(true), _STATED[1])])
        seen = robot.distortion.added(true) + sigmas * (own * np.sqrt(robot.own) + shared * np.sqrt(robot.shared))
        rows = np.flatnonzero((true[:, 0] < _FARTHEST_M) & (np.abs(true[:, 1]) < _WIDEST_RAD) & (seen[:, 0] > 0.1))
        seen[:, 1] = se2.wrap(seen[:, 1] + bearing_offset_rad)
        stated = np.zeros((len(rows), 2, 2))
        stated[:, 0, 0], stated[:, 1, 1] = (np.column_stack([_STATED[0] * seen[:, 0], sigmas[:, 1]])[rows] ** 2).T
        labels = tuple(field.labels[row] for row in rows)
        out.append(LandmarkScan(stamp_ns + round(delay_s * 1e9), labels, seen[rows], stated))
    return out
