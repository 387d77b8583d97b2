"""What is known of the camera's height, pitch and roll before the picture is looked at."""

import math
from dataclasses import dataclass, field

import numpy as np

from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray

_ATTITUDE_SIGMA_RAD = math.radians(3.0)
_HEIGHT_SIGMA_M = 0.03
# Told nothing: a robot's camera stands roughly upright, below the height of a man, and looks ahead or down.
_HEIGHT_M, _HEIGHT_WIDE_M = 0.8, 0.5
_PITCH_RAD, _PITCH_WIDE_RAD = math.radians(15.0), math.radians(20.0)
_ROLL_WIDE_RAD = math.radians(6.0)
_KNOWN_HEIGHT = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class CameraPrior:
    """mean: (3,) of height_m, pitch_rad (looking down is positive), roll_rad (right side down is positive).
    covariance: (3, 3) of these. ValueError for what is no such prior."""

    mean: FloatArray
    covariance: FloatArray
    precision: FloatArray = field(init=False, repr=False)
    """(3, 3) the inverse of the covariance."""

    def __post_init__(self) -> None:
        if np.shape(self.mean) != (3,) or np.shape(self.covariance) != (3, 3):
            raise ValueError("a camera's prior has a mean of (height, pitch, roll) and their covariance (3, 3)")
        if not (np.isfinite(self.mean).all() and np.isfinite(self.covariance).all()):
            raise ValueError("a camera's prior holds a value that is not finite")
        if not self.mean[0] > 0.0:
            raise ValueError(f"the camera's height is {self.mean[0]}, must be positive")
        if np.linalg.eigvalsh(self.covariance)[0] <= 0.0:
            raise ValueError("the covariance of a camera's prior is not positive definite")
        object.__setattr__(self, "precision", np.linalg.inv(self.covariance))

    @property
    def sigmas(self) -> FloatArray:
        """(3,)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))

    @property
    def knows_height(self) -> bool:
        return bool(self.sigmas[0] < _KNOWN_HEIGHT * self.mean[0])

    @staticmethod
    def told(
        height_m: float | None = None,
        pitch_rad: float | None = None,
        roll_rad: float | None = None,
        sigma_height_m: float = _HEIGHT_SIGMA_M,
        sigma_attitude_rad: float = _ATTITUDE_SIGMA_RAD,
    ) -> "CameraPrior":
        """With what is not told left wide: 0.2 to 1.8 m, a pitch of any robot's head, nearly upright."""
        mean = np.array([_HEIGHT_M, _PITCH_RAD, 0.0])
        sigma = np.array([_HEIGHT_WIDE_M, _PITCH_WIDE_RAD, _ROLL_WIDE_RAD])
        for i, (value, narrow) in enumerate(
            ((height_m, sigma_height_m), (pitch_rad, sigma_attitude_rad), (roll_rad, sigma_attitude_rad))
        ):
            if value is not None:
                mean[i], sigma[i] = value, narrow
        return CameraPrior(mean, np.diag(sigma**2))

    @staticmethod
    def of_mount(mount: CameraMount) -> "CameraPrior":
        """Of a camera on a robot; the pan is the robot's affair."""
        rows = [0, 2, 3]
        floor = np.diag(np.array([1e-3, 1e-4, 1e-4]) ** 2)  # exact numbers have no inverse
        covariance = mount.covariance[np.ix_(rows, rows)] + floor
        return CameraPrior(np.array([mount.height_m, mount.tilt_rad, mount.roll_rad]), covariance)
