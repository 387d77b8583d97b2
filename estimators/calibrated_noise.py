"""How noisy a robot's odometry is, from one run log or several of the same robot (`estimators.legs`)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.calibrated import NEXT_TIME, TOLD_NOTHING, Quantity
from estimators.config import MotionNoise
from estimators.legs import Legs
from estimators.motion import PARTS, SAID

_OF_PART = (
    ("forward_m_per_sqrt_m", 0),
    ("sideways_m_per_sqrt_m", 0),
    ("turn_rad_per_sqrt_rad", 1),
    ("turn_rad_per_sqrt_m", 2),
)


def calibrated_noise(runs: Sequence[Legs], before: MotionNoise) -> tuple[Quantity, ...]:
    """What these runs with the noise `before` say together: standard deviations after a unit of motion. None where the
    noise is taken as known or the odometry states it."""
    prior = before.log_scale_sigma
    if prior == 0.0:
        return ()
    before_any = np.eye(PARTS) / prior**2
    learned = [legs.learned for legs in runs]
    information = before_any + sum(known - before_any for _, known in learned)
    logs = np.linalg.solve(information, sum(known @ log for log, known in learned))[:SAID]
    sigmas = np.sqrt(np.diagonal(np.linalg.inv(information)))[:SAID]
    if not (sigmas < TOLD_NOTHING * prior).any():
        return ()
    return tuple(_quantity(name, before, float(logs[part]), float(sigmas[part])) for name, part in _OF_PART)


def known_noise(before: MotionNoise, quantities: Sequence[Quantity]) -> MotionNoise:
    """With what `calibrated_noise` found. All variances are as sure as the one that is known worst."""
    prior = before.log_scale_sigma
    worst = max((2.0 * one.sigma / one.value for one in quantities if one.value > 0.0), default=prior)
    sigma = min(float(np.hypot(worst, NEXT_TIME * prior)), prior)
    return replace(before, **{one.name: one.value for one in quantities}, log_scale_sigma=sigma)


def _quantity(name: str, before: MotionNoise, log: float, sigma: float) -> Quantity:
    """Half the logarithm of a variance is that of the standard deviation."""
    was, prior = float(getattr(before, name)), before.log_scale_sigma
    found = Quantity.found("motion", name, 0.0, log, sigma, prior)
    value = was * float(np.exp(0.5 * found.value))
    return replace(found, value=value, sigma=0.5 * found.sigma * value, prior_sigma=0.5 * prior * was)
