"""Odometry that leads the robot: what is found of it, what is left to the eyes, and where the robot was."""

from dataclasses import replace

import numpy as np
import pytest
from pose_sights import LOPSIDED, of_poses
from walks import GENTLE, ns, velocities, walk

from estimators.chain import Recorded
from estimators.config import Calibration, Config, Sensor
from estimators.lateness import against_odometry, later, may_be_late, split
from estimators.motion import HeldVelocity, Increment
from estimators.smoother import Smoother
from fieldloc import pose as se2
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

LEADS_S = 0.2
STATED = np.diag([0.02, 0.02, 0.05]) ** 2


def recorded(commands: FloatArray, late_s: float, stated: FloatArray | None = None) -> Recorded:
    """Nodes each 0.07 s, odometry each 0.1 s that is late."""
    held = HeldVelocity(GENTLE, late_s)
    stamps_ns = [ns(0.07 * k) for k in range(int(len(commands) / 0.7) - 3)]
    motions: list[Increment] = []
    given = 0
    for stamp_ns in stamps_ns:
        while given < len(commands) and ns(0.1 * given) <= stamp_ns:
            motion = held.advance(ns(0.1 * given))
            if motion is not None:
                motions.append(motion)
            held.hold(Odometry(ns(0.1 * given), commands[given], stated))
            given += 1
        motion = held.advance(stamp_ns)
        if motion is not None:
            motions.append(motion)
    stamps = sorted({*stamps_ns, *(ns(0.1 * k) for k in range(given))})
    return Recorded(tuple(stamps), tuple(motions), (), ())


@pytest.mark.parametrize("late_s", [0.2, 0.13, 0.051])
def test_late_motions_are_those_of_an_odometry_that_was_held_later(late_s: float) -> None:
    commands = velocities(60)
    moved, held = later(recorded(commands, 0.0), late_s), recorded(commands, late_s)
    assert moved.stamps_ns == held.stamps_ns
    for k, (one, other) in enumerate(zip(moved.motions, held.motions, strict=True)):
        if moved.stamps_ns[k] < ns(late_s):
            continue  # before the first message nothing is known
        np.testing.assert_allclose(one.before_from_after, other.before_from_after, atol=1e-9)
        # of 0.07 s, turning by up to 0.18 rad
        np.testing.assert_allclose(one.by_calibration, other.by_calibration, atol=5e-3)
        # white noise is carried to the end of a part as if all of it came there
        np.testing.assert_allclose(one.covariance, other.covariance, rtol=0.1, atol=2e-6)
        np.testing.assert_allclose(one.parts.sum(axis=0), one.covariance, atol=1e-15)


def test_no_lateness_changes_nothing() -> None:
    log = recorded(velocities(20), 0.0)
    assert later(log, 0.0) is log


def test_only_an_odometry_that_does_not_say_how_sure_it_is_may_be_late() -> None:
    commands = velocities(20)
    assert may_be_late(recorded(commands, 0.0), Config())
    assert not may_be_late(recorded(commands, 0.0, STATED), Config())
    known = replace(Config(), calibration=Calibration(odometry_delay_sigma_s=0.0))
    assert not may_be_late(recorded(commands, 0.0), known)


def test_what_is_known_of_the_sum_is_split_by_what_was_known_of_each() -> None:
    config = replace(
        Config(), sensor=Sensor(delay_sigma_s=0.03, delay_s=0.02), calibration=Calibration(odometry_delay_sigma_s=0.04)
    )
    assert against_odometry(config).sensor.delay_sigma_s == pytest.approx(0.05)
    lateness = split(0.12, config)
    assert lateness.late_s == pytest.approx(0.1 * 16 / 25)
    assert lateness.sigma_s == pytest.approx(0.03 * 0.04 / 0.05)


def smoothed(config: Config, seed: int, stated: FloatArray | None = None) -> tuple[Smoother, FloatArray, FloatArray]:
    """A robot that does all that its odometry says 0.2 s later, its estimates (n, 3) and truth (n, 3)."""
    random = np.random.default_rng(seed)
    commands = velocities(240)
    truth = walk(np.zeros((1, 3)), np.concatenate([np.zeros((2, 3)), commands]), 0.1, random)[:, 0]
    smoother = Smoother(config)
    smoother.start_in(LOPSIDED, 0)
    for k, command in enumerate(commands):
        smoother.predict(Odometry(ns(0.1 * k), command, stated))
        if k % 3 == 2:
            seen = se2.retract(truth[k], 0.5 * np.array([0.1, 0.1, 0.05]) * random.standard_normal(3))
            mixture = of_poses(ns(0.1 * k), seen[None], np.array([np.log(0.95)]), np.log(0.05) - 5.0)
            smoother.observe(replace(mixture, by_sight=True))
    estimates = np.array([estimate.pose for estimate in smoother.trajectory()])
    return smoother, estimates, truth[: len(estimates)]


def test_a_robot_that_does_later_what_its_odometry_says_is_where_it_was() -> None:
    smoother, estimates, truth = smoothed(Config(), 0)
    assert smoother.solution is not None
    share = 0.15**2 / (0.05**2 + 0.15**2)
    assert smoother.solution.late_s == pytest.approx(share * LEADS_S, abs=0.02)
    # only the sum is known
    assert smoother.solution.late_s + smoother.solution.sensor.delay_s == pytest.approx(LEADS_S, abs=0.02)
    sigma_s = float(np.sqrt(smoother.solution.global_covariance[-1, -1]))
    assert sigma_s == pytest.approx(0.05 * 0.15 / np.hypot(0.05, 0.15), rel=0.1)
    known = Config(calibration=Calibration(odometry_delay_sigma_s=0.0), sensor=Sensor(delay_sigma_s=0.0))
    _, plain, _ = smoothed(known, 0)
    off, worse = (se2.wrap(poses[:, 2] - truth[:, 2]) for poses in (estimates, plain))
    assert np.sqrt(np.mean(off**2)) < 0.6 * np.sqrt(np.mean(worse**2))


def test_what_the_split_leaves_open_is_in_the_covariances() -> None:
    smoother, _, _ = smoothed(Config(), 1)
    assert smoother.solution is not None
    sure = replace(Config(), sensor=Sensor(delay_sigma_s=1e-4))
    other, _, _ = smoothed(sure, 1)
    assert other.solution is not None
    # the fastest turn of 2.5 rad/s is not known to 0.047 s
    more = np.sqrt(smoother.solution.covariances[:, 2, 2].max()), np.sqrt(other.solution.covariances[:, 2, 2].max())
    assert more[0] > 0.09 > more[1]


def test_an_odometry_that_says_how_sure_it_is_is_taken_to_be_on_time() -> None:
    smoother, _, _ = smoothed(Config(), 2, STATED)
    assert smoother.solution is not None
    assert smoother.solution.late_s == 0.0
    assert smoother.solution.sensor.delay_s > 0.1
    # each sight is right where the eyes were, half a radian from where the robot is in its fastest turns
    assert smoother.resolution is not None
    assert (smoother.resolution.choices >= 0).mean() > 0.97
