"""Parts as other people's drivers would send them, and the surroundings of a log that has these frames and camera."""

import numpy as np
from scipy.spatial.transform import Rotation

from fieldloc.camera import Camera
from logs.foreign.frames import Frames
from logs.foreign.notes import Notes
from logs.foreign.parts import CameraPart, OdometryPart, PosePart, Transform, TwistPart
from logs.foreign.settings import LogMapping
from logs.foreign.surroundings import Surroundings

SECOND = 1_000_000_000
NAN3, NAN4 = np.full(3, np.nan), np.full(4, np.nan)
CAMERA = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)


def ns(stamp_s):
    return round(stamp_s * SECOND)


def about(axes, *angles_rad):
    return Rotation.from_euler(axes, np.array(angles_rad))


def transform(parent, child, position, rotation=None, stamp_s=0.0):
    quaternion = (rotation or Rotation.identity()).as_quat()
    return Transform(ns(stamp_s), parent, child, np.asarray(position, dtype=float), quaternion)


def surroundings(*transforms, mapping=None, camera=CAMERA, camera_frame="camera_optical_frame"):
    """transforms: static ones."""
    frames = Frames()
    frames.add(transforms, 0, static=True)
    return Surroundings(mapping or LogMapping(), Notes(), lambda: frames, lambda: (camera, camera_frame))


def pose_part(stamp_s, x, y, yaw, frame="odom", z=0.0, pitch=0.0, covariance=None):
    return PosePart(ns(stamp_s), frame, np.array([x, y, z]), about("ZY", yaw, pitch).as_quat(), covariance)


def odometry_part(stamp_s, pose=None, twist=None, child="base_footprint", covariance=None):
    """pose (3,) and twist (3,) in the plane; None: not a number."""
    stamp_ns = ns(stamp_s)
    linear, angular = (NAN3, NAN3) if twist is None else (np.array([*twist[:2], 0.0]), np.array([0.0, 0.0, twist[2]]))
    where = PosePart(stamp_ns, "odom", NAN3, NAN4) if pose is None else pose_part(stamp_s, *pose)
    return OdometryPart(where, TwistPart(stamp_ns, child, linear, angular, covariance))


def camera_part(model="plumb_bob", distortion=(), matrix=None, size=(640, 480)):
    k = np.array([[500.0, 0.0, 319.5], [0.0, 500.0, 239.5], [0.0, 0.0, 1.0]]) if matrix is None else matrix
    return CameraPart(0, "camera", *size, k, model, np.array(distortion, dtype=float))


def feed(adapter, parts, topic="/topic"):
    """All records of parts that state their stamps."""
    out = []
    for part in parts:
        stamp_ns = part.pose.stamp_ns if isinstance(part, OdometryPart) else part.stamp_ns
        out += adapter.take(topic, stamp_ns, part)
    return [*out, *adapter.finish()]
