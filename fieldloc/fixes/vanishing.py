"""Vanishing points: where all parallel lines of the ground meet in the image, and what that says about the heading.

The paper's sec. 2.2 for any pan, tilt, roll and lens. Without roll and distortion it reads, on a sensor with x right
and y up, psi the tilt, and theta how far to the right of the camera the lines along the field's z run (the paper's "the
robot will have to turn theta"):
    lines along z vanish at f (tan(theta) / cos(psi), tan(psi)),  theta = arctan(x cos(psi) / f)
    lines along x vanish at f (-cot(theta) / cos(psi), tan(psi)), theta = arctan(-f / (x cos(psi))), eq. 13 at psi = 0
One formula serves both, as the direction of the ray itself is the bearing of the lines; which family it is stays
unknown, so the robot's heading follows modulo 90 degrees only. The horizon is the set of all vanishing points.
"""

import numpy as np

from fieldloc.camera import Camera
from fieldloc.ground import attitude_axes, cross, robot_from_camera
from fieldloc.lens import Mask
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray


def vanishing_points(camera: Camera, mount: CameraMount, bearing_rad: FloatArray) -> tuple[FloatArray, Mask]:
    """Pixels (..., 2) at which ground lines of robot-frame bearings (...) vanish, and which of them are on the image.

    A line has a second one at bearing + pi. A pinhole has no pixel for the one behind it: NaN, mask False.
    """
    bearing = np.asarray(bearing_rad, dtype=np.float64)
    directions = np.stack([np.cos(bearing), np.sin(bearing), np.zeros_like(bearing)], axis=-1)
    return camera.project(directions @ robot_from_camera(mount))


def bearing_of_vanishing_point(
    camera: Camera, mount: CameraMount, pixel: FloatArray
) -> tuple[float, FloatArray, FloatArray] | None:
    """Bearing in the robot frame of the lines that vanish at a pixel (2,); None where the lens has no ray for it.

    Also its change with the pixel (2,) and with (height, pan, tilt, roll) (4,). The pixel need not be on the horizon of
    `mount`: what is above or below it does not enter.
    """
    ray, ray_to_pixel, exists = camera.ray_and_jacobian(pixel)
    rotation = robot_from_camera(mount)
    x, y = (rotation @ ray)[:2]
    level2 = x * x + y * y
    if not exists or level2 < 1e-24:  # straight down or up: every bearing
        return None
    to_direction = np.array([-y, x, 0.0]) / level2
    to_attitude = cross(attitude_axes(mount), rotation @ ray) @ to_direction
    return float(np.arctan2(y, x)), to_direction @ rotation @ ray_to_pixel, np.concatenate([[0.0], to_attitude])


def vanishing_ray(segment_rays: FloatArray) -> FloatArray | None:
    """Unit ray (3,) in which image lines meet, each given by the rays to two of its points (n, 2, 3).

    Needs no attitude: it is the direction most nearly in all the planes through the camera and a line, and points to
    the front. None where the planes coincide or one line stands alone: no direction stands out.
    """
    normals = cross(segment_rays[:, 0], segment_rays[:, 1])
    lengths = np.linalg.norm(normals, axis=-1)
    normals = normals[lengths > 0] / lengths[lengths > 0, None]
    if len(normals) < 2 or not np.isfinite(normals).all():
        return None
    _, singular, directions = np.linalg.svd(normals)
    if singular[1] < 1e-9 * singular[0]:
        return None
    ray = directions[-1]
    return np.asarray(ray if ray[2] >= 0 else -ray)
