"""What a robot reports, frozen, stamped, with covariance. Knows no map and no estimator.

Stamps are integer nanoseconds of the log's clock. Bearings are counter-clockwise from the sensor's forward axis.
"""

from dataclasses import dataclass, field

import numpy as np

from fieldloc.pose import FloatArray

_AT_ROBOT_ORIGIN = np.zeros(3)


@dataclass(frozen=True, slots=True)
class Odometry:
    """Velocity in the robot frame, held from its stamp to the next odometry's stamp.

    velocity: (3,) = forward m/s, leftward m/s, turning rad/s (counter-clockwise).
    covariance: (3, 3) of the velocity as the driver states it, white between messages; None where it states none.
    """

    stamp_ns: int
    velocity: FloatArray
    covariance: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class LandmarkScan:
    """Vertical landmarks seen at one instant as range and bearing from a sensor on the robot.

    labels: per landmark its name on the map, or None where its identity is unknown.
    range_bearing: (n, 2), metres on the ground to the landmark's axis, radians.
    covariance: (n, 2, 2) of each (range, bearing); the landmarks' errors are independent of each other.
    robot_from_sensor: (3,) where the sensor sits on the robot.
    """

    stamp_ns: int
    labels: tuple[str | None, ...]
    range_bearing: FloatArray
    covariance: FloatArray
    robot_from_sensor: FloatArray = field(default_factory=_AT_ROBOT_ORIGIN.copy)


@dataclass(frozen=True, slots=True)
class CameraMount:
    """Where a camera sits on the robot and how it is turned when an image is taken.

    x_m, y_m, height_m: the camera's centre in the robot frame, height above the ground.
    pan_rad: turned to the left (counter-clockwise) of the robot's forward axis. tilt_rad: looking down is positive.
    roll_rad: about the optical axis, the camera's right side down is positive.
    covariance: (4, 4) of (height_m, pan_rad, tilt_rad, roll_rad). These errors move everything in one image together.
    """

    height_m: float
    pan_rad: float
    tilt_rad: float
    roll_rad: float
    covariance: FloatArray
    x_m: float = 0.0
    y_m: float = 0.0


@dataclass(frozen=True, slots=True)
class PostObservation:
    """A goal post (vertical cylinder) in an image.

    edges_px: (2, 2) one point on its left edge, one on its right edge, ideally at the horizon's height; (u, v) each.
    covariance_px2: (4, 4) of (left u, left v, right u, right v).
    foot_px: (2,) the middle of its visible contact with the ground, so a radius in front of its axis, or None;
    foot_covariance_px2 (2, 2) with it.
    label: its name on the map, or None where its identity is unknown.
    """

    edges_px: FloatArray
    covariance_px2: FloatArray
    foot_px: FloatArray | None = None
    foot_covariance_px2: FloatArray | None = None
    label: str | None = None


@dataclass(frozen=True, slots=True)
class LineObservation:
    """The visible part of a white line's middle: ends_px (2, 2), covariance_px2 (4, 4) of (u0, v0, u1, v1)."""

    ends_px: FloatArray
    covariance_px2: FloatArray


@dataclass(frozen=True, slots=True)
class ImageFeatures:
    """Posts and lines of one image, with the camera's place and attitude at that moment."""

    stamp_ns: int
    mount: CameraMount
    posts: tuple[PostObservation, ...] = ()
    lines: tuple[LineObservation, ...] = ()


@dataclass(frozen=True, slots=True)
class Compass:
    """Heading of the robot in the field frame from a magnetometer, with its standard deviation."""

    stamp_ns: int
    heading_rad: float
    sigma_rad: float


@dataclass(frozen=True, slots=True)
class InitialPose:
    """field_from_robot (3,) told from outside; covariance (3, 3) of (x, y, heading) in field axes."""

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class Truth:
    """field_from_robot (3,) from a reference system. No estimator ever sees one."""

    stamp_ns: int
    pose: FloatArray


Observation = LandmarkScan | ImageFeatures | Compass | InitialPose
Measurement = Odometry | Observation
