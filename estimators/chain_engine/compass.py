"""The compass' offset in the chain: a fourth number of each node, all but equal between two knots of it.

Knots (estimators.compass_knots) are further apart than nodes, mostly. So that each node knows its neighbours only, each
has an offset of its own, and those of one knot are tied together much more tightly than any compass could tell. Where
several knots lie between two nodes, the inner ones are left out and put back afterwards.
"""

from dataclasses import dataclass

import numpy as np

from estimators.chain_engine.blocks import Blocks
from estimators.compass_knots import knot_s
from estimators.config import Compass
from estimators.linearised import Linearised
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_TIED_RAD = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class CompassOffsets:
    """free: whether there is an offset to solve for. Readings are heading + offset: nodes, heading_rad, sigma_rad (r,).

    knots: (n,) of each node. keep, variance: (n - 1,) from node to node, as Compass.wander says.
    """

    free: bool
    nodes: IntArray
    heading_rad: FloatArray
    sigma_rad: FloatArray
    knots: IntArray
    keep: FloatArray
    variance: FloatArray
    every: tuple[float, float]
    prior_sigma_rad: float

    @classmethod
    def of(cls, linearised: Linearised, config: Compass) -> "CompassOffsets":
        readings = linearised.compass
        elapsed_s = (linearised.stamps_ns - linearised.stamps_ns[0]) * 1e-9
        knots = np.round(elapsed_s / knot_s(config)).astype(np.intp)
        left = np.exp(-np.diff(knots) * knot_s(config) / config.offset_s)
        gained = config.offset_sigma_rad**2 * (1.0 - left**2)
        return cls(
            free=bool(readings) and config.offset_sigma_rad > 0.0,
            nodes=np.array([k for k, _ in readings], dtype=np.intp),
            heading_rad=np.array([f.heading_rad for _, f in readings]),
            sigma_rad=np.sqrt([f.covariance[0, 0] for _, f in readings]),
            knots=knots,
            keep=left,
            variance=np.where(np.diff(knots) == 0, _TIED_RAD**2, gained),
            every=config.wander(knot_s(config)),
            prior_sigma_rad=config.offset_sigma_rad,
        )

    def add_to(self, blocks: Blocks, poses: FloatArray, offsets: FloatArray, cauchy: float, bend: float) -> float:
        """Readings, first offset and steps between offsets, to the blocks; what is left of their errors.

        Blocks without room for an offset leave room for it in the readings' sigmas.
        """
        if not len(self.nodes):
            return 0.0
        whole = blocks.diagonal.shape[1] == 4
        sigma_rad = self.sigma_rad if whole or not self.free else np.hypot(self.sigma_rad, self.prior_sigma_rad)
        seen = poses[self.nodes, 2] + (offsets[self.nodes] if whole else 0.0)
        misfit = se2.wrap(seen - self.heading_rad) / sigma_rad
        weights = 1.0 / (1.0 + misfit**2 / cauchy**2)
        count = len(poses)
        less = np.minimum(2.0 * weights * misfit**2 / cauchy**2, bend) if bend > 0.0 else 0.0
        information = np.bincount(self.nodes, (1.0 - less) * weights / sigma_rad**2, count)
        towards = np.bincount(self.nodes, -weights * misfit / sigma_rad, count)
        numbers = (2, 3) if whole else (2,)
        for i in numbers:
            blocks.border[:, i, -1] += towards
            for j in numbers:
                blocks.diagonal[:, i, j] += information
        cost = 0.5 * cauchy**2 * float(np.sum(np.log1p(misfit**2 / cauchy**2)))
        return cost + (self._add_steps(blocks, offsets) if whole else 0.0)

    def _add_steps(self, blocks: Blocks, offsets: FloatArray) -> float:
        weight = 1.0 / self.variance
        error = offsets[1:] - self.keep * offsets[:-1]
        blocks.diagonal[:-1, 3, 3] += self.keep**2 * weight
        blocks.diagonal[1:, 3, 3] += weight
        blocks.following[:, 3, 3] -= self.keep * weight
        blocks.border[:-1, 3, -1] += self.keep * weight * error
        blocks.border[1:, 3, -1] -= weight * error
        blocks.diagonal[0, 3, 3] += self.prior_sigma_rad**-2.0
        blocks.border[0, 3, -1] -= offsets[0] * self.prior_sigma_rad**-2.0
        return 0.5 * float(np.sum(weight * error**2)) + 0.5 * float(offsets[0] / self.prior_sigma_rad) ** 2

    def at_nodes(self, compass_rad: FloatArray) -> FloatArray:
        """(n,) from a value for each knot; zero where these are not of this chain."""
        if not self.free or len(compass_rad) != self.knots[-1] + 1:
            return np.zeros(len(self.knots))
        return compass_rad[self.knots]

    def at_knots(
        self, offsets: FloatArray, variances: FloatArray, following: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Offset and variance at each knot (k,), and what the log determinant has too little, ties included.

        offsets, variances (n,): at the nodes; following (n - 1,): covariance with the next node's.
        """
        if not self.free:
            return np.zeros(0), np.zeros(0), 0.0
        mean, variance = np.zeros(self.knots[-1] + 1), np.zeros(self.knots[-1] + 1)
        mean[self.knots], variance[self.knots] = offsets, variances
        jumps = np.diff(self.knots)
        last = np.flatnonzero(jumps > 1)
        if len(last):
            # an inner knot is between two that are known: what leads to it and what leads on from it
            counts = jumps[last] - 1
            k = np.repeat(last, counts)
            step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + 1
            left, stationary = self.every[0], self.prior_sigma_rad**2
            to, on = left**step, left ** (jumps[k] - step)
            to_weight, on_weight = 1.0 / (stationary * (1.0 - to**2)), 1.0 / (stationary * (1.0 - on**2))
            alone = 1.0 / (to_weight + on**2 * on_weight)
            first, second = alone * to * to_weight, alone * on * on_weight
            at = self.knots[k] + step
            mean[at] = first * offsets[k] + second * offsets[k + 1]
            variance[at] = (
                alone + first**2 * variances[k] + 2 * first * second * following[k] + second**2 * variances[k + 1]
            )
        ties = float(np.sum(jumps == 0)) * 2.0 * np.log(_TIED_RAD)
        inner = float(np.sum(np.log(self.variance[last]) - jumps[last] * np.log(self.every[1])))
        return mean, variance, ties + inner
