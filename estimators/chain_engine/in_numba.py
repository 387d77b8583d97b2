"""The chain engine's arithmetic in machine code, for whom numba is installed."""

import numpy as np

from estimators.chain_engine import fused, sweep
from estimators.chain_engine.blocks import Blocks, Marginals
from estimators.linearised import Linearised
from fieldloc.pose import FloatArray
from fieldloc.stacks import FactorStack, HeadingStack, LandmarkStack, LineStack, PoseStack


class InNumba:
    def __init__(self, linearised: Linearised, cauchy: float) -> None:
        self._linearised, self._square2 = linearised, cauchy**2
        self._fixed = np.flatnonzero(~linearised.free)
        informations = np.zeros((len(linearised.moved), 6))
        _fill_informations(informations, linearised.motion_roots)
        self._motions = fused.Motions(linearised.moved, informations, linearised.by_calibration, linearised.durations_s)
        self._factors = _factors(linearised)

    def add_all(self, blocks: Blocks, poses: FloatArray, common: FloatArray, bend: float) -> float:
        one = self._linearised
        cost = fused.add_all(
            poses,
            self._motions,
            self._factors,
            common,
            self._square2,
            bend,
            blocks.columns,
            blocks.diagonal,
            blocks.following,
            blocks.border,
            blocks.corner,
        )
        if len(blocks.columns) and len(self._fixed):
            blocks.border[:, :, self._fixed] = 0.0
            blocks.corner[self._fixed] = blocks.corner[:, self._fixed] = 0.0
        first = one.first(poses)
        blocks.diagonal[0, :3, :3] += first.by_pose[0].T @ first.by_pose[0]
        blocks.border[0, :3, -1] += first.by_pose[0].T @ first.towards[0]
        cost += 0.5 * float(np.sum(first.towards**2))
        cost += 0.5 * float(np.sum(((common - one.means)[one.free] / one.sigmas[one.free]) ** 2))
        upper = np.triu(blocks.corner)
        blocks.corner[:] = upper + np.triu(upper, 1).T
        return cost

    def solve(self, blocks: Blocks, damping: float) -> tuple[FloatArray, FloatArray]:
        return sweep.solve(blocks, damping)

    def marginals(self, blocks: Blocks) -> Marginals:
        return sweep.marginals(blocks)

    def retracted(self, poses: FloatArray, steps: FloatArray) -> tuple[FloatArray, FloatArray]:
        return fused.retracted(poses, steps)


def _factors(linearised: Linearised) -> fused.Factors:
    groups = linearised.groups
    total = sum(len(group.nodes) for group in groups)
    keys, kinds = np.zeros(total, dtype=np.int64), np.zeros(total, dtype=np.int64)
    values, informations = np.zeros((total, 5)), np.zeros((total, 6))
    start = 0
    for group in groups:
        those = slice(start, start + len(group.nodes))
        keys[those] = 2 * group.nodes + group.sighted
        kinds[those], columns = _columns(group.stack)
        at = 0
        for column in columns:
            values[those, at : at + column.shape[1]] = column
            at += column.shape[1]
        _fill_informations(informations[those], group.whiteners)
        start = those.stop
    starts = np.zeros(2 * linearised.count + 1, dtype=np.int64)
    np.cumsum(np.bincount(keys, minlength=2 * linearised.count), out=starts[1:])
    return fused.Factors(starts, np.argsort(keys, kind="stable"), kinds, values, informations)


def _columns(stack: FactorStack) -> tuple[int, list[FloatArray]]:
    """Kind, and columns of the values (k, 5) as `fused` knows them."""
    match stack:
        case PoseStack():
            heading = stack.poses[:, 0, 2:]
            return fused.POSE, [stack.poses[:, 0], np.cos(heading), np.sin(heading)]
        case LandmarkStack():
            return fused.LANDMARK, [stack.landmarks[:, 0], stack.seen[:, 0]]
        case HeadingStack():
            return fused.HEADING, [stack.heading_rad]
        case LineStack():
            return fused.LINE, [stack.heading_rad, stack.offset_m, np.cos(stack.normal_rad), np.sin(stack.normal_rad)]
        case other:
            raise TypeError(f"no way to solve for a {type(other).__name__}")


def _fill_informations(out: FloatArray, whiteners: FloatArray) -> None:
    """(k, 6) lower triangles, row by row, of transpose(whitener) @ whitener, whiteners (k, m, m), lower ones too."""
    size = whiteners.shape[1]
    columns = np.ascontiguousarray(whiteners.T)  # numpy works along the last axis
    for at, (i, j) in enumerate(zip(*np.tril_indices(size), strict=True)):
        out[:, at] = sum(columns[i, m] * columns[j, m] for m in range(i, size))
