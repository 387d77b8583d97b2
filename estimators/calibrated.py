"""What differs between robots, from one solved log or several of the same robot."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from estimators.config import Calibration, Config, Sensor
from estimators.motion import OdometryCalibration
from estimators.sensor import SensorCalibration
from estimators.solution import Solution, global_means, global_sigmas
from fieldloc.pose import FloatArray

TOLD_NOTHING = 0.9  # of the prior's sigma: more than this is left where a log says nothing of a quantity
_NEXT_TIME = 0.1  # of the prior's sigma: a robot is not quite the same the next day
_ODOMETRY = len(OdometryCalibration._fields)
_DELAY = _ODOMETRY + SensorCalibration._fields.index("delay_s")
_UNITS = {"_rad": "rad", "_rad_per_m": "rad/m", "_mps": "m/s", "_radps": "rad/s", "_s": "s", "_m": "m"}

_NAMES = (*OdometryCalibration._fields, *SensorCalibration._fields)

Section = TypeVar("Section", Calibration, Sensor)


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

    @property
    def unit(self) -> str:
        return next((unit for end, unit in sorted(_UNITS.items(), key=_longest) if self.name.endswith(end)), "-")


@dataclass(frozen=True, slots=True, eq=False)
class RobotCalibration:
    """quantities: in the order of estimators.solution. late: how late the robot does what its odometry says.
    covariance: (8, 8) of the former.

    disagreement: chi-square per degree of freedom of several logs about their common estimate, 1 where they agree as
    well as they claim to; where it is more, all sigmas are wider by its root. NaN for one log.
    """

    quantities: tuple[Quantity, ...]
    late: Quantity
    covariance: FloatArray
    disagreement: float

    def settings(self, config: Config) -> Config:
        """The settings with what is known now, each quantity a little less surely than it was estimated."""
        values = [quantity.value for quantity in self.quantities]
        sigmas = [float(np.hypot(q.sigma, _NEXT_TIME * q.prior_sigma)) for q in self.quantities]
        calibration = _known(config.calibration, values[:_ODOMETRY], sigmas[:_ODOMETRY])
        late = self.late
        return replace(
            config,
            calibration=replace(calibration, odometry_delay_s=late.value, odometry_delay_sigma_s=late.sigma),
            sensor=_known(config.sensor, values[_ODOMETRY:], sigmas[_ODOMETRY:]),
        )


def calibrated(solutions: Sequence[Solution], config: Config) -> RobotCalibration:
    """All that these solutions, of logs of one robot under `config`, say together.

    What the prior says counts once. ValueError for no solutions.
    """
    if not solutions:
        raise ValueError("no solution to calibrate from")
    prior_mean, prior_sigma = global_means(config), global_sigmas(config)
    free = prior_sigma > 0.0
    said = [_likelihood(solution, prior_mean, prior_sigma, free) for solution in solutions]
    information = np.diag(1.0 / prior_sigma[free] ** 2) + sum(one for one, _ in said)
    covariance = np.linalg.inv(information)
    mean = covariance @ (prior_mean[free] / prior_sigma[free] ** 2 + sum(weighted for _, weighted in said))
    apart = sum(
        float((weighted - one @ mean) @ np.linalg.pinv(one, hermitian=True) @ (weighted - one @ mean))
        for one, weighted in said
    )
    freedom = (len(solutions) - 1) * int(free.sum())
    disagreement = apart / freedom if freedom else float("nan")
    whole = np.zeros((len(free), len(free)))
    whole[np.ix_(free, free)] = covariance * max(1.0, np.nan_to_num(disagreement))
    values = prior_mean.copy()
    values[free] = mean
    sigmas = np.minimum(np.sqrt(np.diagonal(whole)), prior_sigma)
    quantities = []
    for k, name in enumerate(_NAMES):
        told = bool(free[k] and sigmas[k] < TOLD_NOTHING * prior_sigma[k])
        gain = 0.0
        if free[k]:
            gain = 0.5 * (values[k] - prior_mean[k]) ** 2 * (1.0 / sigmas[k] ** 2 + 1.0 / prior_sigma[k] ** 2)
        value, sigma = (values[k], sigmas[k]) if told else (prior_mean[k], prior_sigma[k])
        section = "calibration" if k < _ODOMETRY else "sensor"
        quantities.append(Quantity(section, name, float(value), float(sigma), float(prior_sigma[k]), float(gain), told))
    return RobotCalibration(tuple(quantities), _late(solutions, quantities[_DELAY], config), whole, disagreement)


def _likelihood(
    solution: Solution, prior_mean: FloatArray, prior_sigma: FloatArray, free: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Information matrix and vector of what is free, without the prior's."""
    mean = np.array([*solution.calibration, *solution.sensor])[free]
    posterior = np.linalg.inv(solution.global_covariance[np.ix_(free, free)])
    prior = np.diag(1.0 / prior_sigma[free] ** 2)
    values, vectors = np.linalg.eigh(posterior - prior)  # rounding must not make it say less than nothing
    information = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return information, posterior @ mean - prior @ prior_mean[free]


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


def _known(section: Section, values: Sequence[float], sigmas: Sequence[float]) -> Section:
    """The sigmas come first in a section, then the values."""
    return type(section)(*sigmas, *values)


def _longest(item: tuple[str, str]) -> int:
    return -len(item[0])
