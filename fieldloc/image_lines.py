"""What the lines of an image can be on the map, as anchors for its posts."""

import numpy as np

from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.fixes.line_poses import constraints_from_lines, poses_from_lines
from fieldloc.fixes.lines import GroundLines
from fieldloc.image_anchors import Anchors, along_lines, joined, whole_poses
from fieldloc.pose import FloatArray, rotate_covariance


def log_clutter(lines: GroundLines) -> float:
    """Log density of all lines if none is the map's."""
    return float(-np.log(np.pi / 2) - len(lines.families) * np.log(10.0))


def line_anchors(lines: GroundLines, field: FieldMap, detection: Detection, root: FloatArray) -> Anchors:
    """All whole poses, and all that lines of one direction say where no more is seen."""
    parts = []
    fixes = poses_from_lines(lines, field, extra_unexplained=1 if len(lines.families) > 3 else 0)
    if fixes:
        poses = np.array([fix.pose for fix in fixes])
        covariances = rotate_covariance(np.array([fix.covariance for fix in fixes]), -poses[:, 2])
        weights = np.array([fix.log_weight for fix in fixes])
        parts.append(whole_poses(poses, covariances, np.zeros((len(fixes), 3, 4)), root, weights))
    found = constraints_from_lines(lines, field, extra_unexplained=1)
    if found:
        normal = np.array([one.normal for one in found])
        along = np.array([one.along_m for one in found])
        covariances = np.array([one.covariance[::-1, ::-1] for one in found])
        room = np.log(np.maximum(along[:, 1] - along[:, 0], 1e-6))
        parts.append(
            along_lines(
                np.array([one.heading_rad for one in found]),
                np.arctan2(normal[:, 1], normal[:, 0]),
                np.array([one.offset_m for one in found]),
                along,
                covariances,
                np.zeros((len(found), 2, 4)),
                root,
                np.array([one.log_weight for one in found]) - room,
            )
        )
    return joined(parts) if parts else nothing_found()


def nothing_found() -> Anchors:
    """No anchors at all."""
    return whole_poses(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3, 4)), np.eye(4), np.zeros(0))
