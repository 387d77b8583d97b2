from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from walks import calibrated, density, ns

from estimators.config import MotionNoise
from estimators.motion import STANDSTILL, HeldVelocity, Increment, OdometryCalibration
from fieldloc import pose as se2
from fieldloc.covariance import central_difference
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

NOISE = MotionNoise()
QUIET = MotionNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
SHARP = np.array([0.6, 0.2, 2.5])
STATED = np.array([[0.02, 0.003, 0.0], [0.003, 0.01, 0.002], [0.0, 0.002, 0.05]])

vectors = st.tuples(st.floats(-1.5, 1.5), st.floats(-1.0, 1.0), st.floats(-3.0, 3.0)).map(np.array)


def moved(velocity: FloatArray, duration_s: float, noise: MotionNoise = NOISE, parts: int = 1) -> Increment:
    motion = HeldVelocity(noise)
    motion.advance(0)
    motion.hold(Odometry(0, velocity))
    total = STANDSTILL
    for k in range(parts):
        step = motion.advance(ns(duration_s * (k + 1) / parts))
        assert step is not None
        total = total.then(step)
    return total


@settings(deadline=None, max_examples=30)
@given(commands=st.lists(vectors, min_size=1, max_size=4), start=vectors)
def test_a_held_velocity_moves_as_many_tiny_steps_would(commands: list[FloatArray], start: FloatArray) -> None:
    motion = HeldVelocity(NOISE)
    pose, euler = start, start.copy()
    motion.advance(0)
    for k, command in enumerate(commands):
        motion.hold(Odometry(ns(0.3 * k), command))
        step = motion.advance(ns(0.3 * (k + 1)))
        assert step is not None
        pose = se2.compose(pose, step.before_from_after)
        for _ in range(3000):
            # the heading of the step's middle: errors of second order, 1e-4 s each
            middle = euler[2] + 0.5e-4 * command[2]
            c, s = np.cos(middle), np.sin(middle)
            euler += 1e-4 * np.array([c * command[0] - s * command[1], s * command[0] + c * command[1], command[2]])
    np.testing.assert_allclose(pose[:2], euler[:2], atol=1e-6)
    assert abs(se2.wrap(pose[2] - euler[2])) < 1e-9


@pytest.mark.parametrize("duration_s", [0.1, 1.0])
def test_the_increments_covariance_is_the_spread_of_walks_with_white_noise(duration_s: float) -> None:
    command = SHARP if duration_s < 1.0 else np.array([0.6, 0.2, 1.2])
    random = np.random.default_rng(3)
    count, parts = 40_000, 20
    # small noise, so that first order is exact enough
    noise = MotionNoise(0.02, 0.01, 0.02, 0.02, 0.001, 0.001)
    root = np.sqrt(np.diag(density(command, noise)) * duration_s / parts)
    pose = np.zeros((count, 3))
    for _ in range(parts):
        # half of the part's noise before its motion, half after: second order in the part's length
        pose = se2.retract(pose, np.sqrt(0.5) * root * random.standard_normal((count, 3)))
        pose = se2.compose(pose, se2.exp(command * duration_s / parts))
        pose = se2.retract(pose, np.sqrt(0.5) * root * random.standard_normal((count, 3)))
    increment = moved(command, duration_s, noise)
    sampled = np.cov(se2.local(increment.before_from_after, pose).T)
    whitener = np.linalg.inv(np.linalg.cholesky(increment.covariance))
    # standard error of a sampled variance: sqrt(2 / 40000) = 0.7 %; five of these
    np.testing.assert_allclose(whitener @ sampled @ whitener.T, np.eye(3), atol=0.035)


def test_the_increments_covariance_with_stated_noise_is_the_spread_of_constant_velocity_errors() -> None:
    random = np.random.default_rng(4)
    covariance, period_s = 0.1 * STATED, 0.5
    motion = HeldVelocity(NOISE)
    motion.advance(0)
    motion.hold(Odometry(0, SHARP, covariance))
    motion.hold(Odometry(ns(period_s), SHARP, covariance))
    motion.advance(ns(period_s))
    increment = motion.advance(ns(2 * period_s))
    assert increment is not None
    sampled_velocities = random.multivariate_normal(SHARP, covariance, 40_000)
    sampled = np.cov(se2.local(increment.before_from_after, se2.exp(sampled_velocities * period_s)).T)
    whitener = np.linalg.inv(np.linalg.cholesky(increment.covariance))
    np.testing.assert_allclose(whitener @ sampled @ whitener.T, np.eye(3), atol=0.035)


@settings(deadline=None, max_examples=30)
@given(command=vectors, parts=st.integers(2, 5))
def test_motion_in_parts_is_the_motion_as_a_whole(command: FloatArray, parts: int) -> None:
    whole, pieces = moved(command, 0.2), moved(command, 0.2, parts=parts)
    np.testing.assert_allclose(whole.before_from_after, pieces.before_from_after, atol=1e-12)
    np.testing.assert_allclose(whole.by_calibration, pieces.by_calibration, atol=1e-9)
    # covariances go round with twice the turn of up to 0.6 rad, integrated to fourth order: 1.2**4 / 4320 = 5e-4
    scale = np.sqrt(np.diag(whole.covariance))
    np.testing.assert_allclose(
        whole.covariance / np.outer(scale, scale), pieces.covariance / np.outer(scale, scale), atol=5e-4
    )


def test_each_noise_of_the_configuration_counts_as_its_name_says() -> None:
    straight = replace(QUIET, forward_m_per_sqrt_m=0.05, sideways_m_per_sqrt_m=0.03, turn_rad_per_sqrt_m=0.04)
    forward = moved(np.array([0.5, 0.0, 0.0]), 2.0, straight).covariance
    # 1 m ahead: heading noise grows along the way and carries y: q l^3 / 3 and q l^2 / 2
    expected = np.diag([0.05**2, 0.03**2 + 0.04**2 / 3, 0.04**2])
    expected[1, 2] = expected[2, 1] = 0.04**2 / 2
    np.testing.assert_allclose(forward, expected, atol=1e-12)
    left = moved(np.array([0.0, 0.5, 0.0]), 2.0, straight).covariance
    np.testing.assert_allclose(np.diag(left), [0.03**2 + 0.04**2 / 3, 0.05**2, 0.04**2], atol=1e-12)
    turning = replace(QUIET, turn_rad_per_sqrt_rad=0.05)
    np.testing.assert_allclose(
        moved(np.array([0.0, 0.0, -0.5]), 2.0, turning).covariance, np.diag([0.0, 0.0, 0.05**2]), atol=1e-12
    )
    idle = replace(QUIET, idle_m_per_sqrt_s=0.01, idle_rad_per_sqrt_s=0.02)
    np.testing.assert_allclose(moved(np.zeros(3), 2.0, idle).covariance, np.diag([2e-4, 2e-4, 8e-4]), atol=1e-15)


@settings(deadline=None, max_examples=30)
@given(first=vectors, second=vectors)
def test_by_calibration_is_the_derivative_of_the_motion(first: FloatArray, second: FloatArray) -> None:
    total = moved(first, 0.4).then(moved(second, 0.3))

    def path(calibration: FloatArray) -> FloatArray:
        c = OdometryCalibration(*calibration.tolist())
        return se2.compose(se2.exp(calibrated(first, c) * 0.4), se2.exp(calibrated(second, c) * 0.3))

    numeric = central_difference(
        lambda c: se2.local(total.before_from_after, path(c)), np.zeros(len(OdometryCalibration())), 1e-5
    )
    np.testing.assert_allclose(total.by_calibration, numeric, atol=1e-8)


@settings(deadline=None, max_examples=30)
@given(first=vectors, second=vectors)
def test_a_calibrated_motion_is_that_of_calibrated_velocities(first: FloatArray, second: FloatArray) -> None:
    total = moved(first, 0.4).then(moved(second, 0.3))
    c = OdometryCalibration(0.001, -0.002, 0.002, -0.001, 0.001, -0.002, 0.002, 0.002)
    exact = se2.compose(se2.exp(calibrated(first, c) * 0.4), se2.exp(calibrated(second, c) * 0.3))
    corrected = total.calibrated(np.array(c))
    # to second order in the calibration
    np.testing.assert_allclose(se2.local(exact, corrected.before_from_after), 0.0, atol=3e-5)
    np.testing.assert_array_equal(corrected.covariance, total.covariance)


@settings(deadline=None, max_examples=30)
@given(first=vectors, second=vectors)
def test_then_carries_the_first_motions_error_to_the_end_of_the_second(first: FloatArray, second: FloatArray) -> None:
    one, two = moved(first, 0.4), moved(second, 0.3)
    total = one.then(two)

    def end(errors: FloatArray) -> FloatArray:
        middle = se2.retract(one.before_from_after, errors[:3])
        return se2.local(total.before_from_after, se2.compose(middle, se2.retract(two.before_from_after, errors[3:])))

    jacobian = central_difference(end, np.zeros(6), 1e-5)
    noise = np.zeros((6, 6))
    noise[:3, :3], noise[3:, 3:] = one.covariance, two.covariance
    np.testing.assert_allclose(total.covariance, jacobian @ noise @ jacobian.T, atol=1e-8)
    np.testing.assert_allclose(
        Increment.carry(one.covariance, two.before_from_after) + two.covariance, total.covariance, atol=1e-15
    )


def test_nothing_moves_while_no_time_passes() -> None:
    motion = HeldVelocity(NOISE)
    assert motion.advance(ns(5)) is None  # the first stamp only sets the clock
    motion.hold(Odometry(ns(5), SHARP))
    assert motion.advance(ns(5)) is None
    assert motion.advance(ns(4)) is None
    assert motion.stamp_ns == ns(5)


def test_an_odometry_message_older_than_the_last_one_is_not_used() -> None:
    motion = HeldVelocity(NOISE)
    motion.hold(Odometry(ns(5), np.array([1.0, 0.0, 0.0])))
    motion.hold(Odometry(ns(4), np.array([-7.0, 0.0, 0.0])))
    motion.advance(ns(5))
    step = motion.advance(ns(6))
    assert step is not None
    np.testing.assert_allclose(step.before_from_after, [1.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("stated", [None, STATED])
def test_an_odometry_message_that_comes_twice_counts_once(stated: FloatArray | None) -> None:
    def end(repeat: int) -> Increment:
        motion = HeldVelocity(NOISE)
        motion.advance(0)
        for k in range(3):
            motion.advance(ns(0.1 * k))
            for _ in range(repeat):
                motion.hold(Odometry(ns(0.1 * k), SHARP, stated))
        # in two parts: the stated noise is that of the whole period, whoever asks in between
        first, second = motion.advance(ns(0.25)), motion.advance(ns(0.3))
        assert first is not None
        assert second is not None
        return first.then(second)

    once, twice = end(1), end(2)
    np.testing.assert_array_equal(once.before_from_after, twice.before_from_after)
    np.testing.assert_array_equal(once.covariance, twice.covariance)
    if stated is not None:
        np.testing.assert_allclose(once.covariance[2, 2], stated[2, 2] * 0.1**2, rtol=1e-6)


def test_stated_noise_is_drawn_anew_with_each_message() -> None:
    def variance(rate_hz: float) -> float:
        motion = HeldVelocity(NOISE)
        total = STANDSTILL
        for k in range(round(rate_hz) + 1):
            if (step := motion.advance(ns(k / rate_hz))) is not None:
                total = total.then(step)
            motion.hold(Odometry(ns(k / rate_hz), np.zeros(3), STATED))
        return float(total.covariance[2, 2])

    # n messages in a second: n errors of 1/n of the way each
    assert variance(10.0) == pytest.approx(STATED[2, 2] / 10, rel=1e-6)
    assert variance(40.0) == pytest.approx(STATED[2, 2] / 40, rel=1e-6)


def test_a_velocity_is_believed_for_the_longest_hold_and_no_longer() -> None:
    noise = replace(NOISE, max_hold_s=0.5)
    silent = moved(np.array([1.0, 0.0, 0.0]), 3.0, noise)
    held = moved(np.array([1.0, 0.0, 0.0]), 0.5, noise)
    np.testing.assert_allclose(silent.before_from_after, [0.5, 0.0, 0.0], atol=1e-12)
    growth = np.diag([0.3**2, 0.3**2, 0.5**2]) * 2.5
    np.testing.assert_allclose(silent.covariance, held.covariance + growth, atol=1e-12)
    # asked for at odd times in between, it is the same
    parts = moved(np.array([1.0, 0.0, 0.0]), 3.0, noise, parts=7)
    np.testing.assert_allclose(parts.before_from_after, silent.before_from_after, atol=1e-9)
    np.testing.assert_allclose(parts.covariance, silent.covariance, atol=1e-9)


def test_without_odometry_the_robot_may_do_what_the_silent_noise_allows() -> None:
    motion = HeldVelocity(NOISE)
    motion.advance(0)
    step = motion.advance(ns(2.0))
    assert step is not None
    np.testing.assert_array_equal(step.before_from_after, np.zeros(3))
    np.testing.assert_allclose(np.diag(step.covariance), [0.18, 0.18, 0.5])
    assert not step.by_calibration.any()


def test_a_clock_that_jumps_by_a_year_keeps_the_covariance_usable() -> None:
    motion = HeldVelocity(NOISE)
    motion.hold(Odometry(0, SHARP))
    motion.advance(0)
    step = motion.advance(ns(365 * 86400.0))
    assert step is not None
    assert np.all(np.isfinite(step.covariance))
    assert step.covariance.max() < 0.5**2 * 60.0 + 1.0
