"""Where a head's camera is on the robot, for a stack of images: its kinematics, true or as the robot believes."""

from dataclasses import dataclass

import numpy as np

from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray, rotation3
from logs.simulate.vision_settings import HeadSettings


@dataclass(frozen=True, slots=True, eq=False)
class Mounts:
    """n camera mounts without covariance: `places` (n, 6) of x_m, y_m, height_m, pan_rad, tilt_rad, roll_rad."""

    places: FloatArray

    def mount(self, index: int, covariance: FloatArray) -> CameraMount:
        """One of them as a record."""
        x, y, height, pan, tilt, roll = self.places[index].tolist()
        return CameraMount(height, pan, tilt, roll, covariance, x, y)

    def records(self, covariance: FloatArray) -> list[CameraMount]:
        """All of them as records, which share the covariance."""
        return [
            CameraMount(height, pan, tilt, roll, covariance, x, y)
            for x, y, height, pan, tilt, roll in self.places.tolist()
        ]

    def off_by(self, error: FloatArray) -> "Mounts":
        """The mounts with (4,) added to height, pan, tilt and roll."""
        return Mounts(self.places + np.concatenate([[0.0, 0.0], error]))

    @property
    def robot_from_camera(self) -> FloatArray:
        """Rotations (n, 3, 3) of camera rays into the robot's axes, as `fieldloc.ground.robot_from_camera`."""
        pan, tilt, roll = self.places[:, 3:].T
        turned = rotation3(pan) @ _about_y(tilt) @ _about_x(roll)
        # the camera's right, down and forward are minus the left, minus the up and the forward of its axes
        return np.stack([-turned[..., 1], -turned[..., 2], turned[..., 0]], axis=-1)


def head_mounts(head: HeadSettings, joints_rad: FloatArray, trunk_rad: FloatArray, lift_m: FloatArray) -> Mounts:
    """The camera on a head turned by pan and tilt (n, 2), on a trunk turned about the robot's origin on the ground.

    trunk_rad: (n, 2) roll (right side down) and pitch (forward), lift_m (n,) upwards.
    """
    pan, tilt = joints_rad.T
    trunk = _about_y(trunk_rad[:, 1]) @ _about_x(trunk_rad[:, 0])
    turned = trunk @ rotation3(pan) @ _about_y(tilt)
    forward = head.camera_ahead_m * np.cos(tilt) + head.camera_above_m * np.sin(tilt)
    upward = head.camera_above_m * np.cos(tilt) - head.camera_ahead_m * np.sin(tilt)
    on_trunk = np.stack([forward * np.cos(pan), forward * np.sin(pan), head.neck_height_m + upward], axis=-1)
    centre = (trunk @ on_trunk[..., None])[..., 0]
    centre[:, 2] += lift_m
    ahead = turned[..., 0]
    angles = [
        np.arctan2(ahead[:, 1], ahead[:, 0]),
        np.arcsin(np.clip(-ahead[:, 2], -1.0, 1.0)),
        np.arctan2(turned[:, 2, 1], turned[:, 2, 2]),
    ]
    return Mounts(np.column_stack([centre, *angles]))


def _about_x(angle_rad: FloatArray) -> FloatArray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    out = np.zeros((*angle_rad.shape, 3, 3))
    out[..., 0, 0] = 1.0
    out[..., 1, 1] = out[..., 2, 2] = c
    out[..., 1, 2], out[..., 2, 1] = -s, s
    return out


def _about_y(angle_rad: FloatArray) -> FloatArray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    out = np.zeros((*angle_rad.shape, 3, 3))
    out[..., 1, 1] = 1.0
    out[..., 0, 0] = out[..., 2, 2] = c
    out[..., 0, 2], out[..., 2, 0] = s, -s
    return out
