"""Mixtures as seen from another copy of the field under the map's symmetries."""

from dataclasses import dataclass, replace

import numpy as np

from fieldloc import pose as se2
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.mixture import Expansion, MixtureFactor, PoseSolutions
from fieldloc.pose import FloatArray


@dataclass(frozen=True, slots=True)
class Moved:
    """A mixture of a field that was moved by a pose (3,); its solutions keep their ids."""

    still: MixtureFactor
    by: FloatArray

    @property
    def stamp_ns(self) -> int:
        return self.still.stamp_ns

    @property
    def symmetric(self) -> bool:
        return self.still.symmetric

    @property
    def by_compass(self) -> bool:
        return self.still.by_compass

    @property
    def by_sight(self) -> bool:
        return self.still.by_sight

    @property
    def log_outlier(self) -> float:
        return self.still.log_outlier

    @property
    def log_integral(self) -> float:
        return self.still.log_integral

    def solutions(self) -> PoseSolutions:
        found = self.still.solutions()
        return PoseSolutions(se2.compose(self.by, found.poses), found.covariances, found.log_weights, found.ids)

    def expand(self, poses: FloatArray, covariances: FloatArray) -> Expansion:
        return self.still.expand(self._back(poses), covariances)  # tangents are the robot's, wherever the field is

    def log_likelihood(self, poses: FloatArray) -> FloatArray:
        return self.still.log_likelihood(self._back(poses))

    def chosen(self, solution: int) -> tuple[Factor, ...]:
        return tuple(moved(factor, self.by) for factor in self.still.chosen(solution))

    def _back(self, poses: FloatArray) -> FloatArray:
        return se2.compose(se2.inverse(self.by), poses)


def moved(factor: Factor, by: FloatArray) -> Factor:
    """The same factor on a field that was moved by a pose (3,)."""
    match factor:
        case PoseFactor():
            return replace(factor, pose=se2.compose(by, factor.pose))
        case LandmarkFactor():
            return replace(factor, landmark=se2.apply(by, factor.landmark))
        case HeadingFactor():
            heading_rad = float(se2.wrap(factor.heading_rad + by[2]))
            return replace(factor, heading_rad=heading_rad)
        case LineFactor():
            normal_rad = factor.normal_rad + by[2]
            offset_m = factor.offset_m + np.cos(normal_rad) * by[0] + np.sin(normal_rad) * by[1]
            heading_rad = float(se2.wrap(factor.heading_rad + by[2]))
            return replace(factor, heading_rad=heading_rad, normal_rad=float(normal_rad), offset_m=float(offset_m))
        case _:
            raise TypeError(f"no way to move a {type(factor).__name__}")
