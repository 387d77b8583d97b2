"""An observation that shows much the same as the last one, for who saw that and for who did not.

A robot at a place it is thought to be has taken in the last image: this one is a part of an image's news to it, its
likelihood to the power of 1 / wider. Its likelihood is all of it,

    p(image | pose)^(1 / wider) = (sum over solutions + outlier)^(1 / wider)

and not the sum of the powers: of that, ten solutions that hardly fit would make three times the evidence of one that
fits, and who is where nothing is right would lose as much to each image as to an image in full. A solution has the
share of it that it has of the whole, where it leads to.

A robot that is at none of these places has taken in no image, or it would have been found. It may be anywhere, so what
this one says for it is

    p(image | anywhere) = integral of p(image | pose) over poses / volume of all poses

Of that the power is to be taken as a whole. The integral of the densities' powers says nothing instead: a flat density
is a flat one wherever it is right. Where the robot is, if it is there, the image says in full.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fieldloc import pose as se2
from fieldloc.factors import Factor
from fieldloc.mixture import Expansion, MixtureFactor, PoseSolutions
from fieldloc.pose import FloatArray


@dataclass(frozen=True)
class RepeatedMixture:
    """again: the observation with each of its densities to the power of 1 / wider. once: as it would be if it were the
    first, with the same ids. log_volume: of all poses, m^2 rad."""

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
        """With the outlier, whose share is the one where nothing is right, it is the power of the whole."""
        outlier, solutions = self.once.log_outlier, self.once.log_integral - self.log_volume
        whole = np.logaddexp(outlier, solutions)
        share = -math.expm1((outlier - whole) / self.wider)
        return float(self.log_volume + whole / self.wider + (math.log(share) if share > 0.0 else -math.inf))

    @cached_property
    def _solutions(self) -> PoseSolutions:
        found = self.once.solutions()
        if not len(found.ids):
            return found
        return replace(found, log_weights=found.log_weights + (self.log_integral - self.once.log_integral))

    def solutions(self) -> PoseSolutions:
        return self._solutions

    def expand(self, poses: FloatArray, covariances: FloatArray) -> Expansion:
        near, rest = self.again.expand(poses, covariances), 1.0 - 1.0 / self.wider
        blind = self.log_outlier + rest * (self.once.log_outlier - self.once.log_likelihood(poses))
        if not len(near.ids):
            return replace(near, blind=blind)
        step = near.step
        powered = near.constant + np.sum(near.gradient * step, axis=1)
        powered -= 0.5 * np.einsum("ci,cij,cj->c", step, near.information, step)
        whole = self.once.log_likelihood(se2.retract(poses[near.parent], step))
        log_share = np.minimum(self.wider * powered - whole, 0.0)
        return replace(near.likelier(rest * log_share, near.ids), blind=blind)

    def log_likelihood(self, poses: FloatArray) -> FloatArray:
        return self.once.log_likelihood(poses) / self.wider

    def chosen(self, solution: int) -> tuple[Factor, ...]:
        return self.again.chosen(solution)
