"""Which landmarks a camera would show clearly from a pose: those whose absence says something."""

from functools import lru_cache

import numpy as np

from fieldloc.camera import Camera
from fieldloc.detection import Detection
from fieldloc.ground import robot_from_camera
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray

_NEAREST_M = 0.5  # from the camera: nearer a post is more than a post to a detector
_MARGIN = 0.1  # of the image's width and height: the pose may be off, and so may the mount
_FADE = 0.5  # share of the range over which the certainty falls to nothing


def in_clear_sight(
    poses: FloatArray, camera: Camera, mount: CameraMount, landmarks: FloatArray, detection: Detection
) -> FloatArray:
    """(k, m) between 0 and 1: how sure it is that the landmark's foot is well within the image, and not far away.

    1 up to detection.post_range_m, falling to 0 beyond it.
    """
    c, s = np.cos(poses[:, None, 2]), np.sin(poses[:, None, 2])
    x, y = landmarks[:, 0] - poses[:, :1], landmarks[:, 1] - poses[:, 1:2]
    away = np.empty((*x.shape, 3))
    away[..., 0], away[..., 1], away[..., 2] = c * x + s * y - mount.x_m, c * y - s * x - mount.y_m, -mount.height_m
    sides = _sides(camera) @ robot_from_camera(mount).T
    well_inside = (away @ sides.T > 0.0).all(axis=-1)
    distance = np.hypot(away[..., 0], away[..., 1])
    certain = 1.0 - (distance / detection.post_range_m - 1.0) / _FADE
    return np.asarray(np.where(well_inside & (distance > _NEAREST_M), np.clip(certain, 0.0, 1.0), 0.0))


@lru_cache(maxsize=16)
def _sides(camera: Camera) -> FloatArray:
    """(4, 3) inward normals, camera frame, of the planes through the corners of the image without its margin."""
    low, high = _MARGIN, 1.0 - _MARGIN
    corners = np.array([[low, low], [high, low], [high, high], [low, high]])
    rays, _ = camera.ray(corners * [camera.width_px - 1.0, camera.height_px - 1.0])
    return np.asarray(np.cross(rays, np.roll(rays, -1, axis=0)))
