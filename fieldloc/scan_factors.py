"""Where a scan's landmarks were seen, as points and as factors of those on the map."""

from dataclasses import replace

import numpy as np

from fieldloc import pose as se2
from fieldloc.factors import LandmarkFactor
from fieldloc.field import FieldMap
from fieldloc.measurements import LandmarkScan
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray


def seen_in_robot(scan: LandmarkScan) -> tuple[FloatArray, FloatArray]:
    """Where a scan's landmarks were seen, robot frame (n, 2), and the covariance of each (n, 2, 2), first order."""
    ranges, bearings = scan.range_bearing[:, 0], scan.range_bearing[:, 1]
    axes = se2.rotation(bearings + scan.robot_from_sensor[2])  # columns: along the line of sight, across it
    in_sensor = np.stack([ranges * np.cos(bearings), ranges * np.sin(bearings)], axis=-1)
    jacobian = axes * np.stack([np.ones_like(ranges), ranges], axis=-1)[:, None, :]
    return se2.apply(scan.robot_from_sensor, in_sensor), jacobian @ scan.covariance @ np.swapaxes(jacobian, -1, -2)


def landmark_factors(
    scan: LandmarkScan,
    field: FieldMap,
    rows: IntArray,
    indices: IntArray,
    covariance: FloatArray,
    survey_wider: FloatArray | float = 1.0,
) -> tuple[LandmarkFactor, ...]:
    """Rows of the scan as landmarks of those indices on the map, by covariances (k, 2, 2) of range and bearing.

    survey_wider: (k,) by how much the variances of the map's errors are widened."""
    seen, spread = seen_in_robot(replace(scan, range_bearing=scan.range_bearing[rows], covariance=covariance))
    # the map's error turns with the unknown heading: its largest in all directions
    survey = np.linalg.eigvalsh(field.positions_covariance[indices])[:, -1] * survey_wider
    return tuple(
        LandmarkFactor(scan.stamp_ns, field.positions[index], seen[k], spread[k] + survey[k] * np.eye(2), by_sight=True)
        for k, index in enumerate(indices)
    )
