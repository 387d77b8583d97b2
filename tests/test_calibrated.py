"""What several logs of one robot say together, and as settings."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimators.calibrated import Quantity, RobotCalibration, calibrated
from estimators.config import Calibration, Config, Sensor
from estimators.config_file import load_config
from estimators.motion import CALIBRATION, OdometryCalibration
from estimators.sensor import SensorCalibration
from estimators.solution import Solution, global_means, global_sigmas
from fieldloc.pose import FloatArray
from logs.calibrating import CalibratedRobot, calibration_table, write_settings

CONFIG = Config()
SIZE = len(global_sigmas(CONFIG))
MOUNT = tuple(
    Quantity("mount", name, value, 0.002, 0.02, 3.0, True)
    for name, value in (("height_m", -0.01), ("tilt_rad", 0.02), ("roll_rad", 0.01), ("log_focal", 0.015))
)
SCANS = tuple(
    Quantity("scan_distortion", name, value, 0.02, 0.05, 2.0, True)
    for name, value in (("log_scale", 0.03), ("depth", 0.9), ("askew", -0.01), ("bearing_scale", 0.01))
)

NOISE = tuple(
    Quantity("motion", name, value, 0.1 * value, 0.5 * value, 3.0, True)
    for name, value in (
        ("forward_m_per_sqrt_m", 0.06),
        ("sideways_m_per_sqrt_m", 0.04),
        ("turn_rad_per_sqrt_rad", 0.09),
        ("turn_rad_per_sqrt_m", 0.03),
    )
)


def solution(values: FloatArray, covariance: FloatArray) -> Solution:
    none = np.zeros((0, 3)), np.zeros((0, 3, 3))
    parts = OdometryCalibration(*values[:CALIBRATION].tolist()), SensorCalibration(*values[CALIBRATION:].tolist())
    return Solution(*none, *parts, covariance, np.zeros(0), np.zeros(0), 0.0)


def posterior(true: FloatArray, rng: np.random.Generator, rows: int, config: Config = CONFIG) -> Solution:
    """Of a log of so many linear measurements of unit noise of all the numbers, under the settings' prior."""
    sigmas = global_sigmas(config)
    seen = rng.normal(size=(rows, SIZE)) / sigmas
    heard = seen @ true + rng.normal(size=rows)
    covariance = np.linalg.inv(np.diag(1.0 / sigmas**2) + seen.T @ seen)
    return solution(covariance @ (seen.T @ heard), covariance)


def by_name(robot: RobotCalibration) -> dict[str, tuple[float, float, bool]]:
    return {one.name: (one.value, one.sigma, one.told) for one in robot.quantities}


def test_two_logs_say_what_one_of_both_would() -> None:
    rng = np.random.default_rng(1)
    sigmas = global_sigmas(CONFIG)
    true = rng.normal(size=SIZE) * sigmas
    seen = rng.normal(size=(60, SIZE)) / sigmas
    heard = seen @ true + rng.normal(size=60)
    parts = []
    for rows in (slice(0, 25), slice(25, 60)):
        covariance = np.linalg.inv(np.diag(1.0 / sigmas**2) + seen[rows].T @ seen[rows])
        parts.append(solution(covariance @ (seen[rows].T @ heard[rows]), covariance))
    robot = calibrated(parts, CONFIG)
    covariance = np.linalg.inv(np.diag(1.0 / sigmas**2) + seen.T @ seen)
    found = np.array([one.value for one in robot.quantities])
    np.testing.assert_allclose(found, covariance @ (seen.T @ heard), rtol=1e-9)
    np.testing.assert_allclose(robot.covariance, covariance * max(1.0, robot.disagreement), rtol=1e-6, atol=1e-12)


def test_logs_that_agree_as_well_as_they_claim_have_no_disagreement() -> None:
    rng = np.random.default_rng(2)
    true = rng.normal(size=SIZE) * global_sigmas(CONFIG)
    values = [calibrated([posterior(true, rng, 40) for _ in range(5)], CONFIG).disagreement for _ in range(40)]
    # chi-square per degree of freedom of 40 times 40: its mean is 1 within three times sqrt(2 / 1600)
    assert abs(np.mean(values) - 1.0) < 3.0 * np.sqrt(2.0 / 1600)


def test_logs_that_contradict_each_other_say_less() -> None:
    rng = np.random.default_rng(3)
    sigmas = global_sigmas(CONFIG)
    one, other = posterior(sigmas, rng, 60), posterior(-sigmas, rng, 60)
    together = calibrated([one, other], CONFIG)
    assert together.disagreement > 3.0
    agreed = calibrated([one, one], CONFIG)
    assert all(a.sigma > 1.5 * b.sigma for a, b in zip(together.quantities, agreed.quantities, strict=True) if a.told)


def test_what_a_log_says_nothing_of_stays_as_it_was() -> None:
    sigmas = global_sigmas(CONFIG)
    covariance = np.diag(sigmas**2)
    covariance[0, 0] = 0.01**2
    values = np.zeros(SIZE)
    values[0], values[-1] = 0.05, 0.01
    found = by_name(calibrated([solution(values, covariance)], CONFIG))
    assert found["scale"] == (pytest.approx(0.05), pytest.approx(0.01), True)
    assert found["delay_s"] == (0.0, CONFIG.sensor.delay_sigma_s, False)


def test_what_is_taken_as_known_is_not_touched() -> None:
    config = replace(CONFIG, sensor=Sensor(0.0, 0.0, 0.0, 0.0, bearing_offset_rad=0.02))
    covariance = np.diag(np.append(0.5 * config.calibration.sigmas(), [0.0] * 4) ** 2)
    found = by_name(calibrated([solution(np.zeros(SIZE), covariance)], config))
    assert found["bearing_offset_rad"] == (0.02, 0.0, False)


def test_a_log_is_solved_about_what_was_known_of_the_odometry() -> None:
    config = replace(CONFIG, calibration=Calibration(scale=0.1))
    covariance = np.diag((0.1 * global_sigmas(config)) ** 2)
    values = global_means(config)
    assert values[0] == 0.1
    values[0] = 0.07
    twice = by_name(calibrated(2 * [solution(values, covariance)], config))["scale"][0]
    # each log says 0.0697, the prior of 0.1 is a hundredth of what one says, and counts once
    assert by_name(calibrated([solution(values, covariance)], config))["scale"][0] == pytest.approx(0.07)
    assert twice == pytest.approx((2 * 99 * (0.07 - 0.001) / 0.99 + 0.1) / 199, abs=1e-4)


def test_a_late_robot_and_late_eyes_are_told_together() -> None:
    covariance = np.diag((0.5 * global_sigmas(CONFIG)) ** 2)
    late = calibrated([replace(solution(np.zeros(SIZE), covariance), late_s=0.2)], CONFIG)
    assert (late.late.value, late.late.told) == (0.2, True)
    known = late.settings(CONFIG)
    assert known.calibration.odometry_delay_s == 0.2
    assert known.calibration.odometry_delay_sigma_s < CONFIG.calibration.odometry_delay_sigma_s
    punctual = calibrated([solution(np.zeros(SIZE), covariance)], CONFIG)
    assert punctual.settings(CONFIG).calibration.odometry_delay_sigma_s == CONFIG.calibration.odometry_delay_sigma_s


def test_nothing_says_nothing() -> None:
    with pytest.raises(ValueError, match="no solution"):
        calibrated([], CONFIG)


def test_settings_come_back_from_their_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    true = rng.normal(size=SIZE) * global_sigmas(CONFIG)
    robot = calibrated([posterior(true, rng, 50)], CONFIG)
    done = CalibratedRobot(("a", "b"), robot, NOISE, SCANS, MOUNT, (0.004, 0.01, 0.01, 0.0), ())
    path = tmp_path / "robot.toml"
    write_settings(path, done, CONFIG)
    assert load_config(path) == done.settings(CONFIG)
    table = calibration_table(done).splitlines()
    assert len(table) == 2 + SIZE + len(NOISE) + len(SCANS) + len(MOUNT)
    assert table[0].split() == ["quantity", "value", "sigma", "sigma", "before", "unit", "log-likelihood"]
