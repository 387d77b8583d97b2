"""A robot that walks exactly as the estimators' motion model says, and what it reports on the way."""

from collections.abc import Iterable, Sequence

import numpy as np

from estimators.base import Estimate, Estimator
from estimators.config import Calibration, Config, MotionNoise, Sensor
from estimators.motion import CALIBRATION, OdometryCalibration
from fieldloc import pose as se2
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan, Odometry
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation

KnownFactor = PoseFactor | LandmarkFactor | HeadingFactor | LineFactor
Event = Odometry | KnownFactor

SECOND = 1_000_000_000
POSITIONS = np.array([[4.0, 3.0], [4.0, -3.0], [-4.0, 3.0], [-4.0, -3.0], [0.0, 4.0], [0.5, -4.0]])
FIELD = FieldMap(
    "six posts",
    np.zeros((0, 2, 2)),
    np.zeros((0, 3)),
    tuple(Landmark(str(i), position, 0.1, np.zeros((2, 2))) for i, position in enumerate(POSITIONS)),
)
PERFECT = OdometryCalibration()
TAKEN_AT_ITS_WORD = Calibration(*[0.0] * CALIBRATION, odometry_delay_sigma_s=0.0)
GENTLE = MotionNoise(0.05, 0.03, 0.05, 0.05, log_scale_sigma=1.0)
KNOWN_NOISE = MotionNoise(0.05, 0.03, 0.05, 0.05, log_scale_sigma=0.0)
PLAIN = Config(motion=KNOWN_NOISE, calibration=TAKEN_AT_ITS_WORD, sensor=Sensor(0.0, 0.0, 0.0, 0.0))
SIGMA_RANGE_M, SIGMA_BEARING_RAD = 0.05, 0.03
ALL_NEWS = ErrorCorrelation(0.0, 0.0, 0.0, 0.0)
_NEARLY_SURE = np.diag([1e-3, 1e-3, 1e-3]) ** 2


def ns(stamp_s: float) -> int:
    return round(stamp_s * SECOND)


def feed(estimator: Estimator, events: Iterable[Event | Factor]) -> list[Estimate]:
    """The estimate after each event, where there is one."""
    out = []
    for event in events:
        if isinstance(event, Odometry):
            estimator.predict(event)
        else:
            estimator.update(event)
        if (now := estimator.estimate()) is not None:
            out.append(now)
    return out


def transformed(event: Event, by: FloatArray) -> Event:
    """The same event on a field that was moved rigidly."""
    match event:
        case PoseFactor():
            return PoseFactor(event.stamp_ns, se2.compose(by, event.pose), event.covariance)
        case LandmarkFactor():
            return LandmarkFactor(event.stamp_ns, se2.apply(by, event.landmark), event.seen, event.covariance)
        case HeadingFactor():
            return HeadingFactor(event.stamp_ns, float(se2.wrap(event.heading_rad + by[2])), event.covariance)
        case LineFactor():
            normal_rad = event.normal_rad + by[2]
            offset_m = event.offset_m + np.cos(normal_rad) * by[0] + np.sin(normal_rad) * by[1]
            heading_rad = float(se2.wrap(event.heading_rad + by[2]))
            return LineFactor(event.stamp_ns, heading_rad, normal_rad, offset_m, event.covariance)
        case Odometry():
            return event


def velocities(count: int) -> FloatArray:
    """(count, 3) for 10 Hz: straight, a sharp turn, sideways, a turn on the spot, an arc, standing."""
    script = np.array(
        [[0.6, 0, 0], [0.4, 0, 1.8], [0.1, 0.3, 0], [0, 0, -2.5], [0.5, 0.1, 0.4], [0, 0, 0], [0.7, 0, -0.3]]
    )
    return np.asarray(script[(np.arange(count) // 8) % len(script)])


def density(velocity: FloatArray, noise: MotionNoise) -> FloatArray:
    """(3, 3) per second, from what MotionNoise says of each of its numbers."""
    forward, left, turn = np.abs(velocity)
    return np.diag(
        [
            noise.forward_m_per_sqrt_m**2 * forward
            + noise.sideways_m_per_sqrt_m**2 * left
            + noise.idle_m_per_sqrt_s**2,
            noise.forward_m_per_sqrt_m**2 * left
            + noise.sideways_m_per_sqrt_m**2 * forward
            + noise.idle_m_per_sqrt_s**2,
            noise.turn_rad_per_sqrt_rad**2 * turn
            + noise.turn_rad_per_sqrt_m**2 * np.hypot(forward, left)
            + noise.idle_rad_per_sqrt_s**2,
        ]
    )


def calibrated(velocity: FloatArray, calibration: OdometryCalibration) -> FloatArray:
    """How the robot really moves when its odometry says `velocity` (3,), from the words of OdometryCalibration.

    Its numbers may be arrays, of one robot each.
    """
    forward, left, turn = velocity
    c = calibration
    scale = c.scale - c.turn_slowing_s * np.abs(turn)
    moved = [
        forward * (1.0 + scale) - left * c.crab_rad + c.drift_mps,
        left * (1.0 + scale) + forward * c.crab_rad + c.side_drift_mps,
        turn * (1.0 + c.turn_scale) + forward * c.veer_rad_per_m + c.turn_drift_radps,
    ]
    return np.stack(np.broadcast_arrays(*moved), axis=-1)


def walk(
    start: FloatArray,
    commands: FloatArray,
    step_s: float,
    random: np.random.Generator,
    noise: MotionNoise | None = None,
    calibration: OdometryCalibration = PERFECT,
    substeps: int = 4,
) -> FloatArray:
    """Poses (len(commands) + 1, walks, 3) of robots from start (walks, 3): white noise, drawn anew in each substep."""
    noise = GENTLE if noise is None else noise
    pose, part_s = start, step_s / substeps
    out = [pose]
    for command in commands:
        sigma = np.sqrt(np.diag(density(command, noise)) * part_s)
        for _ in range(substeps):
            pose = se2.compose(pose, se2.exp(calibrated(command, calibration) * part_s))
            pose = se2.retract(pose, sigma * random.standard_normal(pose.shape))
        out.append(pose)
    return np.array(out)


def scan(
    stamp_ns: int,
    pose: FloatArray,
    random: np.random.Generator,
    max_range_m: float = 5.0,
    labelled: bool = True,
    mount: FloatArray | None = None,
    noisy: bool = True,
) -> LandmarkScan:
    """The posts within reach from a pose (3,)."""
    mount = np.zeros(3) if mount is None else mount
    at = se2.apply(se2.inverse(se2.compose(pose, mount)), POSITIONS)
    seen = np.stack([np.hypot(at[:, 0], at[:, 1]), np.arctan2(at[:, 1], at[:, 0])], axis=-1)
    near = np.flatnonzero(seen[:, 0] < max_range_m)
    sigmas = np.array([SIGMA_RANGE_M, SIGMA_BEARING_RAD])
    seen = seen[near] + (sigmas * random.standard_normal((len(near), 2)) if noisy else 0.0)
    labels: Sequence[str | None] = [FIELD.labels[i] if labelled else None for i in near]
    return LandmarkScan(stamp_ns, tuple(labels), seen, np.tile(np.diag(sigmas**2), (len(near), 1, 1)), mount)


def right_factors(made: LandmarkScan, truth: FloatArray) -> tuple[Factor, ...]:
    """What the scan says if each post is taken for itself: its likeliest solution where it was made. All is news."""
    mixture = MixtureBuilder(FIELD, correlation=ALL_NEWS).build(made)
    if mixture is None:
        return ()
    seen = mixture.expand(truth[None], _NEARLY_SURE[None])
    return mixture.chosen(int(seen.ids[np.argmax(seen.evidence)])) if len(seen.ids) else ()


def nees(estimate: Estimate, truth: FloatArray) -> float:
    """Normalised estimation error squared, field axes."""
    error = truth - estimate.pose
    error[2] = se2.wrap(error[2])
    return float(error @ np.linalg.solve(estimate.covariance, error))
