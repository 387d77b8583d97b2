"""Where a camera really is and how long its focal length, for a robot of which that is known better than its log says
(fieldloc.mount_fit)."""

import math
from dataclasses import dataclass, replace

import numpy as np

from fieldloc.camera import Camera
from fieldloc.measurements import CameraMount

PARTS = ("height_m", "tilt_rad", "roll_rad", "log_focal")
"""What of a camera a robot's own images tell (fieldloc.mount_fit)."""
ROWS = (0, 2, 3)
"""Of the first three in CameraMount.covariance."""
_SIGMAS = ("height_sigma_m", "tilt_sigma_rad", "roll_sigma_rad")


@dataclass(frozen=True, slots=True)
class MountCorrection:
    """height_m, tilt_rad, roll_rad: what is to be added to what the log says; log_focal: to the logarithm of both focal
    lengths. The sigmas: of what is left then, image by image; 0 leaves it to the log how far it can be trusted.
    log_focal_sigma: how well the focal length is known, which is the same in all images.
    """

    height_m: float = 0.0
    tilt_rad: float = 0.0
    roll_rad: float = 0.0
    log_focal: float = 0.0
    height_sigma_m: float = 0.0
    tilt_sigma_rad: float = 0.0
    roll_sigma_rad: float = 0.0
    log_focal_sigma: float = 0.02

    def applied(self, mount: CameraMount) -> CameraMount:
        """The mount as it is known to be; the same where nothing is known."""
        if self == _NOTHING:
            return mount
        covariance = np.array(mount.covariance, dtype=np.float64)
        for name, row in zip(_SIGMAS, ROWS, strict=True):
            sigma = getattr(self, name)
            if sigma > 0.0:
                covariance[row], covariance[:, row] = 0.0, 0.0
                covariance[row, row] = sigma**2
        return replace(
            mount,
            height_m=mount.height_m + self.height_m,
            tilt_rad=mount.tilt_rad + self.tilt_rad,
            roll_rad=mount.roll_rad + self.roll_rad,
            covariance=covariance,
        )

    def camera(self, camera: Camera) -> Camera:
        """The camera as it is known to be; the same where nothing is known."""
        if self.log_focal == 0.0:
            return camera
        longer = math.exp(self.log_focal)
        return replace(camera, fx_px=longer * camera.fx_px, fy_px=longer * camera.fy_px)


_NOTHING = MountCorrection()
