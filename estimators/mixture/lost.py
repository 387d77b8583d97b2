"""The robot that is at none of the hypotheses: how likely, and where it may be found.

It has not been found since the start, then it is in the region that was told; or it was carried away unnoticed, then
it may be anywhere. An observation finds it at its solutions, in Bayes' way: each is as likely as the density of the
robot there, before, times the integral of the solution over poses.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.mixture.log_sums import either
from fieldloc import pose as se2
from fieldloc.mixture import MixtureFactor, PoseSolutions
from fieldloc.pose import FloatArray
from fieldloc.regions import Region

_OFF_THE_MAP = -12.0  # of log-density: solutions that lie beyond all boxes still are found
_NEARLY = 1.0 - 1e-12
_UNKNOWN_M = 30.0
_HEADINGS = np.linspace([0.0, 0.0, -np.pi], [0.0, 0.0, np.pi], 72, endpoint=False)
_LOG_HEADINGS = np.log(len(_HEADINGS))
UNKNOWN = Region("unknown", np.array([[-1.0, -1.0, 1.0, 1.0]]) * _UNKNOWN_M, np.array([[0.0, np.pi]]))
"""For an estimator that was never told where it is to work."""


@dataclass(frozen=True, slots=True, eq=False)
class Lost:
    """log_weights: of not found since the start in `begin`, of carried away, to `anywhere`."""

    begin: Region
    anywhere: Region
    log_weights: FloatArray

    @staticmethod
    def within(region: Region, log_weight: float) -> "Lost":
        return Lost(region, _around(region), np.array([log_weight, -np.inf]))

    def after(self, log_weights: FloatArray) -> "Lost":
        return Lost(self.begin, self.anywhere, log_weights)

    def fed(self, share: float) -> "Lost":
        """A share of all robots, but for those that were already, is carried away."""
        share = min(share, _NEARLY)
        begin, carried = self.log_weights.tolist()
        newly = math.log(share) + math.log1p(-min(math.exp(carried), _NEARLY))
        return self.after(np.array([begin + math.log1p(-share), either(carried, newly)]))

    @property
    def total(self) -> float:
        return either(*self.log_weights.tolist())

    def found(
        self, solutions: PoseSolutions, copies: FloatArray, symmetric: bool
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """(k, c) log-weights of the solutions on the copies (c, 3), and (k,) whether it was carried there.

        A solution of a symmetric observation stands for its copies too, which are in the list themselves: each gets
        its share, so that none is favoured even if the list is cut off.
        """
        if symmetric:
            at = se2.compose(copies, solutions.poses[:, None])
            share = solutions.log_weights[:, None] - np.log(len(copies))
        else:
            at, share = solutions.poses[:, None], solutions.log_weights[:, None]
        begin = self.log_weights[0] + self.begin.log_density(at)
        carried = self.log_weights[1] + np.maximum(
            self.anywhere.log_density(at), _OFF_THE_MAP - self.anywhere.log_volume
        )
        out = np.full((len(at), len(copies)), -np.inf)
        out[:, : at.shape[1]] = share + np.logaddexp(begin, carried)
        return out, np.asarray(carried.max(axis=1) > begin.max(axis=1))

    def missed(self, mixture: MixtureFactor, solutions: PoseSolutions | None) -> FloatArray:
        """(2,) log-weights of still not being found. solutions: None if the observation was not asked for them.

        What of the observation fits no whole pose finds nobody, but makes it likelier that there is somebody.
        """
        if mixture.by_compass:  # as likely as it is on the average of all headings
            return np.asarray(self.log_weights + np.logaddexp.reduce(mixture.log_likelihood(_HEADINGS)) - _LOG_HEADINGS)
        if solutions is None:
            return np.asarray(self.log_weights + mixture.log_outlier)
        rest = -np.inf
        if np.isfinite(whole := mixture.log_integral):
            placed = np.exp(min(np.logaddexp.reduce(np.append(solutions.log_weights, -np.inf)) - whole, 0.0))
            rest = whole + np.log(1.0 - placed) if placed < 1.0 - 1e-9 else -np.inf
        volumes = np.array([self.begin.log_volume, self.anywhere.log_volume])
        return np.asarray(self.log_weights + np.logaddexp(mixture.log_outlier, rest - volumes))


def _around(region: Region) -> Region:
    """The region with all its copies and what is between them, with any heading."""
    corners = region.boxes.reshape(-1, 2)
    corners = np.concatenate([corners, *(se2.apply(by, corners) for by in region.symmetries)])
    box = np.concatenate([corners.min(axis=0), corners.max(axis=0)])[None]
    return Region("anywhere", box, np.array([[0.0, np.pi]]), region.symmetries)
