"""What one scan or image shows: rays on the field from where the robot is."""

from collections.abc import Sequence

import numpy as np
from foxglove.messages import LinePrimitive, SceneUpdate
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.field import FieldMap
from fieldloc.ground import robot_from_camera, robot_ground_points
from fieldloc.measurements import ImageFeatures, LandmarkScan, Measurement
from fieldloc.pose import FloatArray
from logs.foxglove import shapes, topics
from logs.foxglove.annotations import image_annotations
from logs.foxglove.encoded import encoded
from logs.foxglove.scene import entity, removal
from logs.foxglove.topics import Frames
from logs.source import Encoded

_OWN = Frames()
_ENTITY = "sights"
_LIFE_S = 1  # nobody sees longer than this what was seen
_RAY_M, _RESIDUAL_M, _LINE_M = 0.015, 0.03, 0.05
_ABOVE_LINES_M = 0.015
_FARTHEST_M = 30.0  # what a pixel just below the horizon shows is no place to draw to
_BEARING_LENGTH_M = 4.0  # of a post whose foot was not seen


def measurement_messages(
    measurement: Measurement,
    field_from_robot: FloatArray | None,
    camera: Camera | None,
    field: FieldMap | None = None,
    frames: Frames = _OWN,
) -> tuple[Encoded, ...]:
    """Rays to what a scan or an image shows, and the image's annotations; nothing of other measurements.

    field_from_robot: (3,) at its stamp; None, or an image without a camera, has no rays. field: where given, a red line
    goes from where a landmark was seen to where it stands, if it is named.
    """
    stamp_ns = int(measurement.stamp_ns)
    out = []
    lines: list[LinePrimitive] = []
    if isinstance(measurement, LandmarkScan):
        if field_from_robot is None:
            return ()
        lines = _of_scan(measurement, field_from_robot, field)
    elif isinstance(measurement, ImageFeatures):
        out.append(encoded(topics.ANNOTATIONS, stamp_ns, image_annotations(measurement)))
        if field_from_robot is None or camera is None:
            return tuple(out)
        lines = _of_image(measurement, field_from_robot, camera, field)
    else:
        return ()
    shown = removal(_ENTITY, stamp_ns)
    if lines:
        shown = SceneUpdate(entities=[entity(_ENTITY, stamp_ns, frames.field, _LIFE_S, lines=lines)])
    return (*out, encoded(topics.SIGHTS, stamp_ns, shown))


def _of_scan(scan: LandmarkScan, field_from_robot: FloatArray, field: FieldMap | None) -> list[LinePrimitive]:
    field_from_sensor = se2.compose(field_from_robot, scan.robot_from_sensor)
    ranges, bearings = scan.range_bearing.reshape(-1, 2).T
    seen = se2.apply(field_from_sensor, ranges[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=-1))
    return _rays(field_from_sensor[:2], seen, scan.labels, field)


def _of_image(
    image: ImageFeatures, field_from_robot: FloatArray, camera: Camera, field: FieldMap | None
) -> list[LinePrimitive]:
    mount = image.mount
    eye = se2.apply(field_from_robot, np.array([mount.x_m, mount.y_m]))
    standing = [post for post in image.posts if post.foot_px is not None]
    pixels = [*(post.foot_px for post in standing), *(pixel for line in image.lines for pixel in line.ends_px)]
    ground, near = _on_the_ground(image, camera, np.array(pixels).reshape(-1, 2))
    ground = se2.apply(field_from_robot, ground)
    feet, foot_near = ground[: len(standing)], near[: len(standing)]
    labels = [post.label for post, seen in zip(standing, foot_near, strict=True) if seen]
    drawn = _rays(eye, feet[foot_near], labels, field)
    if len(standing) < len(image.posts):
        middles = np.array([post.edges_px.mean(axis=0) for post in image.posts if post.foot_px is None])
        towards = camera.ray(middles)[0] @ robot_from_camera(mount).T[:, :2]
        bearings = np.arctan2(towards[:, 1], towards[:, 0]) + field_from_robot[2]
        ends = eye + _BEARING_LENGTH_M * np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
        ends = ends[np.isfinite(bearings)]
        if len(ends):
            drawn.append(shapes.segments(_from(eye, ends), shapes.PALE_BLUE, _RAY_M, _ABOVE_LINES_M))
    both = near[len(standing) :].reshape(-1, 2).all(axis=1)
    if both.any():
        seen = ground[len(standing) :].reshape(-1, 2, 2)[both]
        drawn.append(shapes.segments(seen, shapes.YELLOW, _LINE_M, _ABOVE_LINES_M))
    return drawn


def _on_the_ground(image: ImageFeatures, camera: Camera, pixels: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Where pixels (n, 2) show the ground, in the robot frame, and which show it near enough."""
    if not len(pixels):
        return np.zeros((0, 2)), np.zeros(0, dtype=np.bool_)
    ground, mask = robot_ground_points(camera, image.mount, pixels)
    return ground, mask & (np.linalg.norm(np.where(mask[:, None], ground, 0.0), axis=-1) < _FARTHEST_M)


def _from(start: FloatArray, ends: FloatArray) -> FloatArray:
    """Lines (n, 2, 2) from one point (2,) to others (n, 2)."""
    lines = np.empty((len(ends), 2, 2))
    lines[:, 0], lines[:, 1] = start, ends
    return lines


def _rays(
    start: FloatArray, seen: FloatArray, labels: Sequence[str | None], field: FieldMap | None
) -> list[LinePrimitive]:
    """From the sensor (2,) to what was seen (n, 2), and from there to where the map has it."""
    if not len(seen):
        return []
    lines = [shapes.segments(_from(start, seen), shapes.BLUE, _RAY_M, _ABOVE_LINES_M)]
    indices = [None if field is None or label is None else field.index_of(label) for label in labels]
    named = [row for row, index in enumerate(indices) if index is not None]
    if field is not None and named:
        on_map = field.positions[[index for index in indices if index is not None]]
        residuals = np.stack([seen[named], on_map], axis=1)
        lines.append(shapes.segments(residuals, shapes.RED, _RESIDUAL_M, _ABOVE_LINES_M))
    return lines
