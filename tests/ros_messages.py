"""Messages of known types with random contents, packed by rosbags, and the definitions that soccer robots use.

The definitions are those of ros-sports/soccer_interfaces 0.2 and 1.0 and of ros-perception/vision_msgs 1 to 4, without
what is beside the point.
"""

from collections.abc import Mapping
from functools import cache
from types import SimpleNamespace

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from logs.source import Source

VISION = {
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "soccer_vision_attribute_msgs/msg/Confidence": "float32 CONFIDENCE_UNKNOWN=-1\nfloat32 confidence -1\n",
    "soccer_vision_attribute_msgs/msg/Goalpost": "uint8 SIDE_LEFT=1 # seen from the field\nuint8 side\nuint8 team\n",
}
VISION_3 = {
    **VISION,
    "vision_msgs/msg/BoundingBox2D": "geometry_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
    "vision_msgs/msg/Point2D": "float64 x\nfloat64 y\n",
    "vision_msgs/msg/ObjectHypothesis": "string id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n",
    "vision_msgs/msg/Detection2D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox2D bbox\nsensor_msgs/Image source_img\n"
    ),
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\n"
        "sensor_msgs/PointCloud2 source_cloud\nbool is_tracking\nstring tracking_id\n"
    ),
    "soccer_vision_2d_msgs/msg/MarkingSegment": (
        "geometry_msgs/Point start\ngeometry_msgs/Point end\nsoccer_vision_attribute_msgs/Confidence confidence\n"
    ),
}
VISION_2 = {  # a hypothesis without composition
    **VISION_3,
    "vision_msgs/msg/ObjectHypothesisWithPose": "string id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose\n",
}
VISION_4 = {
    **VISION_3,
    "vision_msgs/msg/Pose2D": "vision_msgs/Point2D position\nfloat64 theta\n",
    "vision_msgs/msg/BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/Detection2D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox2D bbox\nstring id\n"
    ),
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id\n"
    ),
    "soccer_vision_2d_msgs/msg/MarkingSegment": (
        "vision_msgs/Point2D start\nvision_msgs/Point2D end\nsoccer_vision_attribute_msgs/Confidence confidence\n"
    ),
}
ARRAYS = {
    "vision_msgs/msg/Detection2DArray": "std_msgs/Header header\nDetection2D[] detections\n",
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nDetection3D[] detections\n",
    "soccer_vision_2d_msgs/msg/Goalpost": (
        "vision_msgs/BoundingBox2D bb\nsoccer_vision_attribute_msgs/Goalpost attributes\n"
        "soccer_vision_attribute_msgs/Confidence confidence\n"
    ),
    "soccer_vision_3d_msgs/msg/Goalpost": (
        "vision_msgs/BoundingBox3D bb\nsoccer_vision_attribute_msgs/Goalpost attributes\n"
        "soccer_vision_attribute_msgs/Confidence confidence\n"
    ),
    "soccer_vision_3d_msgs/msg/MarkingSegment": (
        "geometry_msgs/Point start\ngeometry_msgs/Point end\nsoccer_vision_attribute_msgs/Confidence confidence\n"
    ),
    **{
        f"soccer_vision_{d}_msgs/msg/{name}": text
        for d in ("2d", "3d")
        for name, text in {
            "GoalpostArray": f"std_msgs/Header header\nsoccer_vision_{d}_msgs/Goalpost[] posts\n",
            "MarkingEllipse": "geometry_msgs/Point center\nsoccer_vision_attribute_msgs/Confidence confidence\n",
            "MarkingIntersection": (
                "geometry_msgs/Point center\nint32 num_rays\nfloat64[] heading_rays\n"
                "soccer_vision_attribute_msgs/Confidence confidence\n"
            ),
            "MarkingArray": "std_msgs/Header header\nMarkingEllipse[] ellipses\n"
            "MarkingIntersection[] intersections\nMarkingSegment[] segments\n",
        }.items()
    },
}


Message = SimpleNamespace
"""An object with attributes; rosbags makes a class of its own for every type."""


@cache
def store(ros1: bool = False, version: int = 4) -> Typestore:
    """rosbags' types, and the soccer and vision types of this version of vision_msgs."""
    out = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST)
    types = {}
    if ros1:
        types.update(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage"))
        types.update(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf/msg/tfMessage"))
    for name, text in ({2: VISION_2, 3: VISION_3, 4: VISION_4}[version] | ARRAYS).items():
        types.update(get_types_from_msg(text, name))
    out.register(types)
    return out


def source(name: str, ros1: bool = False, version: int = 4) -> Source:
    """As a recorder would describe it, its definition written out."""
    text = store(ros1, version).generate_msgdef(name, ros_version=1 if ros1 else 2)[0].encode()
    if ros1:
        return Source("/topic", "ros1", name.replace("/msg/", "/"), "ros1msg", text)
    return Source("/topic", "cdr", name, "ros2msg", text)


def packed(message: object, name: str, ros1: bool = False, version: int = 4, little: bool = True) -> bytes:
    types = store(ros1, version)
    if ros1:
        return bytes(types.serialize_ros1(message, name))
    return bytes(types.serialize_cdr(message, name, little_endian=little))


def message(name: str, fields: Mapping[str, object], ros1: bool = False, version: int = 4) -> Message:
    """A message with these fields, the rest zero and empty; nested messages as mappings."""
    return _made(store(ros1, version), name, fields, np.random.default_rng(0), zero=True)


def random_message(name: str, random: np.random.Generator, ros1: bool = False, version: int = 4) -> Message:
    return _made(store(ros1, version), name, {}, random, zero=False)


def _made(
    types: Typestore, name: str, fields: Mapping[str, object], random: np.random.Generator, zero: bool
) -> Message:
    values = {}
    for field, description in types.fielddefs[name][1]:
        values[field] = _value(types, description, fields.get(field), random, zero)
    assert fields.keys() <= values.keys(), f"{name} has no {fields.keys() - values.keys()}"
    return types.types[name](**values)


def _value(types: Typestore, description: tuple, given: object, random: np.random.Generator, zero: bool) -> object:
    kind, inside = description
    if kind == 1:
        if given is not None:
            return given
        return ("" if inside[0] == "string" else 0) if zero else _random(inside[0], random)
    if kind == 2:
        return _made(types, inside, given or {}, random, zero)
    (element_kind, element), count = inside
    length = count if kind == 3 else len(given) if given is not None else 0 if zero else int(random.integers(0, 4))
    if element_kind == 1 and element[0] != "string":
        numpy_type = np.dtype({"byte": "uint8", "char": "uint8"}.get(element[0], element[0]))
        if given is not None:
            return np.array(given, numpy_type)
        some = [0 if zero else _random(element[0], random) for _ in range(length)]
        return np.array(some, numpy_type)
    each = given if given is not None else [None] * length
    return [_value(types, (element_kind, element), one, random, zero) for one in each]


def _random(kind: str, random: np.random.Generator) -> object:
    if kind == "string":
        return "".join(random.choice(list("abcß/_"), int(random.integers(0, 9))))
    if kind == "bool":
        return bool(random.integers(2))
    if kind.startswith("float"):
        return float(np.float32(random.normal()))
    return int(random.integers(0, 100))
