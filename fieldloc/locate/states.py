"""Camera poses as stacks (k, 6): x_m, y_m, heading_rad, height_m, pitch_rad, roll_rad, all of the camera in the field.

The heading is that of the optical axis, pitch looks down and roll turns the right side down, as in CameraMount with its
pan for the heading.
"""

import numpy as np

from fieldloc.pose import FloatArray


def rotations(states: FloatArray) -> FloatArray:
    """field_from_camera (k, 3, 3), as `fieldloc.ground.robot_from_camera`."""
    (cp, _, ct, cr), (sp, _, st, sr) = np.cos(states[:, 2:]).T, np.sin(states[:, 2:]).T
    rolled, upright = sr * st, cr * st
    out = np.empty((len(states), 3, 3))
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = cr * sp - cp * rolled, -sr * sp - cp * upright, cp * ct
    out[:, 1, 0], out[:, 1, 1], out[:, 1, 2] = -cr * cp - sp * rolled, sr * cp - sp * upright, sp * ct
    out[:, 2, 0], out[:, 2, 1], out[:, 2, 2] = -sr * ct, -cr * ct, -st
    return out


def turn_axes(states: FloatArray, rotation: FloatArray) -> FloatArray:
    """(k, 3, 3), a row each: field axes about which a change of heading, pitch and roll turns the camera."""
    out = np.zeros((len(states), 3, 3))
    out[:, 0, 2] = 1.0
    out[:, 1, 0], out[:, 1, 1] = -np.sin(states[:, 2]), np.cos(states[:, 2])
    out[:, 2] = rotation[:, :, 2]  # the camera rolls about its own axis
    return out


def centres(states: FloatArray) -> FloatArray:
    """(k, 3) of the cameras in the field."""
    return states[:, [0, 1, 3]]


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products (..., 3), broadcast."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out
