"""The chain engine's arithmetic in machine code, for whom numba is installed."""

import numpy as np

from estimators.chain_engine import fused, sweep
from estimators.chain_engine.blocks import Blocks, Marginals
from estimators.linearised import Group, Linearised
from estimators.motion import CALIBRATION
from estimators.sensor import LEVER_BY_VELOCITY, lever
from fieldloc.pose import FloatArray
from fieldloc.stacks import HeadingStack, LandmarkStack, LineStack, PoseStack

_NONE = np.zeros(0, dtype=np.intp)
_STILL = lever(np.zeros(3))


class InNumba:
    def __init__(self, linearised: Linearised, cauchy: float) -> None:
        self._linearised, self._cauchy = linearised, cauchy
        odometry, sensor = np.split(linearised.free, [CALIBRATION])
        self._by_common = np.ascontiguousarray(linearised.by_calibration[:, :, odometry])
        self._sensor = np.flatnonzero(sensor)
        groups = linearised.groups
        tables = [_table(group) for group in groups]
        nodes = np.concatenate([_NONE, *(group.nodes for group in groups)])
        by_sight = np.concatenate([_NONE, *(group.sighted for group in groups)])
        order = np.argsort(2 * nodes + by_sight, kind="stable")
        self._nodes, self._sighted = nodes[order], by_sight[order]
        self._kinds = np.concatenate([_NONE, *(np.full(len(values), kind) for kind, values, _ in tables)])[order]
        self._values = np.concatenate([np.zeros((0, 4)), *(values for _, values, _ in tables)])[order]
        self._roots = np.concatenate([np.zeros((0, 3, 3)), *(roots for _, _, roots in tables)])[order]

    def add_all(self, blocks: Blocks, poses: FloatArray, common: FloatArray, bend: float) -> float:
        one, whole = self._linearised, len(blocks.corner) > 1
        calibration, sensor = np.split(common, [CALIBRATION])
        miscalibrated = one.by_calibration @ calibration
        by_common, free = (self._by_common, self._sensor) if whole else (self._by_common[:, :, :0].copy(), _NONE)
        turned, by_sight = np.zeros((0, 3)), np.zeros((0, 3, 0))
        if sensor.any() or len(free):
            turned, by_sight = fused.sights(
                one.moved, miscalibrated, by_common, one.durations_s, _STILL, LEVER_BY_VELOCITY, sensor, free
            )
        cost = fused.add_motions(
            poses,
            one.moved,
            miscalibrated,
            one.motion_roots,
            by_common,
            blocks.diagonal,
            blocks.following,
            blocks.border,
            blocks.corner,
        )
        cost += fused.add_factors(
            poses,
            self._nodes,
            self._kinds,
            self._sighted,
            self._values,
            self._roots,
            turned,
            by_sight,
            self._cauchy,
            bend,
            blocks.diagonal,
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


def _table(group: Group) -> tuple[int, FloatArray, FloatArray]:
    """Kind, values (k, 4) and whiteners (k, 3, 3) as `fused` knows them."""
    count, size, _ = group.whiteners.shape
    values, roots = np.zeros((count, 4)), np.zeros((count, 3, 3))
    roots[:, :size, :size] = group.whiteners
    match group.stack:
        case PoseStack():
            kind, columns = fused.POSE, [group.stack.poses[:, 0]]
        case LandmarkStack():
            kind, columns = fused.LANDMARK, [group.stack.landmarks[:, 0], group.stack.seen[:, 0]]
        case HeadingStack():
            kind, columns = fused.HEADING, [group.stack.heading_rad]
        case LineStack():
            kind, columns = fused.LINE, [group.stack.heading_rad, group.stack.normal_rad, group.stack.offset_m]
        case other:
            raise TypeError(f"no way to solve for a {type(other).__name__}")
    filled = np.concatenate(columns, axis=1)
    values[:, : filled.shape[1]] = filled
    return kind, values, roots
