"""Images of a field's lines, exact or with noise, and ground lines made up, for the tests of what lines say."""

import numpy as np
from hypothesis import strategies as st

from fieldloc.camera import Camera
from fieldloc.detection import Detection
from fieldloc.field import FieldMap, load_field
from fieldloc.fixes.line_solutions import LineConstraints, LineSolutions
from fieldloc.fixes.lines import GroundLines, lines_on_the_ground
from fieldloc.ground import project_points
from fieldloc.measurements import CameraMount, LineObservation
from fieldloc.pose import FloatArray, apply, inverse, wrap
from fieldloc.view import visible_parts

CAMERA = Camera("pinhole", 640, 480, 450.0, 450.0, 319.5, 239.5, (-0.2, 0.05, 0.001, -0.001))
SPL = load_field("spl")
MOUNT_AT = np.array([0.5, 0.2, 0.35, 0.03])
NOISE = np.diag([0.01, 0.01, 0.01, 0.01]) ** 2
DETECTION = Detection()
ALL = 100_000  # of the solutions
HALF_TURN = np.array([0.0, 0.0, np.pi])
POSE = np.array([1.3, -0.7, 0.4])  # sees the far touch line, the goal line and the left side of both areas


def mount_at(parameters: FloatArray) -> CameraMount:
    height, pan, tilt, roll = (float(p) for p in parameters)
    return CameraMount(height, pan, tilt, roll, NOISE, x_m=0.05, y_m=0.01)


def image_of(
    field_map: FieldMap,
    pose: FloatArray,
    mount: CameraMount,
    sigma_px: float = 0.5,
    rng: np.random.Generator | None = None,
) -> tuple[LineObservation, ...]:
    """The lines longer than 20 px; their ends with noise if a generator is given."""
    parts, _ = visible_parts(CAMERA, mount, apply(inverse(pose), field_map.lines))
    pixels, _ = project_points(CAMERA, mount, np.pad(parts, ((0, 0), (0, 0), (0, 1))))
    pixels = pixels[np.linalg.norm(pixels[:, 0] - pixels[:, 1], axis=-1) > 20.0]
    if rng is not None:
        pixels = pixels + rng.normal(0.0, sigma_px, pixels.shape)
    return tuple(LineObservation(ends, sigma_px**2 * np.eye(4)) for ends in pixels)


def seen_from(pose: FloatArray, field_map: FieldMap = SPL) -> GroundLines | None:
    mount = mount_at(MOUNT_AT)
    return lines_on_the_ground(CAMERA, mount, image_of(field_map, pose, mount))


def gaps(poses: FloatArray, pose: FloatArray) -> FloatArray:
    """Largest difference of each pose (n, 3) from one."""
    difference = poses - pose
    difference[:, 2] = wrap(difference[:, 2])
    return np.asarray(np.abs(difference).max(axis=1))


poses_on_the_field = st.tuples(st.floats(-4.3, 4.3), st.floats(-2.8, 2.8), st.floats(-3.1, 3.1)).map(np.array)


def ground_lines(
    families: list[int], distances: FloatArray, extents: FloatArray, sigma_m: float, covariance: FloatArray
) -> GroundLines:
    """Lines (n,) ahead of a robot, along its axes; sigma_m of what is seen of their ends, all noise the pixels'."""
    count = len(families)
    return GroundLines(
        bearing_rad=0.0,
        families=np.array(families),
        distances_m=distances,
        extents_m=extents,
        extents_sigma_m=np.full((count, 2), sigma_m),
        covariance=covariance,
        observed=np.arange(count),
        chi_square=0.0,
        pixel_covariance=covariance,
        by_mount=np.zeros((1 + count, 4)),
    )


def found_at(found: LineSolutions, pose: FloatArray, within: float = 1e-8) -> int:
    """How many of the poses are there."""
    return int((gaps(found.poses, pose) < within).sum())


def right_ones(found: LineConstraints, pose: FloatArray) -> FloatArray:
    """(k,) whether each holds at the pose."""
    at, turned = found.stack, found.stack.normal_rad + 0.5 * np.pi
    along = np.cos(turned) * pose[0] + np.sin(turned) * pose[1]
    holds = np.abs(at.errors(pose)).max(axis=-1) < 1e-8
    return np.asarray(holds & (at.along_m[:, 0] <= along) & (along <= at.along_m[:, 1]))


def one_line(low: float, high: float) -> GroundLines:
    """A line 1.5 m ahead, across, seen from `low` to `high`, robot looking along the field's x or another axis."""
    return ground_lines([1], np.array([1.5]), np.array([[low, high]]), 0.01, np.diag([1e-4, 1e-4]))
