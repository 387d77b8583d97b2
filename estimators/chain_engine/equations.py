"""A chain's normal equations at a state: motions and factors from numba or from arrays, and what is small by hand."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from estimators.chain import Chain
from estimators.chain_engine.blocks import Blocks, Marginals
from estimators.chain_engine.compass import CompassOffsets
from estimators.config import Config
from estimators.linearised import Linearised
from estimators.motion import CALIBRATION, OdometryCalibration
from estimators.sensor import SensorCalibration
from estimators.solution import GLOBALS, Solution
from fieldloc.pose import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """poses (n, 3); common (GLOBALS,); offsets (n,) of the compass at each node."""

    poses: FloatArray
    common: FloatArray
    offsets: FloatArray


class Arithmetic(Protocol):
    """What takes its time for each pose."""

    def add_all(self, blocks: Blocks, poses: FloatArray, common: FloatArray, bend: float) -> float:
        """All that is in estimators.linearised, to blocks with room for all that is free or for poses alone; what is
        minimised there, the prior of what is common included.

        bend: a factor's information along its error is made smaller by that of the kernel's own bend (as Newton's
        method has it; Triggs et al. 2000, section 4.3), but never by more than this share; 0 for weights alone.
        """

    def solve(self, blocks: Blocks, damping: float) -> tuple[FloatArray, FloatArray]:
        """Steps (n, d) and of the border (p,). damping: added to the diagonal of the blocks."""

    def marginals(self, blocks: Blocks) -> Marginals: ...

    def retracted(self, poses: FloatArray, steps: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As se2.retract by the first three numbers of each step; the largest size of each of them (3,)."""


class Equations:
    def __init__(self, chain: Chain, config: Config, arithmetic: Callable[[Linearised, float], Arithmetic]) -> None:
        self._cauchy = config.graph.cauchy
        self.linearised = linearised = Linearised(chain, config)
        self.free, self.means = linearised.free, linearised.means
        # what is not free has a column too, in which nothing is: a border of one size
        self._weights = np.where(self.free, linearised.sigmas, 1.0) ** -2.0
        self._compass = CompassOffsets.of(linearised, config.compass)
        self._arithmetic = arithmetic(linearised, config.graph.cauchy)

    def at(self, state: State, whole: bool, bend: float) -> tuple[Blocks, float]:
        """And what is minimised. whole: for all that is free; else for the poses alone, as if the rest were zero."""
        blocks = Blocks.zeros(len(state.poses), 4 if whole and self._compass.free else 3, GLOBALS if whole else 0)
        cost = self._arithmetic.add_all(blocks, state.poses, state.common, bend)
        cost += self._compass.add_to(blocks, state.poses, state.offsets, self._cauchy, bend)
        if whole:
            towards = (self.means - state.common) * self._weights
            blocks.corner[:-1, :-1] += np.diag(self._weights)
            blocks.corner[:-1, -1] += towards
            blocks.corner[-1, :-1] += towards
        return blocks, cost

    def step(self, blocks: Blocks, damping: float, state: State) -> tuple[State, FloatArray]:
        """The state that the blocks lead to, and how far (3,) the poses that move most do so on the way."""
        return self._moved(state, *self._arithmetic.solve(blocks, damping))

    def last(self, blocks: Blocks, state: State, longest: FloatArray) -> tuple[Solution, State, FloatArray]:
        """As `step`, with the answer there, whose covariances are those that the blocks hold. A step that is longer is
        none to end with, and is not taken."""
        marginals = self._arithmetic.marginals(blocks)
        after, moved = self._moved(state, marginals.steps, marginals.border_step)
        after = after if (moved < longest).all() else state
        covariance = np.zeros((GLOBALS, GLOBALS))
        covariance[np.ix_(self.free, self.free)] = marginals.border[np.ix_(self.free, self.free)]
        variances, following = marginals.covariances[:, -1, -1], marginals.following[:, -1, -1]
        compass_rad, compass_variance, left_out = self._compass.at_knots(after.offsets, variances, following)
        solution = Solution(
            after.poses,
            np.ascontiguousarray(marginals.covariances[:, :3, :3]),
            OdometryCalibration(*after.common[:CALIBRATION].tolist()),
            SensorCalibration(*after.common[CALIBRATION:].tolist()),
            covariance,
            compass_rad,
            compass_variance,
            marginals.log_determinant + left_out,
        )
        return solution, after, moved

    def marginals(self, blocks: Blocks) -> Marginals:
        return self._arithmetic.marginals(blocks)

    def start(self, near: Solution) -> FloatArray:
        """(n,) the compass' offset at each node by an earlier solution."""
        return self._compass.at_nodes(near.compass_rad)

    def _moved(self, state: State, steps: FloatArray, border: FloatArray) -> tuple[State, FloatArray]:
        common = state.common + border if len(border) else state.common
        offsets = state.offsets + steps[:, 3] if steps.shape[1] == 4 else state.offsets
        poses, moved = self._arithmetic.retracted(state.poses, steps)
        return State(poses, common, offsets), moved
