"""What differs between robots, from one solved log or several of the same robot."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from estimators.config import Calibration, Config, Sensor
from estimators.fused import fused
from estimators.motion import OdometryCalibration
from estimators.sensor import SensorCalibration
from estimators.solution import Solution, global_means, global_sigmas
from fieldloc.pose import FloatArray
from fieldloc.scan_distortion import DistortionPrior

TOLD_NOTHING = 0.9  # of the prior's sigma: more than this is left where a log says nothing of a quantity
NEXT_TIME = 0.1  # of the prior's sigma: a robot is not quite the same the next day
_ODOMETRY = len(OdometryCalibration._fields)
_DELAY = _ODOMETRY + SensorCalibration._fields.index("delay_s")
_PLACE = slice(_ODOMETRY, _ODOMETRY + 2)
_UNITS = {
    "_m_per_sqrt_m": "m/sqrt(m)",
    "_rad_per_sqrt_rad": "rad/sqrt(rad)",
    "_rad_per_sqrt_m": "rad/sqrt(m)",
    "_rad_per_m": "rad/m",
    "_radps": "rad/s",
    "_mps": "m/s",
    "_rad": "rad",
    "_s": "s",
    "_m": "m",
}

_NAMES = (*OdometryCalibration._fields, *SensorCalibration._fields)

Section = TypeVar("Section", Calibration, Sensor, DistortionPrior)


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number of a robot. name: as in the settings, with its section.

    log_gain: by how much freeing it improves the logs' log-likelihood, the others free. told: whether the logs say
    anything of it; else value and sigma are those of before.
    """

    section: str
    name: str
    value: float
    sigma: float
    prior_sigma: float
    log_gain: float
    told: bool

    @staticmethod
    def found(section: str, name: str, before: float, value: float, sigma: float, prior_sigma: float) -> "Quantity":
        """What was estimated of it, under a prior about `before`."""
        if not 0.0 < sigma < TOLD_NOTHING * prior_sigma:
            return Quantity(section, name, before, prior_sigma, prior_sigma, 0.0, told=False)
        gain = 0.5 * (value - before) ** 2 * (1.0 / sigma**2 + 1.0 / prior_sigma**2)
        return Quantity(section, name, value, sigma, prior_sigma, gain, told=True)

    @property
    def next_sigma(self) -> float:
        """How well it is known of the robot on another day."""
        return float(np.hypot(self.sigma, NEXT_TIME * self.prior_sigma))

    @property
    def unit(self) -> str:
        return next((unit for end, unit in _UNITS.items() if self.name.endswith(end)), "-")

    @property
    def plain_name(self) -> str:
        """Without its unit, for people."""
        end = next((end for end in _UNITS if self.name.endswith(end)), "")
        return self.name.removesuffix(end).replace("_", " ")


@dataclass(frozen=True, slots=True, eq=False)
class RobotCalibration:
    """quantities: in the order of estimators.solution. late: how late the robot does what its odometry says.
    covariance: (GLOBALS, GLOBALS) of the former.

    disagreement: of several logs, as in estimators.fused.
    """

    quantities: tuple[Quantity, ...]
    late: Quantity
    covariance: FloatArray
    disagreement: float

    def settings(self, config: Config) -> Config:
        """The settings with what is known now, each quantity a little less surely than it was estimated."""
        values = [quantity.value for quantity in self.quantities]
        sigmas = [quantity.next_sigma for quantity in self.quantities]
        calibration = known_section(config.calibration, values[:_ODOMETRY], sigmas[:_ODOMETRY])
        late = self.late
        return replace(
            config,
            calibration=replace(calibration, odometry_delay_s=late.value, odometry_delay_sigma_s=late.sigma),
            sensor=known_section(config.sensor, values[_ODOMETRY:], sigmas[_ODOMETRY:]),
        )


def calibrated(
    solutions: Sequence[Solution], config: Config, place_sigmas: FloatArray | None = None
) -> RobotCalibration:
    """All that these solutions, of logs of one robot under `config`, say together.

    What the prior says counts once. place_sigmas: (2,) metres that are open of the eyes' place beside that. ValueError
    for no solutions.
    """
    if not solutions:
        raise ValueError("no solution to calibrate from")
    prior_mean, prior_sigma = global_means(config), global_sigmas(config)
    free = prior_sigma > 0.0
    said = [
        (np.array([*one.calibration, *one.sensor])[free], one.global_covariance[np.ix_(free, free)])
        for one in solutions
    ]
    together = fused(prior_mean[free], np.diag(prior_sigma[free] ** 2), said)
    whole = np.zeros((len(free), len(free)))
    whole[np.ix_(free, free)] = together.covariance
    values = prior_mean.copy()
    values[free] = together.mean
    sigmas = with_open_place(np.sqrt(np.diagonal(whole)), prior_sigma, place_sigmas)
    quantities = tuple(
        Quantity.found("calibration" if k < _ODOMETRY else "sensor", name, *numbers)
        for k, (name, *numbers) in enumerate(
            zip(_NAMES, *(each.tolist() for each in (prior_mean, values, sigmas, prior_sigma)), strict=True)
        )
    )
    return RobotCalibration(quantities, _late(solutions, quantities[_DELAY], config), whole, together.disagreement)


def with_open_place(sigmas: FloatArray, prior_sigmas: FloatArray, place_sigmas: FloatArray | None) -> FloatArray:
    """(n,) in the order of estimators.solution, wider by what is open (2,) of the eyes' place, up to the prior's."""
    out = sigmas.copy()
    if place_sigmas is not None:
        out[_PLACE] = np.hypot(out[_PLACE], place_sigmas)
    return np.minimum(out, prior_sigmas)


def _late(solutions: Sequence[Solution], eyes: Quantity, config: Config) -> Quantity:
    """How late the robot is and how late its eyes are shows only as a sum: neither is known better than the other."""
    prior = config.calibration
    late_s = [solution.late_s for solution in solutions]
    told = prior.odometry_delay_sigma_s > 0.0 and any(one != prior.odometry_delay_s for one in late_s)
    value, sigma = prior.odometry_delay_s, prior.odometry_delay_sigma_s
    gain = 0.0
    if told:
        value, sigma = float(np.mean(late_s)), min(sigma, eyes.sigma)
        gain = 0.5 * (value - prior.odometry_delay_s) ** 2 / sigma**2
    return Quantity("calibration", "odometry_delay_s", value, sigma, prior.odometry_delay_sigma_s, gain, told)


def known_section(section: Section, values: Sequence[float], sigmas: Sequence[float]) -> Section:
    """The sigmas come first in a section, then the values."""
    return type(section)(*sigmas, *values)
