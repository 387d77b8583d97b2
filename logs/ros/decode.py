"""The table of types, and the way from a message's bytes to a part."""

import struct
from collections.abc import Callable, Mapping
from typing import NamedTuple

from logs.foreign.parts import BadPart, Part
from logs.ros import detections, motion, sensors
from logs.ros.definitions import BadDefinition, Definitions, definitions
from logs.ros.plan import Plan, plan
from logs.ros.types import known_type, short_name
from logs.ros.wire import CDR_BIG, CDR_LITTLE, ROS1
from logs.source import Source

Builder = Callable[[Plan], Callable[[list[object]], Part]]


class _Type(NamedTuple):
    builder: Builder
    wanted: tuple[str, ...]


_HEAD = ("header.stamp", "header.frame_id")
_TRANSFORM = ("header.stamp", "header.frame_id", "child_frame_id", "transform")
_HYPOTHESES = tuple(f"detections.results.{name}" for name in ("hypothesis", "id", "score"))
_TYPES: Mapping[str, _Type] = {
    "geometry_msgs/PoseStamped": _Type(motion.stamped_pose, (*_HEAD, "pose")),
    "geometry_msgs/PoseWithCovarianceStamped": _Type(motion.stamped_pose_with_covariance, (*_HEAD, "pose")),
    "geometry_msgs/TransformStamped": _Type(motion.transform, _TRANSFORM),
    "geometry_msgs/Twist": _Type(motion.twist, ("linear", "angular")),
    "geometry_msgs/TwistStamped": _Type(motion.stamped_twist, (*_HEAD, "twist")),
    "nav_msgs/Odometry": _Type(motion.odometry, (*_HEAD, "child_frame_id", "pose", "twist")),
    "sensor_msgs/CameraInfo": _Type(
        sensors.camera, (*_HEAD, "width", "height", "distortion_model", "d", "D", "k", "K")
    ),
    "sensor_msgs/CompressedImage": _Type(sensors.compressed_image, (*_HEAD, "format", "data")),
    "sensor_msgs/Image": _Type(sensors.image, (*_HEAD, "width", "height", "encoding", "step", "data")),
    "sensor_msgs/Imu": _Type(
        sensors.imu,
        (
            *_HEAD,
            *("orientation", "orientation_covariance", "angular_velocity", "angular_velocity_covariance"),
            *("linear_acceleration", "linear_acceleration_covariance"),
        ),
    ),
    "sensor_msgs/JointState": _Type(sensors.joints, ("header.stamp", "name", "position")),
    "sensor_msgs/MagneticField": _Type(sensors.magnetic, (*_HEAD, "magnetic_field")),
    "soccer_vision_2d_msgs/GoalpostArray": _Type(detections.goalposts_2d, (*_HEAD, "posts.bb", "posts.confidence")),
    "soccer_vision_2d_msgs/MarkingArray": _Type(detections.markings_2d, (*_HEAD, "segments")),
    "soccer_vision_3d_msgs/GoalpostArray": _Type(
        detections.goalposts_3d, (*_HEAD, "posts.bb.center", "posts.confidence")
    ),
    "soccer_vision_3d_msgs/MarkingArray": _Type(detections.markings_3d, (*_HEAD, "segments")),
    "tf/tfMessage": _Type(motion.transforms, tuple(f"transforms.{name}" for name in _TRANSFORM)),
    "tf2_msgs/TFMessage": _Type(motion.transforms, tuple(f"transforms.{name}" for name in _TRANSFORM)),
    "vision_msgs/Detection2DArray": _Type(detections.detections_2d, (*_HEAD, "detections.bbox", *_HYPOTHESES)),
    "vision_msgs/Detection3DArray": _Type(detections.detections_3d, (*_HEAD, "detections.bbox.center", *_HYPOTHESES)),
}


def decoder(source: Source) -> Callable[[bytes], Part] | None:
    """What makes parts of this source's messages; None where it is not ROS or no type known here.

    It raises BadPart for a message that does not fit its definition, and for each where the definition itself is bad.
    """
    if known_type(source) is None:
        return None
    name = short_name(source.schema_name)
    kind = _TYPES[name]
    try:
        found = definitions(source)
        if source.message_encoding == "ros1":
            return _ros1(name, kind, found)
        return _cdr(name, kind, found)
    except BadDefinition as error:
        return _refuse(f"{name}: {error}")


def _refuse(reason: str) -> Callable[[bytes], Part]:
    def decode(data: bytes) -> Part:
        raise BadPart(reason)

    return decode


def _ros1(name: str, kind: _Type, found: Definitions) -> Callable[[bytes], Part]:
    how = plan(found, name, kind.wanted, ROS1)
    take, build = how.take, kind.builder(how)

    def decode(data: bytes) -> Part:
        try:
            values, end = take(data, 0)
            if end == len(data):
                return build(values)
        except (struct.error, UnicodeDecodeError, BadPart):
            pass
        raise BadPart(_misfit(name, data))

    return decode


def _cdr(name: str, kind: _Type, found: Definitions) -> Callable[[bytes], Part]:
    plans = [plan(found, name, kind.wanted, wire) for wire in (CDR_BIG, CDR_LITTLE)]
    build = kind.builder(plans[0])
    takes = {bytes((0, number)): how.take for number, how in enumerate(plans)}
    big_or_little = takes.get

    def decode(data: bytes) -> Part:
        take = big_or_little(data[:2])
        if take is None:
            raise BadPart(f"{name}: encapsulated as {data[:2].hex() or 'nothing'}, not as plain CDR (0000 or 0001)")
        try:
            values, end = take(data, 4)
            if len(data) - 4 < end <= len(data):  # up to three bytes of padding
                return build(values)
        except (struct.error, UnicodeDecodeError, BadPart):
            pass
        raise BadPart(_misfit(name, data))

    return decode


def _misfit(name: str, data: bytes) -> str:
    return f"{name}: {len(data)} bytes that do not fit its definition"
