"""The chain engine's arithmetic in machine code, for whom numba is installed."""

import numpy as np

from estimators.chain_engine import fused, sweep
from estimators.chain_engine.blocks import Blocks, Marginals
from estimators.linearised import Group, Linearised
from estimators.motion import CALIBRATION
from fieldloc.pose import FloatArray
from fieldloc.stacks import HeadingStack, LandmarkStack, LineStack, PoseStack

_NONE = np.zeros(0, dtype=np.intp)


class InNumba:
    def __init__(self, linearised: Linearised, cauchy: float) -> None:
        self._linearised, self._square2 = linearised, cauchy**2
        odometry, sensor = np.split(linearised.free.astype(np.float64), [CALIBRATION])
        self._free = sensor
        self._motions = fused.Motions(
            linearised.moved,
            _informations(linearised.motion_roots),
            linearised.by_calibration * odometry[None, None],
            linearised.durations_s,
        )
        groups = linearised.groups
        tables = [_table(group) for group in groups]
        keys = np.concatenate([_NONE, *(2 * group.nodes + group.sighted for group in groups)])
        order = np.argsort(keys, kind="stable")
        kinds = (np.full(len(values), kind) for kind, values in tables)
        informations = (_informations(group.whiteners) for group in groups)
        self._factors = fused.Factors(
            np.searchsorted(keys[order], np.arange(2 * linearised.count + 1)),
            np.concatenate([_NONE, *kinds])[order],
            np.concatenate([np.zeros((0, 5)), *(values for _, values in tables)])[order],
            np.concatenate([np.zeros((0, 6)), *informations])[order],
        )

    def add_all(self, blocks: Blocks, poses: FloatArray, common: FloatArray, bend: float) -> float:
        one = self._linearised
        calibration, sensor = np.split(common, [CALIBRATION])
        cost = fused.add_all(
            poses,
            self._motions,
            one.by_calibration @ calibration,
            self._factors,
            sensor,
            self._free,
            self._square2,
            bend,
            blocks.columns,
            blocks.diagonal,
            blocks.following,
            blocks.border,
            blocks.corner,
        )
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


def _table(group: Group) -> tuple[int, FloatArray]:
    """Kind and values (k, 5) as `fused` knows them."""
    match group.stack:
        case PoseStack():
            heading = group.stack.poses[:, 0, 2:]
            kind, columns = fused.POSE, [group.stack.poses[:, 0], np.cos(heading), np.sin(heading)]
        case LandmarkStack():
            kind, columns = fused.LANDMARK, [group.stack.landmarks[:, 0], group.stack.seen[:, 0]]
        case HeadingStack():
            kind, columns = fused.HEADING, [group.stack.heading_rad]
        case LineStack():
            normal = group.stack.normal_rad
            kind = fused.LINE
            columns = [group.stack.heading_rad, group.stack.offset_m, np.cos(normal), np.sin(normal)]
        case other:
            raise TypeError(f"no way to solve for a {type(other).__name__}")
    values = np.zeros((len(group.nodes), 5))
    filled = np.concatenate(columns, axis=1)
    values[:, : filled.shape[1]] = filled
    return kind, values


def _informations(whiteners: FloatArray) -> FloatArray:
    """(k, 6) lower triangles, row by row, of transpose(whitener) @ whitener, whiteners (k, m, m); zeros beyond."""
    out = np.zeros((len(whiteners), 6))
    whole = np.swapaxes(whiteners, 1, 2) @ whiteners
    for column, (i, j) in enumerate(zip(*np.tril_indices(whiteners.shape[1]), strict=True)):
        out[:, column] = whole[:, i, j]
    return out
