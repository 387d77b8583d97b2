"""What the lines of an image can be on the map, as anchors for its posts."""

from dataclasses import replace

from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.fixes.line_solutions import line_readings
from fieldloc.fixes.lines import GroundLines
from fieldloc.image_anchors import Anchors, along_lines, one_turn, whole_poses
from fieldloc.pose import FloatArray


def line_anchors(
    lines: GroundLines, field: FieldMap, detection: Detection, root: FloatArray, turn_rad: float
) -> list[Anchors]:
    """All whole poses, and all that lines of one direction say if those of the other are none of the map's; with
    headings within one turn only."""
    whole, single = line_readings(lines, field, replace(detection, clutter=detection.false_line))
    out = []
    rows = one_turn(whole.poses[:, 2], turn_rad)
    if rows.any():
        pixel, by_mount = whole.pixel_covariances[rows], whole.by_mount[rows]
        out.append(whole_poses(whole.poses[rows], pixel, by_mount, root, whole.log_weights[rows]))
    stack = single.stack
    rows = one_turn(stack.heading_rad, turn_rad)
    if rows.any():
        out.append(
            along_lines(
                stack.heading_rad[rows],
                stack.normal_rad[rows],
                stack.offset_m[rows],
                stack.along_m[rows],
                single.pixel_covariances[rows],
                single.by_mount[rows],
                root,
                single.log_weights[rows],
            )
        )
    return out
