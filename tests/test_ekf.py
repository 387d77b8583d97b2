from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from walks import PLAIN, TAKEN_AT_ITS_WORD, feed, nees, ns, right_factors, scan, velocities, walk

from estimators.base import Estimate
from estimators.config import Calibration, Compass, Config, MotionNoise, Robust
from estimators.ekf import Ekf
from estimators.motion import CALIBRATION, OdometryCalibration
from fieldloc import pose as se2
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.measurements import Odometry

P3 = np.array([[0.04, 0.01, 0.002], [0.01, 0.02, -0.003], [0.002, -0.003, 0.01]])
SURE_OF_HEADING = 1e-14


def test_without_turns_it_is_the_textbook_kalman_filter() -> None:
    heading = 0.7
    motion = MotionNoise(0.05, 0.03, 0.0, 0.0, 0.001, 0.0, log_scale_sigma=0.0)
    ekf = Ekf(Config(motion, Robust(nis_per_dof=1e9), calibration=TAKEN_AT_ITS_WORD))
    random = np.random.default_rng(0)
    start_covariance = np.diag([0.3**2, 0.1**2, SURE_OF_HEADING])
    ekf.start(Estimate(0, np.array([1.0, 2.0, heading]), start_covariance))
    turn = se2.rotation(heading)
    fix_covariance = np.array([[0.02, 0.005], [0.005, 0.01]])

    x, p = np.array([1.0, 2.0]), start_covariance[:2, :2]
    for k in range(60):
        forward, left = random.uniform(-1, 1, 2)
        z = x + random.normal(0, 0.2, 2)
        # the textbook, in field axes
        x = x + turn @ [0.1 * forward, 0.1 * left]
        along = 0.05**2 * abs(forward) + 0.03**2 * abs(left) + 0.001**2
        across = 0.05**2 * abs(left) + 0.03**2 * abs(forward) + 0.001**2
        p = p + turn @ np.diag([0.1 * along, 0.1 * across]) @ turn.T
        gain = p @ np.linalg.inv(p + fix_covariance)
        x = x + gain @ (z - x)
        p = (np.eye(2) - gain) @ p
        # and ours
        ekf.predict(Odometry(ns(0.1 * k), np.array([forward, left, 0.0])))
        fix = np.zeros((3, 3))
        fix[:2, :2], fix[2, 2] = turn.T @ fix_covariance @ turn, 0.1
        ekf.update(PoseFactor(ns(0.1 * (k + 1)), np.array([*z, heading]), fix))
    estimate = ekf.estimate()
    assert estimate is not None
    np.testing.assert_allclose(estimate.pose[:2], x, atol=1e-9)
    np.testing.assert_allclose(estimate.covariance[:2, :2], p, atol=1e-12)


@pytest.mark.parametrize("kind", ["landmark", "line", "pose"])
def test_an_update_adds_the_factors_information(kind: str) -> None:
    pose = np.array([1.0, 2.0, 2.5])
    seen = se2.apply(se2.inverse(pose), np.array([3.0, 3.0]))
    noise = np.array([[0.03, 0.01], [0.01, 0.02]])
    exact: dict[str, Factor] = {  # no residual, so nothing but the information counts
        "landmark": LandmarkFactor(0, np.array([3.0, 3.0]), seen, noise),
        "line": LineFactor(0, 2.5, 0.4, float(np.cos(0.4) + 2 * np.sin(0.4)), noise),
        "pose": PoseFactor(0, pose, P3[::-1, ::-1]),
    }
    factor = exact[kind]
    ekf = Ekf(Config())
    ekf.update(PoseFactor(0, pose, P3))
    ekf.update(factor)
    estimate = ekf.estimate()
    assert estimate is not None
    jacobian = factor.jacobian(pose)
    information = np.linalg.inv(P3) + jacobian.T @ np.linalg.inv(factor.covariance) @ jacobian
    robot = se2.rotate_covariance(estimate.covariance, -pose[2])
    np.testing.assert_allclose(robot, np.linalg.inv(information), atol=1e-12)
    np.testing.assert_allclose(estimate.pose, pose, atol=1e-12)


def test_who_knew_nothing_takes_over_a_whole_pose_with_its_covariance() -> None:
    ekf = Ekf(Config())
    ekf.update(PoseFactor(0, np.zeros(3), np.diag([1e3, 1e3, 1e3])))
    seen = np.array([0.3, -0.2, 0.25])
    ekf.update(PoseFactor(0, seen, P3))
    estimate = ekf.estimate()
    assert estimate is not None
    np.testing.assert_allclose(estimate.pose, seen, atol=1e-3)
    # first order: what is left is of the turn's second order, 0.25**2 / 6 = 1 %
    scale = np.sqrt(np.diag(P3))
    robot = se2.rotate_covariance(estimate.covariance, -seen[2]) / np.outer(scale, scale)
    np.testing.assert_allclose(robot, P3 / np.outer(scale, scale), atol=0.03)


def test_a_factor_that_disagrees_is_widened_until_it_is_at_the_limit() -> None:
    config = Config(robust=Robust(nis_per_dof=4.0, restart_after=99))
    ekf = Ekf(config)
    ekf.update(PoseFactor(0, np.zeros(3), np.diag([0.1, 0.1, 0.1]) ** 2))
    innovation = ekf.update(PoseFactor(0, np.array([1.0, 0.0, 0.0]), np.diag([0.1, 0.1, 0.1]) ** 2))
    assert innovation is not None
    assert innovation.nis == pytest.approx(50.0)  # 1 m^2 in 0.02 m^2
    assert innovation.weight == pytest.approx(12.0 / 50.0)
    estimate = ekf.estimate()
    assert estimate is not None
    # the gain of a variance of 0.01 * 50 / 12 beside one of 0.01
    assert estimate.pose[0] == pytest.approx(1.0 / (1.0 + 50.0 / 12.0))
    assert estimate.covariance[0, 0] == pytest.approx(0.01 * (50.0 / 12.0) / (1.0 + 50.0 / 12.0))


@pytest.mark.parametrize(
    "calibration", [TAKEN_AT_ITS_WORD, Calibration(odometry_delay_sigma_s=0.0)], ids=["plain", "calibrated"]
)
@pytest.mark.parametrize("at_s", [pytest.param(10.0, marks=pytest.mark.slow), 5.5])
def test_the_errors_of_many_walks_are_as_large_as_the_filter_says(at_s: float, calibration: Calibration) -> None:
    walks, steps = 80, round(10 * at_s)
    random = np.random.default_rng(7)
    start_sigma = np.array([0.2, 0.1, 0.1])
    first = np.array([0.5, -0.5, 1.0])
    starts = se2.retract(first, start_sigma * random.standard_normal((walks, 3)))
    commands = velocities(steps)
    real = random.normal(0.0, calibration.sigmas(), (walks, CALIBRATION))
    truth = walk(starts, commands, 0.1, random, calibration=OdometryCalibration(*real.T))
    total = 0.0
    for i in range(walks):
        ekf = Ekf(replace(PLAIN, calibration=calibration))
        ekf.start(Estimate(0, first, se2.rotate_covariance(np.diag(start_sigma**2), first[2])))
        for k, command in enumerate(commands):
            ekf.predict(Odometry(ns(0.1 * k), command))
            if k % 8 == 5:
                feed(ekf, right_factors(scan(ns(0.1 * k), truth[k, i], random), truth[k, i]))
        ekf.advance(ns(0.1 * steps))
        estimate = ekf.estimate()
        assert estimate is not None
        total += nees(estimate, truth[-1, i])
    # one time per walk, so the walks are independent: chi-square, 3 * 80 degrees of freedom, 99.9 % two-sided
    assert chi2.ppf(0.0005, 3 * walks) < total < chi2.ppf(0.9995, 3 * walks)


def compass(stamp_s: float, heading_rad: float, sigma_rad: float = 0.1, wider: float = 1.0) -> HeadingFactor:
    return HeadingFactor(ns(stamp_s), heading_rad, np.array([[wider * sigma_rad**2]]), by_compass=True, wider=wider)


def heading_of(ekf: Ekf) -> tuple[float, float]:
    """Heading and its standard deviation."""
    estimate = ekf.estimate()
    assert estimate is not None
    return float(estimate.pose[2]), float(np.sqrt(estimate.covariance[2, 2]))


def test_what_a_compass_says_is_shared_by_heading_and_offset() -> None:
    ekf = Ekf(Config(compass=Compass(offset_sigma_rad=0.2)))
    ekf.update(PoseFactor(0, np.zeros(3), np.diag([0.1, 0.1, 0.1]) ** 2))
    innovation = ekf.update(compass(0, 0.12))
    assert innovation is not None
    assert innovation.covariance[0, 0] == pytest.approx(0.1**2 + 0.2**2 + 0.1**2)
    heading, sigma = heading_of(ekf)
    assert heading == pytest.approx(0.12 * 0.01 / 0.06)
    assert sigma**2 == pytest.approx(0.01 - 0.01**2 / 0.06)
    # four parts of six went to the offset, one is the reading's noise: at heading 0 it now expects that
    again = ekf.update(compass(0, 0.12 * 5.0 / 6.0))
    assert again is not None
    assert again.residual[0] == pytest.approx(0.0, abs=1e-12)


def test_a_heading_that_is_no_compass_has_no_offset() -> None:
    ekf = Ekf(Config())
    ekf.update(PoseFactor(0, np.zeros(3), np.diag([0.1, 0.1, 0.1]) ** 2))
    ekf.update(HeadingFactor(0, 0.12, np.array([[0.01]])))
    assert heading_of(ekf) == pytest.approx((0.06, 0.1 / np.sqrt(2.0)))


def test_an_offset_is_forgotten_when_the_compass_was_silent_for_long() -> None:
    """And not by a start: the iron stays on the robot."""
    sure, config = np.diag([0.01, 0.01, 1e-4]) ** 2, Config(compass=Compass(0.2, 20.0))
    ekf = Ekf(config)
    ekf.start(Estimate(0, np.zeros(3), sure))
    for _ in range(100):
        ekf.update(compass(0, 0.3, 0.01))
    residuals = []
    for at_s in (0.0, 20.0, 1000.0):
        ekf.start(Estimate(ns(at_s), np.zeros(3), sure))
        innovation = ekf.update(compass(at_s, 0.0, 1e3))
        assert innovation is not None
        residuals.append(float(innovation.residual[0]))
    assert residuals == pytest.approx([0.3, 0.3 / np.e, 0.0], abs=0.001)


def test_forty_degrees_of_disturbance_for_ten_seconds_hardly_bend_the_track() -> None:
    """A compass of 15 deg at 10 Hz whose errors are alike over two seconds; a fix a second, good to 2 deg."""
    sigma, wider = np.radians(15.0), 40.0
    ekf, random = Ekf(Config()), np.random.default_rng(4)
    ekf.start(Estimate(0, np.zeros(3), np.diag([0.1, 0.1, 0.1]) ** 2))
    worst = 0.0
    for k in range(400):
        at_s = 0.1 * (k + 1)
        ekf.predict(Odometry(ns(at_s - 0.1), np.array([0.3, 0.0, 0.0])))
        off = np.radians(40.0) if 15.0 < at_s <= 25.0 else 0.0
        ekf.update(compass(at_s, off + float(random.normal(0.0, sigma)), sigma, wider))
        if k % 10 == 9:
            ekf.update(PoseFactor(ns(at_s), np.array([0.3 * at_s, 0.0, 0.0]), np.diag([0.1, 0.1, 0.035]) ** 2))
        if at_s > 15.0:
            worst = max(worst, abs(heading_of(ekf)[0]))
    assert worst < np.radians(1.0)


def test_a_reading_that_repeats_the_last_one_is_judged_as_if_it_did_not() -> None:
    weights = []
    for wider in (1.0, 40.0):
        ekf = Ekf(Config())
        ekf.start(Estimate(0, np.zeros(3), np.diag([0.1, 0.1, 0.1]) ** 2))
        innovation = ekf.update(compass(0, 2.0, 0.26, wider))
        assert innovation is not None
        weights.append(innovation.weight)
    assert weights[0] < 0.2
    assert weights[1] == pytest.approx(weights[0])


def test_with_a_wandering_compass_the_errors_are_as_large_as_the_filter_says() -> None:
    walks, steps, sigma = 80, 100, 0.1
    config = replace(PLAIN, compass=Compass(0.3, 5.0), robust=Robust(nis_per_dof=1e9))
    random = np.random.default_rng(8)
    first, start_sigma = np.array([0.5, -0.5, 1.0]), np.array([0.05, 0.05, 0.3])
    truth = walk(se2.retract(first, start_sigma * random.standard_normal((walks, 3))), velocities(steps), 0.1, random)
    left = np.exp(-0.1 / 5.0)
    total = 0.0
    for i in range(walks):
        ekf, offset = Ekf(config), random.normal(0.0, 0.3)
        ekf.start(Estimate(0, first, se2.rotate_covariance(np.diag(start_sigma**2), first[2])))
        for k, command in enumerate(velocities(steps)):
            ekf.predict(Odometry(ns(0.1 * k), command))
            if k:
                offset = left * offset + random.normal(0.0, 0.3 * np.sqrt(1.0 - left**2))
            ekf.update(compass(0.1 * k, float(truth[k, i, 2] + offset + random.normal(0.0, sigma)), sigma))
        ekf.advance(ns(0.1 * steps))
        _, spread = heading_of(ekf)
        error = se2.wrap(heading_of(ekf)[0] - truth[-1, i, 2])
        total += float(error / spread) ** 2
    assert chi2.ppf(0.0005, walks) < total < chi2.ppf(0.9995, walks)
