"""Whether what is learned of a robot is true: robots drawn from the priors, each with one short log, solved and told.

inside: share of robots whose true value is within two standard deviations of what was found, 95 % if these are right;
squared: mean of the squared error in standard deviations, 1 then. error, prior: root mean square of the error, and
the standard deviation before the log. What no log tells apart is found no better than before, and says so.
"""

import argparse
import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np

from benchmarks.drawn_maps import found_landmarks
from benchmarks.drawn_mounts import found_mount
from benchmarks.drawn_robots import Drive, drawn_robot, drive
from benchmarks.timing import table
from estimators.base import Estimate
from estimators.calibrated import calibrated, with_open_place
from estimators.config import Config, Graph
from estimators.mixture import MixtureFilter
from estimators.motion import OdometryCalibration
from estimators.sensor import SensorCalibration
from estimators.smoother import Smoother
from fieldloc import pose as se2
from fieldloc.covariance import squared_mahalanobis
from fieldloc.pose import FloatArray
from fieldloc.scan_distortion import ScanDistortion
from logs.replay import replay

NAMES = (*OdometryCalibration._fields, *SensorCalibration._fields, "odometry_delay_s", *ScanDistortion._fields)
_CONVERGED_S = 30.0
_FIRST_S = 5.0  # by then a robot that is told nothing has seen where it is

_Some = TypeVar("_Some")


class Found(NamedTuple):
    """A number of a robot. error: found less true. prior: standard deviation beforehand."""

    name: str
    error: float
    sigma: float
    prior: float


class Driven(NamedTuple):
    """What became of one log. Errors of poses (n, 4): seconds since the log's begin, m, rad, and the squared distance
    in standard deviations."""

    batch: tuple[Found, ...]
    online: tuple[Found, ...]
    batch_errors: FloatArray
    online_errors: FloatArray


def run(options: list[str]) -> str:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks robots", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "--what", choices=["robots", "mounts", "landmarks", "all"], default="robots", help="which (robots)"
    )
    parser.add_argument("--seeds", type=int, default=100, metavar="N", help="robots of each kind (100)")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="the first robot's seed (0)")
    parser.add_argument("--duration", type=float, default=60.0, metavar="S", help="of a log; a game takes half (60)")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (1)")
    chosen = parser.parse_args(options)
    seeds = range(chosen.first, chosen.first + chosen.seeds)
    text = []
    if chosen.what in ("robots", "all"):
        driven = _all(partial(driven_by, chosen.duration), seeds, chosen.jobs)
        text += [f"{len(driven)} robots, {chosen.duration:g} s each", _poses(driven)]
        text += ["batch", coverage([one.batch for one in driven]), "online", coverage([one.online for one in driven])]
    if chosen.what in ("mounts", "all"):
        mounts = _all(partial(found_mount, 0.5 * chosen.duration), seeds, chosen.jobs)
        found = [tuple(Found(*one) for one in mount) for mount in mounts]
        text += [f"camera mounts, {len(found)} games of {0.5 * chosen.duration:g} s", coverage(found)]
    if chosen.what in ("landmarks", "all"):
        maps = _all(partial(found_landmarks, chosen.duration), seeds, chosen.jobs)
        every = [(Found(*one),) for one_map in maps for one in one_map]
        text += [f"landmarks, x and y each, {len(maps)} maps and logs of {chosen.duration:g} s", coverage(every)]
    return "\n\n".join(text)


def driven_by(duration_s: float, seed: int) -> Driven:
    """A robot of that seed, by the smoother and by the online mixture filter, as shipped."""
    config = replace(Config(), graph=Graph(engine="chain"))
    random = np.random.default_rng(seed)
    log = drive(drawn_robot(config, random), config, duration_s, random)
    eyes = [*log.robot.sensor, log.robot.late_s]
    true = np.array([*log.robot.calibration, *eyes, *log.robot.distortion])
    late_sigma_s, distortion = config.calibration.odometry_delay_sigma_s, config.scan_distortion.sigmas()
    priors = np.array([*config.calibration.sigmas(), *config.sensor.sigmas(), late_sigma_s, *distortion])
    smoother, ahead = Smoother(config), MixtureFilter(config)
    looked_back, told = replay(log.recording, smoother, None, config), replay(log.recording, ahead, None, config)
    assert smoother.solution is not None
    (scanner,) = looked_back.sensors
    robot = calibrated([smoother.solution], config, scanner.place_sigmas)
    quantities = (*robot.quantities, robot.late)
    extra, known = ahead.learned
    online, sigmas = extra[:-1], np.sqrt(np.diag(known))[:-1]  # less the compass
    sigmas = with_open_place(sigmas, priors[: len(sigmas)], scanner.place_sigmas)
    scans = [*scanner.distortion], [*scanner.distortion_sigmas]
    return Driven(
        _found(
            [*(one.value for one in quantities), *scans[0]] - true,
            [*(one.sigma for one in quantities), *scans[1]],
            priors,
        ),
        _found([*online, *scans[0]] - true, [*sigmas, *scans[1]], priors),
        _errors(log, looked_back.estimates),
        _errors(log, told.estimates),
    )


def coverage(robots: Sequence[Sequence[Found]]) -> str:
    """A row for each of the numbers that all of them have."""
    rows = []
    for same in zip(*robots, strict=True):
        error, sigma = np.array([one.error for one in same]), np.array([one.sigma for one in same])
        root = np.sqrt(np.mean(error**2))
        rows.append(
            (
                same[0].name,
                f"{100.0 * np.mean(np.abs(error) < 2.0 * sigma):.1f} %",
                f"{np.mean((error / sigma) ** 2):.2f}",
                f"{np.mean(error / sigma):+.2f}",
                f"{root:.4f}",
                f"{np.sqrt(np.mean(sigma**2)):.4f}",
                f"{same[0].prior:.4f}",
                f"{root / same[0].prior:.2f}",
            )
        )
    return table(("quantity", "inside", "squared", "mean", "error", "sigma", "prior", "error / prior"), rows)


def _poses(driven: Sequence[Driven]) -> str:
    rows = []
    for name, all_errors in (
        ("batch", [one.batch_errors for one in driven]),
        ("online", [one.online_errors for one in driven]),
    ):
        errors = np.concatenate(all_errors)
        for when, those in (
            (f"{_FIRST_S:g} to {_CONVERGED_S:g} s", (errors[:, 0] >= _FIRST_S) & (errors[:, 0] < _CONVERGED_S)),
            (f"from {_CONVERGED_S:g} s on", errors[:, 0] >= _CONVERGED_S),
        ):
            seconds, metres, radians, squared = errors[those].T
            if len(seconds):
                rows.append(
                    (
                        f"{name}, {when}",
                        f"{np.sqrt(np.mean(metres**2)):.3f}",
                        f"{np.degrees(np.sqrt(np.mean(radians**2))):.2f}",
                        f"{np.mean(squared) / 3.0:.2f}",
                        f"{np.median(squared) / 2.366:.2f}",
                        f"{100.0 * np.mean(squared < 14.16):.1f} %",
                    )
                )
    return table(("poses", "ATE m", "heading deg", "ANEES", "by median", "in 3 sigma"), rows)


def _found(errors: FloatArray, sigmas: Sequence[float] | FloatArray, priors: FloatArray) -> tuple[Found, ...]:
    return tuple(map(Found, NAMES, errors.tolist(), np.asarray(sigmas).tolist(), priors.tolist()))


def _errors(log: Drive, estimates: Sequence[Estimate]) -> FloatArray:
    covered = [one for one in estimates if log.stamps_ns[0] <= one.stamp_ns <= log.stamps_ns[-1]]
    stamps_ns = np.array([one.stamp_ns for one in covered])
    error = np.array([one.pose for one in covered]) - log.truth_at(stamps_ns)
    error[:, 2] = se2.wrap(error[:, 2])
    squared = squared_mahalanobis(error, np.array([one.covariance for one in covered]))
    since_s = (stamps_ns - log.stamps_ns[0]) * 1e-9
    return np.column_stack([since_s, np.hypot(error[:, 0], error[:, 1]), error[:, 2], squared])


def _all(one: Callable[[int], _Some], seeds: Sequence[int], jobs: int) -> list[_Some]:
    if jobs == 1:
        return [one(seed) for seed in seeds]
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(one, seeds))
