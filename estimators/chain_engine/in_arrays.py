"""The chain engine's arithmetic in numpy alone: some ten times slower than in numba, and the same to rounding."""

import numpy as np

from estimators.chain_engine import cyclic
from estimators.chain_engine.blocks import Blocks, Marginals
from estimators.linearised import Linearised
from fieldloc import pose as se2
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray


class InArrays:
    def __init__(self, linearised: Linearised, cauchy: float) -> None:
        self._linearised, self._cauchy = linearised, cauchy

    def add_all(self, blocks: Blocks, poses: FloatArray, common: FloatArray, bend: float) -> float:
        p = len(blocks.corner) - 1
        rows = self._linearised.motions(poses, common)
        border = self._border(rows.by_globals, rows.towards, p)
        before, after = np.swapaxes(rows.before, 1, 2), np.swapaxes(rows.after, 1, 2)
        blocks.diagonal[:-1, :3, :3] += before @ rows.before
        blocks.diagonal[1:, :3, :3] += after @ rows.after
        blocks.following[:, :3, :3] += before @ rows.after
        blocks.border[:-1, :3] += before @ border
        blocks.border[1:, :3] += after @ border
        flat = border.reshape(-1, p + 1)
        blocks.corner[:] += flat.T @ flat
        weak, *groups = self._linearised.factors(poses, common)
        for group in (weak, *groups):
            border = self._border(group.by_globals, group.towards, p)
            by_pose = np.swapaxes(group.by_pose, 1, 2)
            _add_at(blocks.diagonal[:, :3, :3], group.nodes, by_pose @ group.by_pose)
            _add_at(blocks.border[:, :3], group.nodes, by_pose @ border)
            flat = border.reshape(-1, p + 1)
            blocks.corner[:] += flat.T @ flat
            if bend > 0.0 and group is not weak:
                square = np.maximum(np.sum(group.towards**2, axis=-1), 1e-300)
                less = np.sqrt(np.minimum(2.0 / self._cauchy**2, bend / square))[:, None, None]
                pull = less * (by_pose @ group.towards[..., None])
                across = less * (np.swapaxes(border[:, :, :p], 1, 2) @ group.towards[..., None])
                _add_at(blocks.diagonal[:, :3, :3], group.nodes, -pull @ np.swapaxes(pull, 1, 2))
                _add_at(blocks.border[:, :3, :p], group.nodes, -pull @ np.swapaxes(across, 1, 2))
                blocks.corner[:p, :p] -= across[..., 0].T @ across[..., 0]
        return self._linearised.error(poses, common)

    def _border(self, by_globals: FloatArray, towards: FloatArray, p: int) -> FloatArray:
        """(k, m, p + 1): a column for each of all globals, or for none."""
        out = np.zeros((*towards.shape, p + 1))
        if p:
            out[:, :, np.flatnonzero(self._linearised.free)] = by_globals
        out[:, :, p] = towards
        return out

    def solve(self, blocks: Blocks, damping: float) -> tuple[FloatArray, FloatArray]:
        return cyclic.solve(blocks, damping)

    def marginals(self, blocks: Blocks) -> Marginals:
        return cyclic.marginals(blocks)

    def retracted(self, poses: FloatArray, steps: FloatArray) -> tuple[FloatArray, FloatArray]:
        return se2.retract(poses, steps[:, :3]), np.abs(steps[:, :3]).max(axis=0)


def _add_at(target: FloatArray, nodes: IntArray, values: FloatArray) -> None:
    """values (k, ...) to the rows of the target that are named, some of them several times."""
    if not len(nodes):
        return
    order = np.argsort(nodes, kind="stable")
    nodes = nodes[order]
    first = np.flatnonzero(np.diff(nodes, prepend=nodes[0] - 1))
    target[nodes[first]] += np.add.reduceat(values[order], first, axis=0)
