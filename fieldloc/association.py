"""Which landmark of the map is the one without a label, when it is known roughly where the robot is."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from fieldloc import pose as se2
from fieldloc.covariance import squared_mahalanobis
from fieldloc.factors import LandmarkFactor
from fieldloc.field import FieldMap
from fieldloc.measurements import LandmarkScan
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray

_GATE = 13.82  # chi-square, 2 degrees of freedom: a right one fails once in a thousand


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Where the robot is thought to be: pose (3,), covariance (3, 3) of it in the robot frame."""

    pose: FloatArray
    covariance: FloatArray


def seen_in_robot(scan: LandmarkScan) -> tuple[FloatArray, FloatArray]:
    """Where a scan's landmarks were seen, robot frame (n, 2), and the covariance of each (n, 2, 2), first order."""
    ranges, bearings = scan.range_bearing[:, 0], scan.range_bearing[:, 1]
    axes = se2.rotation(bearings + scan.robot_from_sensor[2])  # columns: along the line of sight, across it
    in_sensor = np.stack([ranges * np.cos(bearings), ranges * np.sin(bearings)], axis=-1)
    jacobian = axes * np.stack([np.ones_like(ranges), ranges], axis=-1)[:, None, :]
    return se2.apply(scan.robot_from_sensor, in_sensor), jacobian @ scan.covariance @ np.swapaxes(jacobian, -1, -2)


def landmark_factors(
    scan: LandmarkScan, field: FieldMap, rows: IntArray, indices: IntArray, covariance: FloatArray
) -> tuple[LandmarkFactor, ...]:
    """Rows of the scan as landmarks of those indices on the map, by covariances (k, 2, 2) of range and bearing."""
    seen, spread = seen_in_robot(replace(scan, range_bearing=scan.range_bearing[rows], covariance=covariance))
    # the map's error turns with the unknown heading: its largest in all directions
    survey = np.linalg.eigvalsh(field.positions_covariance[indices])[:, -1]
    return tuple(
        LandmarkFactor(scan.stamp_ns, field.positions[index], seen[k], spread[k] + survey[k] * np.eye(2))
        for k, index in enumerate(indices)
    )


def associate(scan: LandmarkScan, field: FieldMap, belief: Belief, taken: frozenset[int]) -> dict[int, int]:
    """Map index by row of the scan, for its rows without a label: the likeliest one-to-one assignment within the gate.

    taken: map indices that labels have already claimed.
    """
    rows = [row for row, label in enumerate(scan.labels) if label is None]
    columns = [index for index in range(len(field.landmarks)) if index not in taken]
    if not rows or not columns:
        return {}
    seen, covariance = seen_in_robot(scan)
    expected = se2.apply(se2.inverse(belief.pose), field.positions[columns])
    error = expected - seen[rows, None, :]
    jacobian = np.zeros((len(columns), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = -1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = expected[:, 1], -expected[:, 0]
    survey = se2.rotation(-belief.pose[2]) @ field.positions_covariance[columns] @ se2.rotation(belief.pose[2])
    spread = jacobian @ belief.covariance @ np.swapaxes(jacobian, -1, -2) + survey
    total = spread + covariance[rows, None]
    distance = squared_mahalanobis(error, total)
    # a wide innovation explains everything a little: its density is what counts, not its distance alone
    cost = distance + np.log(np.linalg.det(total))
    cost[distance > _GATE] = np.inf
    missed = cost.min(initial=0.0, where=np.isfinite(cost)) + 1e3  # any landmark within the gate beats none
    chosen = linear_sum_assignment(
        np.hstack([np.where(np.isfinite(cost), cost, 1e9), np.full((len(rows),) * 2, missed)])
    )
    return {rows[r]: columns[c] for r, c in zip(*chosen, strict=True) if c < len(columns)}
