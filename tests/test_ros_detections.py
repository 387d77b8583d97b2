"""Goal posts and lines, whatever version of the definitions a log was recorded with."""

from collections.abc import Callable

import numpy as np
import pytest
import ros_messages

from logs import ros
from logs.foreign.parts import BadPart, ImageDetectionsPart, SpaceDetectionsPart
from logs.source import Source

VERSIONS = [(2, "cdr"), (3, "cdr"), (4, "cdr"), (2, "ros1"), (4, "ros1")]
HEADER = {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "camera"}


def decoded(
    name: str, fields: dict[str, object], version: int = 4, encoding: str = "cdr", little: bool = True
) -> object:
    ros1 = encoding == "ros1"
    source = ros_messages.source(name, ros1, version)
    decode = ros.decoder(source)
    assert decode is not None
    message = ros_messages.message(name, {"header": HEADER, **fields}, ros1, version)
    part = decode(ros_messages.packed(message, name, ros1, version, little))
    assert type(part) is ros.known_type(source)
    assert isinstance(part, (ImageDetectionsPart, SpaceDetectionsPart))
    assert (part.stamp_ns, part.frame) == (7_000_000_008, "camera")
    return part


def box_2d(u: float, v: float, width: float, height: float, version: int) -> dict[str, object]:
    centre = {"x": u, "y": v} if version < 4 else {"position": {"x": u, "y": v}}
    return {"center": {**centre, "theta": 0.3}, "size_x": width, "size_y": height}


def box_3d(x: float, y: float, z: float) -> dict[str, object]:
    return {"center": {"position": {"x": x, "y": y, "z": z}, "orientation": {"w": 1.0}}, "size": {"x": 9.0}}


def hypothesis(name: str, score: float, version: int) -> dict[str, object]:
    if version == 2:
        return {"id": name, "score": score}
    return {"hypothesis": {"class_id" if version == 4 else "id": name, "score": score}}


@pytest.mark.parametrize(("version", "encoding"), VERSIONS)
@pytest.mark.parametrize("little", [True, False])
def test_goal_posts_in_an_image_are_boxes(version: int, encoding: str, little: bool) -> None:
    posts = [
        {"bb": box_2d(1.5, 2.5, 3.5, 4.5, version), "confidence": {"confidence": 0.75}, "attributes": {"side": 2}},
        {"bb": box_2d(5, 6, 7, 8, version), "confidence": {"confidence": -1.0}},
    ]
    part = decoded("soccer_vision_2d_msgs/msg/GoalpostArray", {"posts": posts}, version, encoding, little)
    assert isinstance(part, ImageDetectionsPart)
    np.testing.assert_array_equal(part.boxes, [[1.5, 2.5, 3.5, 4.5], [5, 6, 7, 8]])
    np.testing.assert_array_equal(part.box_confidences, [0.75, np.nan])
    assert (part.lines.shape, part.line_confidences.shape) == ((0, 2, 2), (0,))


@pytest.mark.parametrize(("version", "encoding"), VERSIONS)
def test_goal_posts_in_space_are_the_middles_of_their_boxes(version: int, encoding: str) -> None:
    posts = [
        {"bb": box_3d(1.5, 2.5, 3.5), "confidence": {"confidence": 0.5}},
        {"bb": box_3d(4, 5, 6), "confidence": {"confidence": -1.0}},
        {"bb": box_3d(7, 8, 9), "confidence": {"confidence": 0.0}},
    ]
    part = decoded("soccer_vision_3d_msgs/msg/GoalpostArray", {"posts": posts}, version, encoding)
    assert isinstance(part, SpaceDetectionsPart)
    np.testing.assert_array_equal(part.posts, [[1.5, 2.5, 3.5], [4, 5, 6], [7, 8, 9]])
    np.testing.assert_array_equal(part.post_confidences, [0.5, np.nan, 0.0])
    assert (part.lines.shape, part.line_confidences.shape) == ((0, 2, 3), (0,))


def markings(segments: list[dict[str, object]]) -> dict[str, object]:
    """Ellipses and crossings stand before the segments and have to be stepped over."""
    return {
        "ellipses": [{"confidence": {"confidence": 1.0}}],
        "intersections": [{"num_rays": 3, "heading_rays": [0.0, 1.0, 2.0]}, {"num_rays": 4}],
        "segments": segments,
    }


@pytest.mark.parametrize(("version", "encoding"), VERSIONS)
def test_lines_in_an_image_have_two_ends(version: int, encoding: str) -> None:
    segments = [
        {"start": {"x": 1.0, "y": 2.0}, "end": {"x": 3.0, "y": 4.0}, "confidence": {"confidence": 0.5}},
        {"start": {"x": 5.0, "y": 6.0}, "end": {"x": 7.0, "y": 8.0}, "confidence": {"confidence": -1.0}},
    ]
    part = decoded("soccer_vision_2d_msgs/msg/MarkingArray", markings(segments), version, encoding)
    assert isinstance(part, ImageDetectionsPart)
    np.testing.assert_array_equal(part.lines, [[[1, 2], [3, 4]], [[5, 6], [7, 8]]])
    np.testing.assert_array_equal(part.line_confidences, [0.5, np.nan])
    assert (part.boxes.shape, part.box_confidences.shape) == ((0, 4), (0,))


@pytest.mark.parametrize(("version", "encoding"), VERSIONS)
def test_lines_in_space_have_two_ends(version: int, encoding: str) -> None:
    ends = {"start": {"x": 1.0, "y": 2.0, "z": 3.0}, "end": {"x": 4.0, "y": 5.0, "z": 6.0}}
    segments = [{**ends, "confidence": {"confidence": 0.25}}]
    part = decoded("soccer_vision_3d_msgs/msg/MarkingArray", markings(segments), version, encoding)
    assert isinstance(part, SpaceDetectionsPart)
    np.testing.assert_array_equal(part.lines, [[[1, 2, 3], [4, 5, 6]]])
    np.testing.assert_array_equal(part.line_confidences, [0.25])
    assert (part.posts.shape, part.post_confidences.shape) == ((0, 3), (0,))


@pytest.mark.parametrize(
    "name",
    [
        *(f"soccer_vision_{d}_msgs/msg/{what}Array" for d in ("2d", "3d") for what in ("Goalpost", "Marking")),
        *(f"vision_msgs/msg/Detection{d}Array" for d in ("2D", "3D")),
    ],
)
def test_nothing_seen_gives_empty_arrays(name: str) -> None:
    part = decoded(name, {})
    if isinstance(part, ImageDetectionsPart):
        assert (part.boxes.shape, part.box_confidences.shape) == ((0, 4), (0,))
        assert (part.lines.shape, part.line_confidences.shape) == ((0, 2, 2), (0,))
    else:
        assert isinstance(part, SpaceDetectionsPart)
        assert (part.posts.shape, part.post_confidences.shape) == ((0, 3), (0,))
        assert (part.lines.shape, part.line_confidences.shape) == ((0, 2, 3), (0,))


def seen(version: int, box: Callable[[float], object]) -> dict[str, object]:
    """Of six detections the second, fourth and fifth are goal posts."""
    names: list[list[tuple[str, float]]] = [
        [("ball", 0.9)],
        [("robot", 0.2), ("GoalPost", 0.8), ("ball", 0.1)],
        [("goal_post", 0.3), ("robot", 0.6)],
        [("left Post", 0.5)],
        [("goal_post", 0.4)],
        [],
    ]
    return {
        "detections": [
            {"results": [hypothesis(name, score, version) for name, score in each], "bbox": box(float(number))}
            for number, each in enumerate(names)
        ]
    }


@pytest.mark.parametrize(("version", "encoding"), VERSIONS)
def test_detections_in_an_image_that_are_most_probably_goal_posts_are_boxes(version: int, encoding: str) -> None:
    fields = seen(version, lambda number: box_2d(number, 2, 3, 4, version))
    part = decoded("vision_msgs/msg/Detection2DArray", fields, version, encoding)
    assert isinstance(part, ImageDetectionsPart)
    np.testing.assert_array_equal(part.boxes, [[1, 2, 3, 4], [3, 2, 3, 4], [4, 2, 3, 4]])
    np.testing.assert_array_equal(part.box_confidences, [0.8, 0.5, 0.4])


@pytest.mark.parametrize(("version", "encoding"), VERSIONS)
def test_detections_in_space_that_are_most_probably_goal_posts_are_points(version: int, encoding: str) -> None:
    fields = seen(version, lambda number: box_3d(number, 2, 3))
    part = decoded("vision_msgs/msg/Detection3DArray", fields, version, encoding)
    assert isinstance(part, SpaceDetectionsPart)
    np.testing.assert_array_equal(part.posts, [[1, 2, 3], [3, 2, 3], [4, 2, 3]])
    np.testing.assert_array_equal(part.post_confidences, [0.8, 0.5, 0.4])


def with_other_text(name: str, old: bytes, new: bytes) -> Source:
    source = ros_messages.source(name)
    assert source.schema_data.count(old) == 1
    return Source(source.topic, "cdr", name, "ros2msg", source.schema_data.replace(old, new))


def test_the_numbered_classes_of_old_detectors_are_no_goal_posts() -> None:
    name = "vision_msgs/msg/Detection2DArray"
    decode = ros.decoder(with_other_text(name, b"string class_id", b"int64 id"))
    assert decode is not None
    data = b"\0\1\0\0" + bytes(12) + bytes(4)
    part = decode(data)
    assert isinstance(part, ImageDetectionsPart)
    assert part.boxes.shape == (0, 4)


def test_a_confidence_that_is_a_plain_number_is_read_too() -> None:
    """As it was in the first versions of soccer_interfaces."""
    name = "soccer_vision_3d_msgs/msg/GoalpostArray"
    one = ros_messages.message(name, {"posts": [{"bb": box_3d(1, 2, 3), "confidence": {"confidence": 0.5}}]})
    decode = ros.decoder(
        with_other_text(name, b"soccer_vision_attribute_msgs/Confidence confidence", b"float32 confidence -1")
    )
    assert decode is not None
    part = decode(ros_messages.packed(one, name))  # a message around a number is on the wire as the number is
    assert isinstance(part, SpaceDetectionsPart)
    np.testing.assert_array_equal(part.post_confidences, [0.5])


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b"geometry_msgs/Pose center", b"geometry_msgs/Pose middle", "no number posts.bb.center.position.x"),
        (b"Goalpost[] posts", b"Goalpost[] goalposts", "no field posts"),
        (b"float32 confidence", b"string confidence", "no number posts.confidence.confidence"),
        (b"float32 confidence", b"wstring confidence", "wstring"),
        (b"float32 confidence", b"float3.2 confidence", "defines no field"),
        (b"MSG: soccer_vision_attribute_msgs/Confidence", b"MSG: soccer/Confidence", "Confidence is missing"),
        (b"MSG: soccer_vision_attribute_msgs/Confidence", b"Confidence", "section without a name"),
        (b"Goalpost[] posts", b"GoalpostArray again", "nested too deeply"),
    ],
)
def test_a_definition_without_what_its_name_promises_makes_every_message_bad(
    old: bytes, new: bytes, reason: str
) -> None:
    name = "soccer_vision_3d_msgs/msg/GoalpostArray"
    source = with_other_text(name, old, new)
    assert ros.known_type(source) is SpaceDetectionsPart
    decode = ros.decoder(source)
    assert decode is not None
    with pytest.raises(BadPart, match=rf"^soccer_vision_3d_msgs/GoalpostArray: .*{reason}"):
        decode(ros_messages.packed(ros_messages.message(name, {}), name))
