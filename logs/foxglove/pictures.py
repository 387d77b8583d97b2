"""Pictures as Foxglove's messages, each with the transform that says where its camera was."""

from math import cos, sin

from foxglove.messages import CompressedImage, FrameTransform, FrameTransforms, Quaternion, Vector3

from fieldloc.measurements import CameraMount
from logs.foreign import rotations
from logs.foxglove.encoded import encoded
from logs.foxglove.shapes import timestamp
from logs.source import Encoded

PICTURES, TRANSFORMS = "/image", "/tf"
"""Their topics."""
_ROBOT, _CAMERA = "base_footprint", "camera_optical_frame"
_LEVEL = (-0.5, 0.5, -0.5, 0.5)  # right, down, forward in the robot's axes while pan, tilt and roll are zero


def picture_messages(
    data: bytes, image_format: str, mount: CameraMount, stamp_ns: int, log_time_ns: int
) -> tuple[Encoded, ...]:
    """The transform first. image_format: "jpeg" or "png"; the mount's covariance has no place in either message."""
    picture = CompressedImage(timestamp=timestamp(stamp_ns), frame_id=_CAMERA, data=data, format=image_format)
    turned = _quaternion(mount)
    transform = FrameTransform(
        timestamp=timestamp(stamp_ns),
        parent_frame_id=_ROBOT,
        child_frame_id=_CAMERA,
        translation=Vector3(x=mount.x_m, y=mount.y_m, z=mount.height_m),
        rotation=Quaternion(x=turned[0], y=turned[1], z=turned[2], w=turned[3]),
    )
    return (
        encoded(TRANSFORMS, log_time_ns, FrameTransforms(transforms=[transform])),
        encoded(PICTURES, log_time_ns, picture),
    )


def _quaternion(mount: CameraMount) -> rotations.Quaternion:
    """robot_from_camera, as `fieldloc.ground`: turned left by pan, then down by tilt, then about the optical axis."""
    pan, tilt, roll = 0.5 * mount.pan_rad, 0.5 * mount.tilt_rad, 0.5 * mount.roll_rad
    turned = rotations.multiply((0.0, 0.0, sin(pan), cos(pan)), (0.0, sin(tilt), 0.0, cos(tilt)))
    return rotations.multiply(rotations.multiply(turned, (sin(roll), 0.0, 0.0, cos(roll))), _LEVEL)
