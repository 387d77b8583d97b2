"""An observation that shows much the same as the last one, for who saw that and for who did not.

A robot at a place it is thought to be has taken in the last image: this one is a part of an image's news to it, all
densities to the power of 1 / wider. One that is at none of these places has taken in none, or it would have been
found. It may be anywhere, so what this image says for it is

    p(image | anywhere) = integral of p(image | pose) over poses / volume of all poses

Of that the power is to be taken as a whole. The integral of the densities' powers says nothing instead: a flat density
is a flat one wherever it is right. Where the robot is, if it is there, the image says in full.
"""

from dataclasses import dataclass, replace
from functools import cached_property

from fieldloc.factors import Factor
from fieldloc.mixture import Expansion, MixtureFactor, PoseSolutions
from fieldloc.pose import FloatArray


@dataclass(frozen=True)
class RepeatedMixture:
    """again: the observation with its densities to the power of 1 / wider. once: as it would be if it were the first,
    with the same ids. log_volume: of all poses, m^2 rad."""

    again: MixtureFactor
    once: MixtureFactor
    wider: float
    log_volume: float

    @property
    def stamp_ns(self) -> int:
        return self.again.stamp_ns

    @property
    def symmetric(self) -> bool:
        return self.again.symmetric

    @property
    def by_compass(self) -> bool:
        return self.again.by_compass

    @property
    def by_sight(self) -> bool:
        return self.again.by_sight

    @property
    def log_outlier(self) -> float:
        return self.again.log_outlier

    @property
    def log_integral(self) -> float:
        return self.log_volume + (self.once.log_integral - self.log_volume) / self.wider

    @cached_property
    def _solutions(self) -> PoseSolutions:
        found = self.once.solutions()
        if not len(found.ids):
            return found
        return replace(found, log_weights=found.log_weights + (self.log_integral - self.once.log_integral))

    def solutions(self) -> PoseSolutions:
        return self._solutions

    def expand(self, poses: FloatArray, covariances: FloatArray) -> Expansion:
        return self.again.expand(poses, covariances)

    def log_likelihood(self, poses: FloatArray) -> FloatArray:
        return self.again.log_likelihood(poses)

    def chosen(self, solution: int) -> tuple[Factor, ...]:
        return self.again.chosen(solution)
