"""What ROS and Foxglove messages have in common, once decoded: plain numbers in the message's own frame.

One record a kind, whatever the wire format was. Rotations are quaternions (x, y, z, w) as they stood in the message,
not normalised. stamp_ns is the header's; None where the message has none (the log time is all there is then).
Arrays are float64. Nothing is checked but the shapes: what a number must be is the business of who uses it.
"""

from dataclasses import dataclass

from fieldloc.pose import FloatArray


class BadPart(ValueError):
    """A message that its own schema does not describe, or that is cut off."""


@dataclass(frozen=True, slots=True)
class Transform:
    """parent_from_child: translation (3,) metres, rotation (4,)."""

    stamp_ns: int
    parent: str
    child: str
    translation: FloatArray
    rotation: FloatArray


@dataclass(frozen=True, slots=True)
class Transforms:
    """tf2_msgs/TFMessage, FrameTransform, FrameTransforms. Whether they are static is said by the topic, not here."""

    transforms: tuple[Transform, ...]


@dataclass(frozen=True, slots=True)
class PosePart:
    """A pose in `frame`: position (3,), rotation (4,); covariance (6, 6) of (x, y, z, about x, y, z) or None."""

    stamp_ns: int | None
    frame: str
    position: FloatArray
    rotation: FloatArray
    covariance: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class TwistPart:
    """linear (3,) m/s and angular (3,) rad/s in `frame`; covariance (6, 6), None: not said."""

    stamp_ns: int | None
    frame: str
    linear: FloatArray
    angular: FloatArray
    covariance: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class OdometryPart:
    """nav_msgs/Odometry, foxglove.Odometry: pose of the twist's frame (the child) in the pose's, and its velocity."""

    pose: PosePart
    twist: TwistPart


@dataclass(frozen=True, slots=True)
class ImuPart:
    """angular_velocity (3,) rad/s, acceleration (3,) m/s^2, rotation (4,) of the sensor; None: not said."""

    stamp_ns: int
    frame: str
    rotation: FloatArray | None
    angular_velocity: FloatArray | None
    acceleration: FloatArray | None


@dataclass(frozen=True, slots=True)
class MagneticPart:
    """Magnetic field (3,) in tesla in the sensor's frame."""

    stamp_ns: int
    frame: str
    field: FloatArray


@dataclass(frozen=True, slots=True)
class JointsPart:
    stamp_ns: int
    names: tuple[str, ...]
    positions: FloatArray


@dataclass(frozen=True, slots=True)
class CameraPart:
    """matrix (3, 3); distortion_model as named in the message ("plumb_bob", "rational_polynomial", "fisheye", ...)."""

    stamp_ns: int
    frame: str
    width_px: int
    height_px: int
    matrix: FloatArray
    distortion_model: str
    distortion: FloatArray


@dataclass(frozen=True, slots=True)
class ImagePart:
    """A picture as bytes. format: "jpeg", "png", ... or for a raw one its pixel encoding ("rgb8", "mono8", ...), with
    its size and bytes a row then, zeros otherwise."""

    stamp_ns: int
    frame: str
    format: str
    data: bytes
    width_px: int = 0
    height_px: int = 0
    step: int = 0


@dataclass(frozen=True, slots=True)
class VideoPart:
    """A frame of a compressed video, which no one here decodes. format: "h264", ..."""

    stamp_ns: int
    frame: str
    format: str


@dataclass(frozen=True, slots=True)
class ImageDetectionsPart:
    """What a detector saw in an image, pixels in the image as it came from the camera.

    boxes: (n, 4) of each goal post: centre u, v, width, height. lines: (m, 2, 2) ends of each field line's middle.
    confidences: (n,) and (m,), NaN where the message says none.
    """

    stamp_ns: int
    frame: str
    boxes: FloatArray
    box_confidences: FloatArray
    lines: FloatArray
    line_confidences: FloatArray


@dataclass(frozen=True, slots=True)
class SpaceDetectionsPart:
    """What a detector saw, in metres in `frame`. posts: (n, 3) a point on each goal post's axis. lines: (m, 2, 3)."""

    stamp_ns: int
    frame: str
    posts: FloatArray
    post_confidences: FloatArray
    lines: FloatArray
    line_confidences: FloatArray


Part = (
    Transforms
    | PosePart
    | TwistPart
    | OdometryPart
    | ImuPart
    | MagneticPart
    | JointsPart
    | CameraPart
    | ImagePart
    | VideoPart
    | ImageDetectionsPart
    | SpaceDetectionsPart
)
