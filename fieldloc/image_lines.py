"""What the lines of an image can be on the map, as anchors for its posts."""

from dataclasses import replace

from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.fixes.line_solutions import line_readings
from fieldloc.fixes.lines import GroundLines
from fieldloc.image_anchors import Anchors, along_lines, joined, one_turn, whole_poses
from fieldloc.pose import FloatArray


def line_anchors(
    lines: GroundLines, field: FieldMap, detection: Detection, root: FloatArray, turn_rad: float
) -> Anchors:
    """All whole poses, and all that lines of one direction say if those of the other are none of the map's; with
    headings within one turn only."""
    whole, single = line_readings(lines, field, replace(detection, clutter=detection.false_line))
    rows = one_turn(whole.poses[:, 2], turn_rad)
    stack, others = single.stack, one_turn(single.stack.heading_rad, turn_rad)
    return joined(
        [
            whole_poses(
                whole.poses[rows], whole.pixel_covariances[rows], whole.by_mount[rows], root, whole.log_weights[rows]
            ),
            along_lines(
                stack.heading_rad[others],
                stack.normal_rad[others],
                stack.offset_m[others],
                stack.along_m[others],
                single.pixel_covariances[others],
                single.by_mount[others],
                root,
                single.log_weights[others],
            ),
        ]
    )
