"""What several runs say of one robot's odometry noise, as settings."""

from dataclasses import dataclass

import numpy as np
import pytest

from estimators.calibrated import Quantity
from estimators.calibrated_noise import calibrated_noise, known_noise
from estimators.config import Config, MotionNoise
from estimators.config_file import with_settings
from estimators.legs import Legs
from estimators.motion import PARTS, SAID
from fieldloc.pose import FloatArray

BEFORE = MotionNoise(log_scale_sigma=0.8)
PRIOR = np.eye(PARTS) / 0.8**2


@dataclass
class Learned(Legs):
    """Legs that have learned these logarithms of variances from data of that information."""

    logs: FloatArray
    data: FloatArray

    @property
    def learned(self) -> tuple[FloatArray, FloatArray]:
        data, logs = np.zeros(PARTS), np.zeros(PARTS)
        data[:SAID], logs[:SAID] = self.data, self.logs
        information = PRIOR + np.diag(data)
        return np.linalg.solve(information, data * logs), information


def by_name(found: tuple[Quantity, ...]) -> dict[str, Quantity]:
    return {one.name: one for one in found}


def test_two_runs_say_what_one_of_both_would() -> None:
    logs, data = np.array([1.0, -0.6, 0.3]), np.array([40.0, 20.0, 30.0])
    twice = calibrated_noise([Learned(logs, data), Learned(logs, data)], BEFORE)
    once = calibrated_noise([Learned(logs, 2.0 * data)], BEFORE)
    for one, other in zip(once, twice, strict=True):
        assert other.value == pytest.approx(one.value)
        assert other.sigma == pytest.approx(one.sigma)
    # much data: the standard deviation is that of the variance's logarithm, halved, and sideways goes as forward does
    found = by_name(calibrated_noise([Learned(logs, 1e6 * data)], BEFORE))
    assert found["forward_m_per_sqrt_m"].value == pytest.approx(BEFORE.forward_m_per_sqrt_m * np.exp(0.5), rel=1e-4)
    assert found["sideways_m_per_sqrt_m"].value == pytest.approx(BEFORE.sideways_m_per_sqrt_m * np.exp(0.5), rel=1e-4)
    assert found["turn_rad_per_sqrt_rad"].value == pytest.approx(BEFORE.turn_rad_per_sqrt_rad * np.exp(-0.3), rel=1e-4)
    assert found["turn_rad_per_sqrt_m"].value == pytest.approx(BEFORE.turn_rad_per_sqrt_m * np.exp(0.15), rel=1e-4)


def test_a_robot_that_never_turns_says_nothing_of_the_noise_of_its_turns() -> None:
    found = calibrated_noise([Learned(np.array([0.5, 0.0, 0.2]), np.array([50.0, 0.0, 40.0]))], BEFORE)
    turns = by_name(found)["turn_rad_per_sqrt_rad"]
    assert not turns.told
    assert turns.value == BEFORE.turn_rad_per_sqrt_rad
    assert known_noise(BEFORE, found).log_scale_sigma == BEFORE.log_scale_sigma  # what is open stays open


def test_noise_that_is_known_or_stated_is_no_quantity() -> None:
    assert calibrated_noise([Legs(MotionNoise(log_scale_sigma=0.0))], MotionNoise(log_scale_sigma=0.0)) == ()
    assert calibrated_noise([Legs(BEFORE)], BEFORE) == ()  # no leg of an odometry that does not state it


def test_what_is_found_is_the_settings_of_the_next_run() -> None:
    found = calibrated_noise([Learned(np.array([1.0, -0.6, 0.3]), np.array([80.0, 60.0, 70.0]))], BEFORE)
    known = known_noise(BEFORE, found)
    assert 0.1 < known.log_scale_sigma < 0.3
    settings = [f"motion.{one.name}={one.value!r}" for one in found]
    again = with_settings(Config(), [*settings, f"motion.log_scale_sigma={known.log_scale_sigma!r}"])
    assert again.motion == known


def test_noise_that_is_set_to_none_stays_none() -> None:
    before = MotionNoise(sideways_m_per_sqrt_m=0.0, log_scale_sigma=0.8)
    found = calibrated_noise([Learned(np.array([1.0, -0.6, 0.3]), np.array([80.0, 60.0, 70.0]))], before)
    known = known_noise(before, found)
    assert known.sideways_m_per_sqrt_m == 0.0
    assert 0.1 < known.log_scale_sigma < 0.3
