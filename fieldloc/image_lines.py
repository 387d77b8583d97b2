"""What the lines of an image can be on the map, as anchors for its posts."""

from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.fixes.line_solutions import line_constraints, line_solutions
from fieldloc.fixes.lines import GroundLines
from fieldloc.image_anchors import Anchors, along_lines, joined, whole_poses
from fieldloc.pose import FloatArray


def line_anchors(lines: GroundLines, field: FieldMap, detection: Detection, root: FloatArray) -> Anchors:
    """All whole poses, and all that lines of one direction say if those of the other are none of the map's."""
    whole = line_solutions(lines, field, detection)
    single = line_constraints(lines, field, detection)
    stack = single.stack
    return joined(
        [
            whole_poses(whole.poses, whole.pixel_covariances, whole.by_mount, root, whole.log_weights),
            along_lines(
                stack.heading_rad,
                stack.normal_rad,
                stack.offset_m,
                stack.along_m,
                single.pixel_covariances,
                single.by_mount,
                root,
                single.log_weights,
            ),
        ]
    )
