"""A compass reading as a mixture: the heading plus the compass' slowly varying offset, and disturbances.

Beside steel and motors a compass points anywhere, so with r the residual and s its standard deviation

    p(reading | heading) = (1 - disturbed) N(r; 0, s^2) + disturbed / 2 pi

A disturbance lasts: the readings of its ten seconds are one mistake, not a hundred. So each reading counts as the
`wider`-th part of one, p^(1 / wider), which again is nearly a floor and a bump of normal shape upon it:

    floor (1 + height exp(-r^2 / 2 width^2)),   1 + height = (1 + a)^(1 / wider),   a: bump over floor of one reading

with the width at which the curvature in the middle is that of p^(1 / wider). It is this that is used; for one reading
that is all news it is p itself. The floor bounds what a reading can do, to the side that the robot is thought to be on
as well as to its heading.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fieldloc import pose as se2
from fieldloc.factors import HeadingFactor
from fieldloc.measurements import Compass
from fieldloc.mixture import Expansion, MixtureFactor, PoseSolutions
from fieldloc.pose import FloatArray

_DISTURBED = 0.1  # of readings, how many have nothing to do with the heading


@dataclass(frozen=True)
class HeadingMixture:
    """One solution, id 0, at every pose: what there is of disturbances is in it, so nothing is left for the outlier.

    wider: of how many readings that know as much as one this is one. area_m2: where the robot can be.
    """

    stamp_ns: int
    heading_rad: float
    sigma_rad: float
    wider: float
    area_m2: float
    symmetric = False
    by_compass = True
    by_sight = False
    log_outlier = -math.inf

    def __post_init__(self) -> None:
        if not (0.0 < self.sigma_rad < math.inf and 1.0 <= self.wider < math.inf):
            raise ValueError(f"a compass needs a sigma above 0, got {self.sigma_rad}; and wider from 1, {self.wider}")

    @cached_property
    def _floor_height_width2(self) -> tuple[float, float, float]:
        """Log of the floor, the bump's height over it as a multiple of it, the bump's variance (rad^2)."""
        over = (1.0 - _DISTURBED) / (math.sqrt(math.tau) * self.sigma_rad) / (_DISTURBED / math.tau)
        height = math.expm1(math.log1p(over) / self.wider)
        width2 = self.wider * self.sigma_rad**2 * ((1.0 + over) / over) * (height / (1.0 + height))
        return math.log(_DISTURBED / math.tau) / self.wider, height, width2

    @property
    def log_integral(self) -> float:
        """What is taken to that power is what one reading says on the average of all headings."""
        return math.log(math.tau * self.area_m2) - math.log(math.tau) / self.wider

    def solutions(self) -> PoseSolutions:
        return PoseSolutions.none()

    def expand(self, poses: FloatArray, covariances: FloatArray) -> Expansion:
        """One quadratic a pose: with it the evidence is that of floor and bump, and mean and variance of the heading
        are those of what bump and floor make of it together, weighed by how likely each is (Gaussian sum, merged at
        once). A reading never makes the heading less certain here, though one at odds with it should."""
        log_floor, height, width2 = self._floor_height_width2
        residual, variance = self._residual(poses), covariances[:, 2, 2]
        expected = variance + width2
        bump = height * np.sqrt(width2 / expected) * np.exp(-0.5 * residual**2 / expected)
        share = bump / (1.0 + bump)
        gain = share / expected
        # of the shrinking of the variance, what is left when the two that are merged lie apart
        left = gain * np.maximum(1.0 - (1.0 - share) * residual**2 / expected, 0.0)
        shrunk = 1.0 - variance * left
        gradient = np.zeros((len(poses), 3))
        gradient[:, 2] = -gain * residual / shrunk
        information = np.zeros((len(poses), 3, 3))
        information[:, 2, 2] = left / shrunk
        # by which the quadratic's own evidence comes to be that of floor and bump
        constant = log_floor + np.log1p(bump) - 0.5 * variance * shrunk * gradient[:, 2] ** 2 - 0.5 * np.log(shrunk)
        each = np.arange(len(poses))
        return Expansion(each, np.zeros_like(each), constant, gradient, information, covariances)

    def log_likelihood(self, poses: FloatArray) -> FloatArray:
        log_floor, height, width2 = self._floor_height_width2
        return np.asarray(log_floor + np.log1p(height * np.exp(-0.5 * self._residual(poses) ** 2 / width2)))

    def chosen(self, solution: int) -> tuple[HeadingFactor, ...]:
        if solution != 0:
            raise IndexError(f"no solution {solution}")
        variance = np.array([[self.wider * self.sigma_rad**2]])
        return (HeadingFactor(self.stamp_ns, self.heading_rad, variance, by_compass=True, wider=self.wider),)

    def _residual(self, poses: FloatArray) -> FloatArray:
        """(...) of poses (..., 3)."""
        return np.asarray(se2.wrap(poses[..., 2] - self.heading_rad))


def heading_mixture(compass: Compass, wider: float, area_m2: float = 1.0) -> MixtureFactor:
    """wider: by how much its variance is to be widened for being much the same as the last one's. area_m2: where the
    robot can be. ValueError where its standard deviation is none."""
    return HeadingMixture(compass.stamp_ns, compass.heading_rad, compass.sigma_rad, wider, area_m2)
