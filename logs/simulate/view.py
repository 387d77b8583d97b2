"""A block of images: from the field to rays in the camera, and back to who is in the way."""

from dataclasses import dataclass

import numpy as np

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.pose import FloatArray
from logs.simulate.shots import Shots


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """n images. camera_from_field: (n, 3, 3) rotations. centres: (n, 3) of the true cameras in the field frame.

    blur_px: (n,) length of the motion blur. others: (n, k, 2) the other robots, NaN where there is none.
    """

    camera: Camera
    camera_from_field: FloatArray
    centres: FloatArray
    blur_px: FloatArray
    others: FloatArray

    def __len__(self) -> int:
        return len(self.centres)

    def rays(self, points: FloatArray) -> FloatArray:
        """Rays (n, ..., 3) in the camera frame to points (n, ..., 3) of the field, z up."""
        flat = points.reshape(len(points), -1, 3) - self.centres[:, None]
        return (flat @ np.swapaxes(self.camera_from_field, -1, -2)).reshape(points.shape)


def view_of(shots: Shots, block: slice, camera: Camera, exposure_s: float) -> View:
    """What the camera of these shots truly looks at."""
    poses = shots.poses[block]
    places = shots.real.places[block]
    turned = se2.rotation3(poses[:, 2]) @ shots.real.robot_from_camera[block]
    centres = np.column_stack([se2.apply(poses, places[:, :2]), places[:, 2]])
    blur_px = camera.fx_px * exposure_s * shots.turning_radps[block]
    return View(camera, np.swapaxes(turned, -1, -2), centres, blur_px, shots.others[block])


def share_found(
    range_m: FloatArray, blur_px: FloatArray, near_chance: float, half_range_m: float, scale_m: float, half_px: float
) -> FloatArray:
    """The chance (...) of being found: logistic in the range, halved by half_px of motion blur."""
    with np.errstate(over="ignore"):  # infinitely improbable
        far = 1.0 / (1.0 + np.exp((range_m - half_range_m) / scale_m))
    return np.asarray(near_chance * far / (1.0 + (blur_px / half_px) ** 2))
