"""What a log of someone else's robot does not say itself, or says in words of its own. Everything has a default."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import radians
from types import MappingProxyType

import numpy as np

from fieldloc.camera import Camera
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray
from logs.schema import TOPICS

SHOWN = ("tf", "image", "imu", "magnetometer", "joints")
"""Roles that give no record by themselves."""
ROLES = (*TOPICS, *SHOWN)
MANY = ("image_features", "landmarks", "tf")
"""Roles that several topics can share."""

NO_ROLES: Mapping[str, tuple[str, ...]] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class FrameNames:
    """Empty: guessed. field_from_map: (x, y, heading) of the log's map in fieldloc's field."""

    field: str = ""
    odom: str = ""
    robot: str = ""
    camera: str = ""
    robot_height_m: float = 0.0  # of the robot's frame above the ground
    max_age_s: float = 0.25  # of a transform
    field_from_map: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class MountSettings:
    """How well the camera's place and attitude are known, and what they are where no transform tells (`fixed`)."""

    height_sigma_m: float = 0.01
    pan_sigma_rad: float = radians(1.0)
    tilt_sigma_rad: float = radians(1.0)
    roll_sigma_rad: float = radians(1.0)
    fixed: CameraMount | None = None

    @property
    def covariance(self) -> FloatArray:
        """(4, 4) of height, pan, tilt, roll."""
        sigmas = (self.height_sigma_m, self.pan_sigma_rad, self.tilt_sigma_rad, self.roll_sigma_rad)
        return np.diag(np.square(sigmas))


@dataclass(frozen=True, slots=True)
class DetectionNoise:
    """Of what a detector says. With a camera of known height, the distance of a post comes from the camera's tilt."""

    edge_sigma_px: float = 3.0
    foot_sigma_px: float = 4.0
    line_sigma_px: float = 2.0
    range_sigma_m: float = 0.03
    range_sigma_relative: float = 0.05
    bearing_sigma_rad: float = radians(1.5)
    min_confidence: float = 0.0


@dataclass(frozen=True, slots=True)
class OdometrySettings:
    """Faster than this, a pose has jumped."""

    max_speed_mps: float = 5.0
    max_turn_radps: float = radians(720.0)
    use_covariance: bool = True


@dataclass(frozen=True, slots=True)
class CompassSettings:
    """north_rad: where a compass points to, in the field. imu_heading_rad: the robot's heading at the IMU's zero."""

    north_rad: float | None = None
    imu_heading_rad: float | None = None
    sigma_rad: float = radians(15.0)


@dataclass(frozen=True, slots=True)
class InitialPoseSettings:
    """Where the message states no covariance."""

    sigma_m: float = 0.5
    heading_sigma_rad: float = radians(15.0)


@dataclass(frozen=True, slots=True)
class LogMapping:
    """roles: topics by role, instead of what would be guessed; no topic: nothing plays it. told: roles by --role."""

    roles: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: NO_ROLES)
    told: frozenset[str] = frozenset()
    frames: FrameNames = FrameNames()
    camera: Camera | None = None
    rectified: bool = False
    mount: MountSettings = MountSettings()
    detections: DetectionNoise = DetectionNoise()
    odometry: OdometrySettings = OdometrySettings()
    compass: CompassSettings = CompassSettings()
    initial_pose: InitialPoseSettings = InitialPoseSettings()
