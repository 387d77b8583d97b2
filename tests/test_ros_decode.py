"""What logs.ros makes of messages, against rosbags, which unpacks all of a message into objects of its own."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
import ros_messages
from ros_messages import Message
from rosbags.typesys import Stores, get_typestore

from fieldloc.pose import FloatArray
from logs import ros
from logs.foreign.parts import (
    BadPart,
    CameraPart,
    ImagePart,
    ImuPart,
    JointsPart,
    MagneticPart,
    OdometryPart,
    PosePart,
    Transforms,
    TwistPart,
)
from logs.ros.types import KNOWN
from logs.source import Source

STANDARD = [
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/MagneticField",
    "tf2_msgs/msg/TFMessage",
]
WIRES = ["little", "big", "ros1"]


def xyz(thing: Message) -> list[float]:
    return [thing.x, thing.y, thing.z]


def xyzw(thing: Message) -> list[float]:
    return [thing.x, thing.y, thing.z, thing.w]


def stamp_ns(header: Message) -> int:
    return int(header.stamp.sec * 10**9 + header.stamp.nanosec)


def same(ours: FloatArray | None, theirs: npt.ArrayLike) -> None:
    assert ours is not None
    assert ours.dtype == np.float64
    np.testing.assert_array_equal(ours, np.asarray(theirs, dtype=np.float64).reshape(ours.shape))


def check_pose(part: PosePart, header: Message, pose: Message, covariance: FloatArray | None = None) -> None:
    assert (part.stamp_ns, part.frame) == (stamp_ns(header), header.frame_id)
    same(part.position, xyz(pose.position))
    same(part.rotation, xyzw(pose.orientation))
    assert (part.covariance is None) == (covariance is None)
    if covariance is not None:
        same(part.covariance, covariance)


def check_twist(part: TwistPart, twist: Message) -> None:
    same(part.linear, xyz(twist.linear))
    same(part.angular, xyz(twist.angular))


def check_transforms(part: Transforms, theirs: list[Message]) -> None:
    assert len(part.transforms) == len(theirs)
    for ours, other in zip(part.transforms, theirs, strict=True):
        assert (ours.stamp_ns, ours.parent, ours.child) == (
            stamp_ns(other.header),
            other.header.frame_id,
            other.child_frame_id,
        )
        same(ours.translation, xyz(other.transform.translation))
        same(ours.rotation, xyzw(other.transform.rotation))


def check(part: object, m: Message) -> None:
    """part is what this message of rosbags' says."""
    match part:
        case OdometryPart(pose=pose, twist=twist):
            check_pose(pose, m.header, m.pose.pose, m.pose.covariance)
            assert (twist.stamp_ns, twist.frame) == (stamp_ns(m.header), m.child_frame_id)
            check_twist(twist, m.twist.twist)
            same(twist.covariance, m.twist.covariance)
        case PosePart():
            with_covariance = hasattr(m.pose, "covariance")
            pose, covariance = (m.pose.pose, m.pose.covariance) if with_covariance else (m.pose, None)
            check_pose(part, m.header, pose, covariance)
        case TwistPart(stamp_ns=None):
            assert part.frame == ""
            check_twist(part, m)
        case TwistPart():
            assert (part.stamp_ns, part.frame) == (stamp_ns(m.header), m.header.frame_id)
            check_twist(part, m.twist)
        case Transforms():
            check_transforms(part, m.transforms if hasattr(m, "transforms") else [m])
        case ImuPart():
            assert (part.stamp_ns, part.frame) == (stamp_ns(m.header), m.header.frame_id)
            same(part.rotation, xyzw(m.orientation))
            same(part.angular_velocity, xyz(m.angular_velocity))
            same(part.acceleration, xyz(m.linear_acceleration))
        case MagneticPart():
            assert (part.stamp_ns, part.frame) == (stamp_ns(m.header), m.header.frame_id)
            same(part.field, xyz(m.magnetic_field))
        case JointsPart():
            assert (part.stamp_ns, list(part.names)) == (stamp_ns(m.header), m.name)
            same(part.positions, m.position)
        case CameraPart():
            assert (part.stamp_ns, part.frame) == (stamp_ns(m.header), m.header.frame_id)
            assert (part.width_px, part.height_px) == (m.width, m.height)
            assert part.distortion_model == m.distortion_model
            same(part.matrix, m.K if hasattr(m, "K") else m.k)
            same(part.distortion, m.D if hasattr(m, "D") else m.d)
        case ImagePart():
            assert (part.stamp_ns, part.frame) == (stamp_ns(m.header), m.header.frame_id)
            assert part.data == bytes(m.data)
            if hasattr(m, "encoding"):
                assert (part.format, part.width_px, part.height_px, part.step) == (
                    m.encoding,
                    m.width,
                    m.height,
                    m.step,
                )
        case _:
            raise AssertionError(part)


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("name", STANDARD)
def test_every_value_is_the_one_that_rosbags_reads(name: str, wire: str) -> None:
    ros1 = wire == "ros1"
    source = ros_messages.source(name, ros1)
    decode = ros.decoder(source)
    assert decode is not None
    random = np.random.default_rng(1)
    for _ in range(30):
        message = ros_messages.random_message(name, random, ros1)
        part = decode(ros_messages.packed(message, name, ros1, little=wire != "big"))
        assert type(part) is ros.known_type(source)
        check(part, message)


@pytest.mark.parametrize("name", STANDARD)
def test_standard_types_need_no_definition_in_the_file(name: str) -> None:
    for ros1 in (False, True):
        decode = ros.decoder(Source("/topic", "ros1" if ros1 else "cdr", name))
        assert decode is not None
        message = ros_messages.random_message(name, np.random.default_rng(2), ros1)
        check(decode(ros_messages.packed(message, name, ros1)), message)


def test_the_first_transforms_of_ros_1_are_read_too() -> None:
    name = "tf/msg/tfMessage"
    message = ros_messages.random_message(name, np.random.default_rng(3), ros1=True)
    data = ros_messages.packed(message, name, ros1=True)
    for source in (ros_messages.source(name, ros1=True), Source("/tf", "ros1", "tf/tfMessage")):
        assert ros.known_type(source) is Transforms
        decode = ros.decoder(source)
        assert decode is not None
        check(decode(data), message)


@pytest.mark.parametrize("name", ["nav_msgs/msg/Odometry", "nav_msgs/Odometry"])
def test_a_type_is_known_by_both_spellings_of_its_name(name: str) -> None:
    written = ros_messages.source("nav_msgs/msg/Odometry")
    source = Source("/odom", "cdr", name, "ros2msg", written.schema_data)
    assert ros.known_type(source) is OdometryPart
    assert ros.decoder(source) is not None


@pytest.mark.parametrize(
    "source",
    [
        Source("/topic", "cdr", "std_msgs/msg/String", "ros2msg", b"string data"),
        Source("/topic", "json", "nav_msgs/msg/Odometry", "ros2msg", b"x"),
        Source("/topic", "protobuf", "foxglove.PoseInFrame", "protobuf", b"x"),
        Source("/topic", "cdr", "nav_msgs/msg/Odometry", "omgidl", b"x"),
        Source("/topic", "ros1", "nav_msgs/Odometry", "ros2msg", b"x"),
        Source("/topic", "wrong_format", "nav_msgs/msg/Odometry", "ros2msg", b"x"),
        Source("/topic", "cdr", "soccer_vision_3d_msgs/msg/BallArray", "ros2msg", b"x"),
        Source("/topic", "cdr", "soccer_vision_3d_msgs/msg/FieldBoundary", "ros2msg", b"x"),
        Source("/topic", "cdr", "soccer_vision_2d_msgs/msg/RobotArray", "ros2msg", b"x"),
        Source("/topic", "cdr", "vision_msgs/msg/Detection2DArray"),
        Source("/topic", "cdr", ""),
        Source("/topic", ""),
    ],
)
def test_what_is_not_ros_or_no_part_is_none(source: Source) -> None:
    assert ros.known_type(source) is None
    assert ros.decoder(source) is None


def test_both_tables_have_the_same_types() -> None:
    from logs.ros.decode import _TYPES

    assert _TYPES.keys() == KNOWN.keys()


def odometry(**fields: object) -> bytes:
    return ros_messages.packed(ros_messages.message("nav_msgs/msg/Odometry", fields), "nav_msgs/msg/Odometry")


def decoded_odometry(data: bytes) -> OdometryPart:
    decode = ros.decoder(ros_messages.source("nav_msgs/msg/Odometry"))
    assert decode is not None
    part = decode(data)
    assert isinstance(part, OdometryPart)
    return part


@pytest.mark.parametrize("unknown", [np.zeros(36), np.full(36, np.nan), np.where(np.arange(36) == 7, np.nan, 1.0)])
def test_a_covariance_of_zeros_or_with_nan_is_none(unknown: FloatArray) -> None:
    known = np.eye(6).ravel() * 1e-6
    part = decoded_odometry(odometry(pose={"covariance": unknown}, twist={"covariance": known}))
    assert part.pose.covariance is None
    same(part.twist.covariance, known)
    part = decoded_odometry(odometry(pose={"covariance": known}, twist={"covariance": unknown}))
    same(part.pose.covariance, known)
    assert part.twist.covariance is None


@pytest.mark.parametrize("quantity", ["orientation", "angular_velocity", "linear_acceleration"])
def test_a_quantity_that_an_imu_does_not_measure_is_none(quantity: str) -> None:
    name = "sensor_msgs/msg/Imu"
    decode = ros.decoder(ros_messages.source(name))
    assert decode is not None
    missing = {f"{quantity}_covariance": [-1.0] + [0.0] * 8}
    part = decode(ros_messages.packed(ros_messages.message(name, missing), name))
    assert isinstance(part, ImuPart)
    found = {
        "orientation": part.rotation,
        "angular_velocity": part.angular_velocity,
        "linear_acceleration": part.acceleration,
    }
    assert {key for key, value in found.items() if value is None} == {quantity}


@pytest.mark.parametrize(
    ("written", "compression"),
    [("jpeg", "jpeg"), ("png", "png"), ("rgb8; jpeg compressed bgr8", "jpeg"), ("JPG", "jpeg"), ("", "")],
)
def test_a_compressed_image_says_how_its_bytes_are_compressed(written: str, compression: str) -> None:
    name = "sensor_msgs/msg/CompressedImage"
    decode = ros.decoder(ros_messages.source(name))
    assert decode is not None
    part = decode(ros_messages.packed(ros_messages.message(name, {"format": written, "data": [1, 2]}), name))
    assert isinstance(part, ImagePart)
    assert (part.format, part.data) == (compression, b"\1\2")


def test_times_before_1970_are_negative() -> None:
    part = decoded_odometry(odometry(header={"stamp": {"sec": -1, "nanosec": 5}}))
    assert part.pose.stamp_ns == -(10**9) + 5


def test_padding_up_to_a_multiple_of_four_and_inside_of_strings_is_no_mistake() -> None:
    data = odometry(header={"frame_id": "odom"})
    for padding in (b"\0", b"\0\0", b"\0\0\0"):
        assert decoded_odometry(data + padding).pose.frame == "odom"
    with pytest.raises(BadPart, match="do not fit"):
        decoded_odometry(data + b"\0\0\0\0")
    assert data.count(b"\5\0\0\0odom\0\0\0\0") == 1
    for length in (b"\6", b"\7", b"\x08"):  # more than one closing zero
        part = decoded_odometry(data.replace(b"\5\0\0\0odom", length + b"\0\0\0odom"))
        assert part.pose.frame == "odom"


def test_a_string_that_does_not_end_is_bad() -> None:
    data = odometry(header={"frame_id": "abc"})
    with pytest.raises(BadPart, match="do not fit"):
        decoded_odometry(data.replace(b"\4\0\0\0abc\0", b"\4\0\0\0abcd"))


def test_a_string_of_no_bytes_at_all_is_empty() -> None:
    name = "sensor_msgs/msg/CompressedImage"
    decode = ros.decoder(ros_messages.source(name))
    assert decode is not None
    part = decode(b"\0\1\0\0" + bytes(8) + bytes(4) + bytes(4) + bytes(4))
    assert part == ImagePart(0, "", "", b"")


def test_a_message_of_ros_1_ends_where_its_definition_does() -> None:
    name = "sensor_msgs/msg/Imu"
    data = ros_messages.packed(ros_messages.message(name, {}, ros1=True), name, ros1=True)
    decode = ros.decoder(ros_messages.source(name, ros1=True))
    assert decode is not None
    decode(data)
    with pytest.raises(BadPart, match="do not fit"):
        decode(data + b"\0")


@pytest.mark.parametrize("ros1", [False, True])
def test_a_bare_header_is_the_standard_one_unless_the_package_has_its_own(ros1: bool) -> None:
    name = "geometry_msgs/msg/TwistStamped"
    written = ros_messages.source(name, ros1)
    bare = written.schema_data.replace(b"std_msgs/Header header", b"Header header", 1)
    assert bare != written.schema_data
    message = ros_messages.random_message(name, np.random.default_rng(9), ros1)
    data = ros_messages.packed(message, name, ros1)
    decode = ros.decoder(replace(written, schema_data=bare))
    assert decode is not None
    check(decode(data), message)
    own = bare + b"=" * 80 + b"\nMSG: geometry_msgs/Header\nfloat64 stamp\nstring frame_id\n"
    decode = ros.decoder(replace(written, schema_data=own))
    assert decode is not None
    with pytest.raises(BadPart, match=r"no field header\.stamp"):
        decode(data)


@pytest.mark.parametrize("kind", [b"\0\3", b"\0\2", b"\0\7", b"\1\0", b"", b"\0"])
def test_other_encapsulations_are_refused_by_name(kind: bytes) -> None:
    with pytest.raises(BadPart, match="not as plain CDR"):
        decoded_odometry(kind + odometry()[2:] if len(kind) == 2 else kind)


def test_comments_defaults_constants_and_carriage_returns_are_no_fields() -> None:
    text = (
        "# a comment = with an equals sign\r\n\r\nuint8 LEFT=1 # not a field\r\nstring NAME=a # b\r\n"
        "  builtin_interfaces/Time  stamp   # no header\r\n"
        'float64[9] unused\r\nstring<=5 short "x"\r\nint32[<=3] few\r\nint32[] many [1, 2]\r\n'
    )
    from logs.ros.definitions import SEQUENCE, Field, definitions

    found = definitions(Source("/t", "cdr", "a/msg/B", "ros2msg", text.encode()))
    assert found.fields("a/B") == (
        Field("stamp", "builtin_interfaces/Time"),
        Field("unused", "float64", 9),
        Field("short", "string"),
        Field("few", "int32", SEQUENCE),
        Field("many", "int32", SEQUENCE),
    )


@pytest.mark.parametrize("name", STANDARD)
def test_a_definition_in_idl_says_the_same(name: str) -> None:
    message = ros_messages.random_message(name, np.random.default_rng(4))
    source = Source("/topic", "cdr", name, "ros2idl", idl(name).encode())
    decode = ros.decoder(source)
    assert decode is not None
    check(decode(ros_messages.packed(message, name)), message)


def idl(name: str) -> str:
    """As rosbag2 writes the IDL of a type and of all it is made of."""
    fields = get_typestore(Stores.LATEST).fielddefs
    names, out = [name], []
    for each in names:
        package, _, short = each.split("/")
        lines = []
        for field, description in fields[each][1]:
            kind, inside = description
            element, count = inside if kind > 2 else (description, 0)
            if element[0] == 2 and element[1] not in names:
                names.append(element[1])
            word = {"float64": "double", "float32": "float", "bool": "boolean"}
            plain = element[1].replace("/", "::") if element[0] == 2 else word.get(element[1][0], element[1][0])
            if kind == 3:
                lines.append(f"typedef {plain} {short}_{field}[{count}];")
                plain = f"{short}_{field}"
            lines.append(f"FIELD {'sequence<' + plain + '>' if kind == 4 else plain} {field};")
        typedefs = "\n".join(line for line in lines if not line.startswith("FIELD"))
        members = "\n".join(line[6:] for line in lines if line.startswith("FIELD"))
        body = f"{typedefs}\nstruct {short} {{\n{members}\n}};"
        out.append(f"{'=' * 80}\nIDL: {each}\nmodule {package} {{ module msg {{\n{body}\n}}; }};\n")
    return "".join(out)


def test_known_types_are_told_without_rosbags() -> None:
    code = (
        "import sys; from logs import ros; from logs.source import Source;"
        "assert ros.known_type(Source('/t', 'cdr', 'nav_msgs/msg/Odometry')) is not None;"
        "assert not [name for name in sys.modules if name.split('.')[0] in ('rosbags', 'sqlite3', 'zstandard')]"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_definition_in_the_file_is_read_without_rosbags() -> None:
    text = ros_messages.source("nav_msgs/msg/Odometry").schema_data
    code = (
        "import sys; from logs import ros; from logs.source import Source;"
        f"ros.decoder(Source('/t', 'cdr', 'nav_msgs/msg/Odometry', 'ros2msg', {text!r}));"
        "assert not [name for name in sys.modules if name.split('.')[0] == 'rosbags']"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
