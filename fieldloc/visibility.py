"""Which landmarks a camera would show clearly from a pose: those whose absence says something."""

import numpy as np

from fieldloc.camera import Camera
from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.ground import project_points
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray, apply, inverse

_NEAREST_M = 0.5  # from the camera: nearer a post is more than a post to a detector
_MARGIN = 0.1  # of the image's width and height: the pose may be off, and so may the mount
_FADE = 0.5  # share of the range over which the certainty falls to nothing


def in_clear_sight(
    poses: FloatArray, camera: Camera, mount: CameraMount, field: FieldMap, detection: Detection
) -> FloatArray:
    """(k, m) between 0 and 1: how sure it is that the landmark's foot is well within the image, and not far away."""
    seen = apply(inverse(poses)[:, None], field.positions)
    points = np.zeros((*seen.shape[:-1], 3))
    points[..., :2] = seen
    pixels, on_image = project_points(camera, mount, points)
    size = np.array([camera.width_px, camera.height_px])
    share = np.where(on_image[..., None], pixels / size, -1.0)
    well_inside = ((share > _MARGIN) & (share < 1.0 - _MARGIN)).all(axis=-1)
    distance = np.hypot(seen[..., 0] - mount.x_m, seen[..., 1] - mount.y_m)
    certain = np.clip((detection.post_range_m / np.maximum(distance, 1e-9) - 1.0) / _FADE + 1.0, 0.0, 1.0)
    return np.asarray(np.where(well_inside & (distance > _NEAREST_M), certain, 0.0))
