import json
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from foxglove.messages import (
    CameraCalibration,
    CompressedImage,
    CompressedVideo,
    FrameTransform,
    FrameTransforms,
    JointState,
    JointStates,
    LaserScan,
    Odometry,
    Pose,
    PoseInFrame,
    Quaternion,
    RawImage,
    Timestamp,
    Vector3,
)
from foxglove_wire import as_json, of_published, of_sdk, published
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from hypothesis import given, settings
from hypothesis import strategies as st
from log_records import same

from logs.foreign.parts import (
    BadPart,
    CameraPart,
    ImagePart,
    JointsPart,
    OdometryPart,
    PosePart,
    Transform,
    Transforms,
    TwistPart,
    VideoPart,
)
from logs.foxglove import decoder, known_type
from logs.foxglove.kinds import KINDS
from logs.source import Source

ROOT = Path(__file__).parents[1]
TIME = Timestamp(sec=1_700_000_000, nsec=123_456_789)
STAMP_NS = 1_700_000_000_123_456_789
POSE = Pose(position=Vector3(x=1.0, y=-2.0, z=0.5), orientation=Quaternion(x=0.1, y=0.2, z=0.3, w=0.9))
POSITION, ROTATION = np.array([1.0, -2.0, 0.5]), np.array([0.1, 0.2, 0.3, 0.9])
MATRIX = np.arange(1.0, 10.0).reshape(3, 3)
COVARIANCE = np.arange(36.0).reshape(6, 6)

MOVED = FrameTransform(
    timestamp=TIME,
    parent_frame_id="odom",
    child_frame_id="base",
    translation=Vector3(x=1.0, y=-2.0, z=0.5),
    rotation=Quaternion(x=0.1, y=0.2, z=0.3, w=0.9),
)
MOVED_PART = Transform(STAMP_NS, "odom", "base", POSITION, ROTATION)
PAIRS = {
    "compressed image": (
        CompressedImage(timestamp=TIME, frame_id="camera", data=b"\xff\xd8\x00", format="jpeg"),
        ImagePart(STAMP_NS, "camera", "jpeg", b"\xff\xd8\x00"),
    ),
    "raw image": (
        RawImage(timestamp=TIME, frame_id="camera", width=2, height=1, encoding="rgb8", step=8, data=bytes(8)),
        ImagePart(STAMP_NS, "camera", "rgb8", bytes(8), 2, 1, 8),
    ),
    "video": (
        CompressedVideo(timestamp=TIME, frame_id="camera", data=b"\x00\x00\x01", format="h264"),
        VideoPart(STAMP_NS, "camera", "h264"),
    ),
    "calibration": (
        CameraCalibration(
            timestamp=TIME,
            frame_id="camera",
            width=640,
            height=480,
            distortion_model="plumb_bob",
            D=[0.1, -0.2, 0.0, 0.0, 0.3],
            K=MATRIX.ravel().tolist(),
            R=np.eye(3).ravel().tolist(),
            P=np.eye(3, 4).ravel().tolist(),
        ),
        CameraPart(STAMP_NS, "camera", 640, 480, MATRIX, "plumb_bob", np.array([0.1, -0.2, 0.0, 0.0, 0.3])),
    ),
    "transform": (MOVED, Transforms((MOVED_PART,))),
    "transforms": (FrameTransforms(transforms=[MOVED, MOVED]), Transforms((MOVED_PART, MOVED_PART))),
    "no transforms": (FrameTransforms(), Transforms(())),
    "transform that says little": (
        FrameTransform(parent_frame_id="a", child_frame_id="b"),
        Transforms((Transform(0, "a", "b", np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])),)),
    ),
    "pose": (
        PoseInFrame(timestamp=TIME, frame_id="map", pose=POSE),
        PosePart(STAMP_NS, "map", POSITION, ROTATION),
    ),
    "pose without a time": (PoseInFrame(frame_id="map", pose=POSE), PosePart(None, "map", POSITION, ROTATION)),
    "odometry": (
        Odometry(
            timestamp=TIME,
            frame_id="odom",
            body_frame_id="base",
            pose=POSE,
            linear_velocity=Vector3(x=0.3, y=-0.1),
            angular_velocity=Vector3(z=0.7),
            pose_covariance=COVARIANCE.ravel().tolist(),
            velocity_covariance=[0.0] * 36,
        ),
        OdometryPart(
            PosePart(STAMP_NS, "odom", POSITION, ROTATION, COVARIANCE),
            TwistPart(STAMP_NS, "base", np.array([0.3, -0.1, 0.0]), np.array([0.0, 0.0, 0.7])),
        ),
    ),
    "odometry without a velocity": (
        Odometry(timestamp=TIME, frame_id="odom", body_frame_id="base", pose=POSE),
        OdometryPart(
            PosePart(STAMP_NS, "odom", POSITION, ROTATION),
            TwistPart(STAMP_NS, "base", np.full(3, np.nan), np.full(3, np.nan)),
        ),
    ),
    "joints": (
        JointStates(timestamp=TIME, joints=[JointState(name="pan", position=0.5), JointState(name="tilt", effort=1.0)]),
        JointsPart(STAMP_NS, ("pan", "tilt"), np.array([0.5, np.nan])),
    ),
}
POSE_SOURCE, POSE_DATA = of_sdk(PAIRS["pose"][0])


@pytest.mark.parametrize("name", PAIRS)
def test_a_message_of_the_sdk_becomes_its_part(name):
    message, part = PAIRS[name]
    source, data = of_sdk(message)
    assert known_type(source) is type(part)
    assert same(decoder(source)(data), part)


@pytest.mark.parametrize("name", PAIRS)
def test_json_says_the_same_as_protobuf(name):
    message, part = PAIRS[name]
    source, data = as_json(*of_sdk(message))
    assert known_type(source) is type(part)
    assert same(decoder(source)(data), part)


def test_each_type_that_is_known_is_tried_above():
    assert {message.get_schema().name for message, _ in PAIRS.values()} == set(KINDS)


def test_messages_by_the_published_descriptors_are_read_too():
    kind = published("PoseInFrame")
    source, data = of_published(kind.FromString(POSE_DATA))
    assert same(decoder(source)(data), PAIRS["pose"][1])


def test_a_time_may_be_spelled_as_ros_2_does():
    source, data = as_json(POSE_SOURCE, POSE_DATA)
    part = decoder(source)(data.replace(b'"nsec"', b'"nanosec"'))
    assert part.stamp_ns == STAMP_NS


@pytest.mark.parametrize(
    "source",
    [
        of_sdk(LaserScan())[0],
        Source("/x", "protobuf", "foxglove.PoseInFrame", "", b""),
        Source("/x", "json", "foxglove.PoseInFrame", "protobuf", b""),
        Source("/x", "cdr", "foxglove_msgs/msg/PoseInFrame", "ros2msg", b""),
        Source("/x", "flatbuffer", "foxglove.PoseInFrame", "flatbuffer", b""),
        Source("/x", "protobuf", "PoseInFrame", "protobuf", b""),
    ],
)
def test_what_is_not_ours_has_no_decoder(source):
    assert known_type(source) is None
    assert decoder(source) is None


def descriptors(field_name, number, message="PoseInFrame"):
    """A file of the usual name that describes the message with one field, a string."""
    file = FileDescriptorProto(name="foxglove/PoseInFrame.proto", package="foxglove", syntax="proto3")
    kind = FieldDescriptorProto.TYPE_STRING
    file.message_type.add(name=message).field.add(name=field_name, number=number, type=kind, label=1)
    return FileDescriptorSet(file=[file]).SerializeToString()


def test_two_files_may_describe_the_same_name_differently():
    own = [Source("/x", "protobuf", "foxglove.CompressedImage", "protobuf", image_schema(n)) for n in (3, 7)]
    for source, number in zip(own, (3, 7), strict=True):
        assert decoder(source)(bytes([number << 3 | 2, 2]) + b"ab" + bytes([1 << 3 | 2, 0])).data == b"ab"
    assert same(decoder(POSE_SOURCE)(POSE_DATA), PAIRS["pose"][1])


def image_schema(data_number):
    """foxglove.CompressedImage in a file of its usual name, with `data` under another number."""
    schema = FileDescriptorSet.FromString(CompressedImage.get_schema().data)
    for file in schema.file:
        for message in file.message_type:
            for field in message.field:
                if field.name == "data":
                    field.number = data_number
                elif field.number == data_number:
                    field.number = 100
    return schema.SerializeToString()


@pytest.mark.parametrize(
    "schema",
    [
        b"",
        b"\xff\xff\xff",
        descriptors("pose", 1, message="SomethingElse"),
        descriptors("position", 1),
        descriptors("pose", 1),
        FileDescriptorSet(
            file=[FileDescriptorProto(name="a", dependency=["b"]), FileDescriptorProto(name="b", dependency=["a"])]
        ).SerializeToString(),
        FileDescriptorSet(file=[FileDescriptorProto(name="a", dependency=["nowhere"])]).SerializeToString(),
    ],
)
def test_a_schema_that_does_not_describe_its_message_makes_bad_parts(schema):
    decode = decoder(Source("/x", "protobuf", "foxglove.PoseInFrame", "protobuf", schema))
    with pytest.raises(BadPart):
        decode(b"")
    with pytest.raises(BadPart):
        decode(POSE_DATA)


JSON_POSE = json.loads(as_json(POSE_SOURCE, POSE_DATA)[1])
BROKEN = {
    "no object": b"[1]",
    "no JSON": b"{",
    "deep": b"[" * 100_000,
    "no pose": b"{}",
    "a text for a pose": json.dumps(JSON_POSE | {"pose": "here"}).encode(),
    "a text for a number": json.dumps(JSON_POSE | {"pose": {"position": {"x": "1"}}}).encode(),
    "a truth for a number": json.dumps(JSON_POSE | {"pose": {"position": {"x": True}}}).encode(),
    "a number that no double holds": b'{"pose": {"position": {"x": ' + b"9" * 400 + b"}}}",
    "a number for a frame": json.dumps(JSON_POSE | {"frame_id": 3}).encode(),
    "a time in the wrong form": json.dumps(JSON_POSE | {"timestamp": "2024-01-01T00:00:00Z"}).encode(),
    "a time in fractions": json.dumps(JSON_POSE | {"timestamp": {"sec": 1.5, "nsec": 0}}).encode(),
    "too many nanoseconds": json.dumps(JSON_POSE | {"timestamp": {"sec": 1, "nsec": 10**9}}).encode(),
    "a time beyond all": json.dumps(JSON_POSE | {"timestamp": {"sec": 10**10, "nsec": 0}}).encode(),
}


@pytest.mark.parametrize("data", BROKEN.values(), ids=BROKEN.keys())
def test_json_that_is_no_pose_is_a_bad_part(data):
    decode = decoder(Source("/x", "json", "foxglove.PoseInFrame", "jsonschema", b"{}"))
    with pytest.raises(BadPart):
        decode(data)


@pytest.mark.parametrize("data", ["=", "a", "ü", "ab c", 5])
def test_bytes_that_are_no_base64_are_a_bad_part(data):
    decode = decoder(Source("/x", "json", "foxglove.CompressedImage", "jsonschema", b"{}"))
    with pytest.raises(BadPart):
        decode(json.dumps({"timestamp": {"sec": 1, "nsec": 2}, "data": data}).encode())


@pytest.mark.parametrize(
    "message",
    [
        CompressedImage(data=b"x", format="png"),
        CameraCalibration(timestamp=TIME, K=[1.0] * 8),
        Odometry(timestamp=TIME, pose=POSE, pose_covariance=[1.0] * 9),
        PoseInFrame(timestamp=TIME),
    ],
)
def test_a_message_without_what_it_is_for_is_a_bad_part(message):
    source, data = of_sdk(message)
    with pytest.raises(BadPart):
        decoder(source)(data)
    source, data = as_json(source, data)
    with pytest.raises(BadPart):
        decoder(source)(data)


DECODERS = {name: (decoder(of_sdk(message)[0]), of_sdk(message)[1]) for name, (message, _) in PAIRS.items()}


@given(name=st.sampled_from(list(PAIRS)), data=st.binary(max_size=64), at=st.integers(0, 10**6))
@settings(deadline=None, max_examples=500)
def test_bytes_of_any_kind_give_a_part_or_a_bad_part(name, data, at):
    decode, whole = DECODERS[name]
    at %= len(whole) + 1
    for tried in (data, whole[:at], whole[:at] + data + whole[at:]):
        with suppress(BadPart):
            assert isinstance(decode(tried), KINDS[PAIRS[name][0].get_schema().name].part)


KEYS = st.sampled_from(["timestamp", "sec", "nsec", "pose", "position", "x", "data", "K", "D", "joints", "transforms"])
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=5),
)


@given(schema=st.sampled_from(list(KINDS)), values=st.dictionaries(KEYS, VALUES))
@settings(deadline=None, max_examples=100)
def test_json_of_any_kind_gives_a_part_or_a_bad_part(schema, values):
    decode = decoder(Source("/x", "json", schema, "jsonschema", b"{}"))
    with suppress(BadPart):
        assert isinstance(decode(json.dumps(values).encode()), KINDS[schema].part)


def test_nothing_heavy_is_imported_before_it_is_needed():
    code = (
        "import sys\n"
        "from logs.foxglove import decoder, known_type\n"
        "from logs.source import Source\n"
        "import logs.estimates\n"
        "source = Source('/x', 'json', 'foxglove.PoseInFrame', 'jsonschema', b'{}')\n"
        "assert known_type(source) and decoder(source)\n"
        "print(sorted({'foxglove', 'google.protobuf', 'rosbags'} & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
