"""Errors beside the least that any unbiased estimator can have, on a model that is known exactly.

A robot sees landmarks all around it, with noise as stated, new each time; its velocity is what its odometry says, up to
noise as stated. Online: the posterior Cramer-Rao bound, recursively (Tichavsky, Muravchik & Nehorai 1998); batch: the
inverse of the information about all poses together. Both at the true poses. Each number is the root mean square error
over the root of the mean bound, 1 at best. "as known": settings that say what is known; below it one of the shipped
ones at a time, which reckon with errors that are not there; last, all as shipped.
"""

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import table
from estimators.config import Calibration, Config, Graph, MotionNoise, Robust, Sensor
from estimators.motion import CALIBRATION
from estimators.registry import ALL
from fieldloc import pose as se2
from fieldloc.detection import Detection
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan, Measurement, Odometry
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation
from fieldloc.scan_distortion import KNOWN as UNDISTORTED
from fieldloc.scan_noise import UNLEARNED
from logs.recording import Recording
from logs.replay import replay

ESTIMATORS = ("ekf", "mixture", "smooth")
_STEP_NS, _SCAN_STEPS = 100_000_000, 2
_PLACES = np.array([[3.0, 2.5], [-3.2, 2.0], [0.4, -3.1], [3.6, -1.5], [-2.5, -2.8], [-0.5, 3.4]])
_VELOCITY = np.diag([0.15, 0.1, 0.15]) ** 2  # of the odometry, m/s and rad/s
SEEN = np.diag([0.1, 0.03]) ** 2  # of range and bearing
_SURELY = 1e-9

KNOWN = Config(
    motion=MotionNoise(log_scale_sigma=0.0),
    robust=Robust(nis_per_dof=1e6, restart_after=10**6),
    mixture=replace(Config().mixture, kidnaps_per_min=_SURELY, evidence_share=1.0),
    graph=Graph(cauchy=1e6, engine="chain"),
    calibration=replace(Calibration(*[0.0] * CALIBRATION), odometry_delay_sigma_s=0.0),
    sensor=Sensor(0.0, 0.0, 0.0, 0.0),
    correlation=ErrorCorrelation(0.0, 0.0, 0.0, 0.0, 0.0),
    detection=Detection(clutter=_SURELY, nothing_right=_SURELY),
    scan_noise=UNLEARNED,
    scan_distortion=UNDISTORTED,
)
"""Everything about the model here."""

_SHIPPED = replace(Config(), graph=Graph(engine="chain"))
SETTINGS: Mapping[str, Config] = MappingProxyType(
    {
        "as known": KNOWN,
        "errors that repeat": replace(KNOWN, correlation=_SHIPPED.correlation),
        "noise to be learned": replace(KNOWN, scan_noise=_SHIPPED.scan_noise),
        "ranges to be calibrated": replace(KNOWN, scan_distortion=_SHIPPED.scan_distortion),
        "outliers": replace(KNOWN, robust=_SHIPPED.robust, graph=_SHIPPED.graph, detection=_SHIPPED.detection),
        "kidnappings": replace(KNOWN, mixture=_SHIPPED.mixture),
        "odometry to be calibrated": replace(KNOWN, calibration=_SHIPPED.calibration),
        "eyes to be calibrated": replace(KNOWN, sensor=_SHIPPED.sensor),
        "all as shipped": _SHIPPED,
    }
)


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """stamps_ns (n,), poses (n, 3): the truth, at each odometry. bounds: (n, 3, 3) covariances in the robot frame that
    none can be below, online and batch."""

    recording: Recording
    stamps_ns: NDArray[np.int64]
    poses: FloatArray
    online: FloatArray
    batch: FloatArray


def run(options: list[str]) -> str:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks bounds", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="walks (20)")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="the first walk's seed (0)")
    parser.add_argument("--duration", type=float, default=40.0, metavar="S", help="length of a walk (40)")
    parser.add_argument("--settings", choices=[*SETTINGS, "all"], default="all", help="which row (all)")
    chosen = parser.parse_args(options)
    walks = [walk(seed, chosen.duration) for seed in range(chosen.first, chosen.first + chosen.seeds)]
    names = list(SETTINGS) if chosen.settings == "all" else [chosen.settings]
    rows = []
    for name in names:
        ratios = [ratio(walks, estimator, SETTINGS[name]) for estimator in ESTIMATORS]
        rows.append((name, *(f"{value:.3f}" for both in ratios for value in both)))
    head = ("settings", *(f"{name} {what}" for name in ESTIMATORS for what in ("m", "rad")))
    return f"{len(walks)} walks of {chosen.duration:g} s\n" + table(head, rows)


def ratio(walks: list[Walk], estimator: str, config: Config) -> tuple[float, float]:
    """Root mean square errors of position and heading over the bounds'."""
    squares, bounds = np.zeros(2), np.zeros(2)
    for one in walks:
        done = {now.stamp_ns: now.pose for now in replay(one.recording, ALL[estimator](config), None, config).estimates}
        rows = [row for row, stamp_ns in enumerate(one.stamps_ns.tolist()) if stamp_ns in done]
        error = np.array([done[int(one.stamps_ns[row])] for row in rows]) - one.poses[rows]
        error[:, 2] = se2.wrap(error[:, 2])
        bound = np.diagonal(one.batch if estimator == "smooth" else one.online, axis1=1, axis2=2)[rows]
        squares += [np.sum(error[:, :2] ** 2), np.sum(error[:, 2] ** 2)]
        bounds += [np.sum(bound[:, :2]), np.sum(bound[:, 2])]
    position, heading = np.sqrt(squares / bounds).tolist()
    return position, heading


def walk(seed: int, duration_s: float) -> Walk:
    """Here and there among the landmarks."""
    random = np.random.default_rng(seed)
    field = FieldMap(
        "bounds",
        np.zeros((0, 2, 2)),
        np.zeros((0, 3)),
        tuple(Landmark(str(k), place, 0.1, np.zeros((2, 2))) for k, place in enumerate(_PLACES)),
    )
    count = round(duration_s * 1e9 / _STEP_NS)
    stamps_ns = 10**9 + _STEP_NS * np.arange(count + 1)
    poses, measurements = [np.array([*random.uniform(-1.0, 1.0, 2), random.uniform(-3.0, 3.0)])], list[Measurement]()
    velocity, goal = np.zeros(3), np.zeros(2)
    for k, stamp_ns in enumerate(stamps_ns.tolist()):
        if k % 20 == 0:
            goal = random.uniform(-1.5, 1.5, 2)
        ahead, aside = se2.apply(se2.inverse(poses[-1]), goal)
        velocity = 0.8 * velocity + 0.2 * np.array([0.4, 0.0, np.clip(np.arctan2(aside, ahead), -0.7, 0.7)])
        measurements.append(Odometry(stamp_ns, velocity, _VELOCITY))
        if k % _SCAN_STEPS == 0:
            true = range_bearing(poses[-1])
            seen = true + random.standard_normal(true.shape) @ np.linalg.cholesky(SEEN).T
            seen[:, 1] = se2.wrap(seen[:, 1])
            stated = np.broadcast_to(SEEN, (len(seen), 2, 2)).copy()
            measurements.append(LandmarkScan(stamp_ns, field.labels, seen, stated))
        if k < count:
            true_velocity = velocity + np.linalg.cholesky(_VELOCITY) @ random.standard_normal(3)
            poses.append(se2.retract(poses[-1], true_velocity * _STEP_NS * 1e-9))
    truth = np.array(poses)
    online, batch = bounds(truth)
    return Walk(Recording(f"walk {seed}", field, None, tuple(measurements)), stamps_ns, truth, online, batch)


def bounds(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 3, 3) each, in the robot frame: of who knows what was before, and of who knows all."""
    count = len(poses)
    whole = np.zeros((count, 3, count, 3))
    known, online = np.zeros((3, 3)), []
    for k, (pose, motion) in enumerate(zip(poses, [*_motions(poses), None], strict=True)):
        seen = information(pose) if k % _SCAN_STEPS == 0 else np.zeros((3, 3))
        known = known + seen
        online.append(np.linalg.inv(known))
        whole[k, :, k] += seen
        if motion is None:
            break
        walked, back = motion
        d11, d12, d22 = back.T @ walked @ back, -back.T @ walked, walked
        whole[k, :, k] += d11
        whole[k, :, k + 1] += d12
        whole[k + 1, :, k] += d12.T
        whole[k + 1, :, k + 1] += d22
        known = d22 - d12.T @ np.linalg.solve(known + d11, d12)
    inverse = np.linalg.inv(whole.reshape(3 * count, 3 * count)).reshape(count, 3, count, 3)
    rows = np.arange(count)
    return np.array(online), np.asarray(inverse[rows, :, rows], dtype=np.float64)


def _motions(poses: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Information (3, 3) that the odometry has of each motion, and how (3, 3) a tangent before it is one after it."""
    step_s = _STEP_NS * 1e-9
    for step in se2.between(poses[:-1], poses[1:]):
        spread = se2.right_jacobian(se2.log(step)) * step_s
        yield np.linalg.inv(spread @ _VELOCITY @ spread.T), se2.adjoint(se2.inverse(step))


def range_bearing(pose: FloatArray) -> FloatArray:
    away = se2.apply(se2.inverse(pose), _PLACES)
    return np.column_stack([np.hypot(away[:, 0], away[:, 1]), np.arctan2(away[:, 1], away[:, 0])])


def information(pose: FloatArray) -> FloatArray:
    """(3, 3) of a scan about the robot-frame tangent of the pose."""
    r, bearing = range_bearing(pose).T
    c, s, zero = np.cos(bearing), np.sin(bearing), np.zeros_like(r)
    jacobian = np.stack([np.stack([-c, -s, zero], axis=-1), np.stack([s / r, -c / r, zero - 1.0], axis=-1)], axis=1)
    return np.asarray(np.einsum("nia,ij,njb->ab", jacobian, np.linalg.inv(SEEN), jacobian))
