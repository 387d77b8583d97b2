"""`line_solutions` and `line_constraints` one by one, with all noise in one covariance."""

from dataclasses import dataclass

import numpy as np

from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.fixes.base import Fix
from fieldloc.fixes.line_solutions import line_constraints, line_solutions
from fieldloc.fixes.lines import GroundLines
from fieldloc.pose import FloatArray, rotate_covariance


@dataclass(frozen=True, slots=True)
class LineConstraint:
    """What lines of a single direction say: normal . position = offset_m, and the heading; nothing about the rest.

    normal: (2,) unit vector in field axes. covariance: (2, 2) of (offset_m, heading_rad).
    along_m: (2,) bounds of the position along the normal turned left. log_weight: with the room along in it.
    """

    normal: FloatArray
    offset_m: float
    heading_rad: float
    covariance: FloatArray
    along_m: FloatArray
    log_weight: float
    solver: str = "constraints_from_lines"


def poses_from_lines(lines: GroundLines, field_map: FieldMap) -> tuple[Fix, ...]:
    """Poses that explain the lines, likeliest first; empty unless both directions were seen and fit."""
    found = line_solutions(lines, field_map, Detection())
    return tuple(
        Fix(pose, rotate_covariance(covariance, pose[2]), float(weight), "poses_from_lines")
        for pose, covariance, weight in zip(found.poses, found.covariances, found.log_weights, strict=True)
    )


def constraints_from_lines(lines: GroundLines, field_map: FieldMap) -> tuple[LineConstraint, ...]:
    """As `poses_from_lines` where lines of one direction only were seen."""
    if len(set(lines.families.tolist())) == 2:
        return ()
    found = line_constraints(lines, field_map, Detection())
    stack, log_weights = found.stack, found.log_weights + found.stack.log_room(1.0)
    return tuple(
        LineConstraint(
            np.array([np.cos(stack.normal_rad[i]), np.sin(stack.normal_rad[i])]),
            float(stack.offset_m[i]),
            float(stack.heading_rad[i]),
            stack.covariances[i][::-1, ::-1],
            stack.along_m[i],
            float(log_weights[i]),
        )
        for i in np.argsort(-log_weights, kind="stable")
    )
