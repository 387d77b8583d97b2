"""Which ROS types are known here, by name alone: nothing is parsed and nothing heavy imported."""

from collections.abc import Mapping

from logs.foreign.parts import (
    CameraPart,
    ImageDetectionsPart,
    ImagePart,
    ImuPart,
    JointsPart,
    MagneticPart,
    OdometryPart,
    Part,
    PosePart,
    SpaceDetectionsPart,
    Transforms,
    TwistPart,
)
from logs.source import Source

KNOWN: Mapping[str, type[Part]] = {
    "geometry_msgs/PoseStamped": PosePart,
    "geometry_msgs/PoseWithCovarianceStamped": PosePart,
    "geometry_msgs/TransformStamped": Transforms,
    "geometry_msgs/Twist": TwistPart,
    "geometry_msgs/TwistStamped": TwistPart,
    "nav_msgs/Odometry": OdometryPart,
    "sensor_msgs/CameraInfo": CameraPart,
    "sensor_msgs/CompressedImage": ImagePart,
    "sensor_msgs/Image": ImagePart,
    "sensor_msgs/Imu": ImuPart,
    "sensor_msgs/JointState": JointsPart,
    "sensor_msgs/MagneticField": MagneticPart,
    "soccer_vision_2d_msgs/GoalpostArray": ImageDetectionsPart,
    "soccer_vision_2d_msgs/MarkingArray": ImageDetectionsPart,
    "soccer_vision_3d_msgs/GoalpostArray": SpaceDetectionsPart,
    "soccer_vision_3d_msgs/MarkingArray": SpaceDetectionsPart,
    "tf/tfMessage": Transforms,
    "tf2_msgs/TFMessage": Transforms,
    "vision_msgs/Detection2DArray": ImageDetectionsPart,
    "vision_msgs/Detection3DArray": SpaceDetectionsPart,
}

_SCHEMA_ENCODINGS = {"cdr": ("ros2msg", "ros2idl", ""), "ros1": ("ros1msg", "")}
_STANDARD = ("geometry_msgs/", "nav_msgs/", "sensor_msgs/", "tf/", "tf2_msgs/")


def short_name(name: str) -> str:
    """`pkg/Type` for that and for `pkg/msg/Type`."""
    package, _, rest = name.partition("/")
    return f"{package}/{rest.removeprefix('msg/')}" if rest else name


def known_type(source: Source) -> type[Part] | None:
    """The part that a ROS message of this source becomes; None where it is not ROS or no type known here.

    Without a definition in the file only the standard types are known: there, the definition goes without saying.
    """
    if source.schema_encoding not in _SCHEMA_ENCODINGS.get(source.message_encoding, ()):
        return None
    name = short_name(source.schema_name)
    return KNOWN.get(name) if source.schema_data.strip() or name.startswith(_STANDARD) else None
