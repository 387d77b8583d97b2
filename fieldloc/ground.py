"""A mounted camera and the flat ground under it: pixel <-> point on the ground in the robot frame, with Jacobians.

The paper's inverse projection (sec. 2.2, the matrix before eqs. 14-15) for any pan, tilt, roll and height, and for a
lens with distortion. robot_from_camera = turn left by pan, then look down by tilt, then roll about the optical axis.
"""

import math

import numpy as np

from fieldloc.camera import Camera
from fieldloc.lens import Mask
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray


def robot_from_camera(mount: CameraMount) -> FloatArray:
    """Rotation (3, 3) of camera rays into the robot's axes (x forward, y left, z up)."""
    cp, sp = math.cos(mount.pan_rad), math.sin(mount.pan_rad)
    ct, st = math.cos(mount.tilt_rad), math.sin(mount.tilt_rad)
    cr, sr = math.cos(mount.roll_rad), math.sin(mount.roll_rad)
    # R_z(pan) R_y(tilt) R_x(roll), and then the camera's axes: right, down and forward are -y, -z and x
    return np.array(
        [
            [cr * sp - sr * cp * st, -sr * sp - cr * cp * st, cp * ct],
            [-cr * cp - sr * sp * st, sr * cp - cr * sp * st, sp * ct],
            [-sr * ct, -cr * ct, -st],
        ]
    )


def attitude_axes(mount: CameraMount) -> FloatArray:
    """(3, 3), a row each: the robot-frame axes about which a small change of pan, tilt and roll turns the camera."""
    cp, sp = math.cos(mount.pan_rad), math.sin(mount.pan_rad)
    ct, st = math.cos(mount.tilt_rad), math.sin(mount.tilt_rad)
    return np.array([[0.0, 0.0, 1.0], [-sp, cp, 0.0], [cp * ct, sp * ct, -st]])


def robot_ground_points(camera: Camera, mount: CameraMount, pixels: FloatArray) -> tuple[FloatArray, Mask]:
    """Points (..., 2) of the ground in the robot frame that pixels (..., 2) show, and where there is one.

    No pixel on or above the horizon has one, and none has while the camera is not above the ground; NaN there.
    """
    rays, exists = camera.ray(pixels)
    directions = rays @ robot_from_camera(mount).T
    down = -directions[..., 2]
    mask = exists & (down > 0) & (mount.height_m > 0)
    reach = mount.height_m / np.where(mask, down, np.nan)
    return _below(mount) + reach[..., None] * directions[..., :2], mask


def ground_jacobians(camera: Camera, mount: CameraMount, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Change of the ground points with their pixels (..., 2, 2) and with (height, pan, tilt, roll) (..., 2, 4).

    NaN where `robot_ground_points` is masked.
    """
    rays, ray_to_pixel, exists = camera.ray_and_jacobian(pixels)
    rotation = robot_from_camera(mount)
    directions = rays @ rotation.T
    down = np.where(exists & (directions[..., 2] < 0) & (mount.height_m > 0), -directions[..., 2], np.nan)
    from_foot = directions[..., :2] / down[..., None]  # in heights
    # a change of direction moves the point by height / down * (d_xy + from_foot * d_z)
    to_direction = np.empty((*from_foot.shape, 3))
    to_direction[..., :2] = np.eye(2)
    to_direction[..., 2] = from_foot
    to_direction *= (mount.height_m / down)[..., None, None]
    to_pixel = to_direction @ (rotation @ ray_to_pixel)
    turns = cross(attitude_axes(mount), directions[..., None, :])
    to_mount = np.concatenate([from_foot[..., None], to_direction @ np.swapaxes(turns, -1, -2)], axis=-1)
    return to_pixel, to_mount


def project_points(camera: Camera, mount: CameraMount, points_in_robot: FloatArray) -> tuple[FloatArray, Mask]:
    """Pixels (..., 2) of robot-frame points (..., 3), z up from the ground, and whether they are on the image."""
    centre = np.array([mount.x_m, mount.y_m, mount.height_m])
    return camera.project((points_in_robot - centre) @ robot_from_camera(mount))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products (..., 3), broadcast; numpy's own takes twice as long on the few vectors of an image."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    first = y * w - z * v
    out = np.empty((*first.shape, 3))
    out[..., 0], out[..., 1], out[..., 2] = first, z * u - x * w, x * v - y * u
    return out


def _below(mount: CameraMount) -> FloatArray:
    """The camera's foot (2,): the point of the ground straight below it."""
    return np.array([mount.x_m, mount.y_m])
