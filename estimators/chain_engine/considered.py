"""How a chain's solution would change with numbers that some of its factors know and that are not solved for."""

from dataclasses import replace

import numpy as np

from estimators.chain import Chain
from estimators.chain_engine import arithmetic, cyclic
from estimators.chain_engine.blocks import Blocks
from estimators.chain_engine.equations import Equations, State
from estimators.config import Config
from estimators.solution import GLOBALS, Solution
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_A_LITTLE = 1e-3  # of a change, whose slope is asked for


class Considered:
    """About a solution of the chain."""

    def __init__(self, chain: Chain, config: Config, solution: Solution) -> None:
        equations = Equations(chain, config, arithmetic())
        common = np.array([*solution.calibration, *solution.sensor])
        self._marginals = equations.marginals
        self._blocks, _ = equations.at(State(solution.poses, common, equations.start(solution)), True, 0.0)
        turned, by_common = equations.linearised.sights(common)
        self._eyes = se2.adjoint(se2.inverse(se2.exp(turned)))
        self._by_common = se2.right_jacobian(turned) @ by_common
        self._by_common[..., ~equations.free] = 0.0

    def changes(self, nodes: IntArray, which: IntArray, pulls: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
        """Of the poses (n, 3, c * count), robot frame, and of what is the same over the chain (GLOBALS, c * count).

        pulls: (k, 3, c) by how much the gradient at the pose that was seen from at that node (k,) changes with the c
        numbers of which (k,) of count things.
        """
        blocks, c = self._blocks, pulls.shape[2]
        edge = np.zeros((len(blocks.border), count, 3, c))
        np.add.at(edge, (nodes, which), self._eyes[nodes].swapaxes(1, 2) @ pulls)
        by_common = np.zeros((count, GLOBALS, c))
        np.add.at(by_common, which, self._by_common[nodes].swapaxes(1, 2) @ pulls)
        given = count * c
        border = np.zeros((*blocks.border.shape[:2], GLOBALS + given + 1))
        border[..., :GLOBALS] = blocks.border[..., :-1]
        border[:, :3, GLOBALS:-1] = edge.transpose(0, 2, 1, 3).reshape(-1, 3, given)
        corner = np.zeros((GLOBALS + given + 1,) * 2)
        corner[:GLOBALS, :GLOBALS] = blocks.corner[:-1, :-1]
        corner[:GLOBALS, GLOBALS:-1] = by_common.transpose(1, 0, 2).reshape(GLOBALS, given)
        by_block, by_border = cyclic.changes(Blocks(blocks.diagonal, blocks.following, border, corner), given)
        return by_block[:, :3], by_border

    def due_to(self, nodes: IntArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What of the covariances of poses (n, 3, 3) and of what is the same over the chain (GLOBALS, GLOBALS) comes of
        noise that is new each time.

        noise: (k, 3, 3) what it makes of the gradient's covariance at the pose that was seen from at that node (k,). It
        is in H, the information: what comes of it, inverse(H) @ N @ inverse(H), is how the inverse changes with N.
        """
        eyes, by_common, blocks = self._eyes[nodes], self._by_common[nodes], self._blocks
        more = replace(
            blocks, diagonal=blocks.diagonal.copy(), border=blocks.border.copy(), corner=blocks.corner.copy()
        )
        noise = _A_LITTLE * noise
        np.add.at(more.diagonal[:, :3, :3], nodes, eyes.swapaxes(1, 2) @ noise @ eyes)
        np.add.at(more.border[:, :3, :-1], nodes, eyes.swapaxes(1, 2) @ noise @ by_common)
        more.corner[:-1, :-1] += np.sum(by_common.swapaxes(1, 2) @ noise @ by_common, axis=0)
        before, after = self._marginals(blocks), self._marginals(more)
        poses = before.covariances[:, :3, :3] - after.covariances[:, :3, :3]
        return poses / _A_LITTLE, (before.border - after.border) / _A_LITTLE
