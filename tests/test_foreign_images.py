import numpy as np
import pytest
from foreign_parts import CAMERA, about, ns, surroundings, transform
from scipy.spatial.transform import Rotation

from fieldloc.ground import project_points, robot_from_camera
from fieldloc.measurements import CameraMount
from logs.foreign.images import ImageAdapter, posts_of_boxes
from logs.foreign.parts import ImageDetectionsPart, SpaceDetectionsPart
from logs.foreign.settings import DetectionNoise, LogMapping, MountSettings
from logs.foreign.surroundings import Unusable

MOUNT = CameraMount(0.55, 0.2, 0.3, 0.08, np.diag([0.01, 0.01, 0.01, 0.01]) ** 2, 0.05, 0.0)
LEVEL = CameraMount(0.55, 0.0, 0.0, 0.0, MOUNT.covariance)
NOTHING = np.zeros(0)


def image(stamp_s=0.0, boxes=(), lines=(), confidences=None, frame="camera_optical_frame"):
    boxes = np.array(boxes, dtype=float).reshape(-1, 4)
    lines = np.array(lines, dtype=float).reshape(-1, 2, 2)
    some = np.full(len(boxes) + len(lines), np.nan if confidences is None else confidences)
    return ImageDetectionsPart(ns(stamp_s), frame, boxes, some[: len(boxes)], lines, some[len(boxes) :])


def space(stamp_s=0.0, lines=(), frame="base_footprint", confidence=np.nan):
    lines = np.array(lines, dtype=float).reshape(-1, 2, 3)
    return SpaceDetectionsPart(ns(stamp_s), frame, np.zeros((0, 3)), NOTHING, lines, np.full(len(lines), confidence))


def around(mount=MOUNT, **options):
    rotation = Rotation.from_matrix(robot_from_camera(mount))
    camera = transform("base_footprint", "camera_optical_frame", [mount.x_m, mount.y_m, mount.height_m], rotation)
    return surroundings(camera, **options)


def box_around(mount, x, y, radius=0.05, height=1.1):
    """Upright box (u, v, width, height) of a post on the ground, not cut off by the image."""
    turn = np.linspace(0, 2 * np.pi, 200)
    ring = np.stack([x + radius * np.cos(turn), y + radius * np.sin(turn)], axis=-1)
    points = np.concatenate([np.column_stack([ring, np.full(200, z)]) for z in (0.0, height)])
    pixels, _ = project_points(CAMERA, mount, points)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return [*((low + high) / 2), *(high - low)]


# Posts


def test_the_sides_of_a_box_are_the_post_s_edges_and_the_middle_of_its_bottom_its_foot():
    (post,) = posts_of_boxes(image(boxes=[(320.0, 200.0, 20.0, 160.0)]), CAMERA, LEVEL, DetectionNoise())
    assert post.edges_px == pytest.approx(np.array([[310.0, 200.0], [330.0, 200.0]]), abs=0.1)
    assert post.foot_px == pytest.approx([320.0, 280.0], abs=0.1)
    assert post.label is None
    assert post.covariance_px2 == pytest.approx(9.0 * np.eye(4))
    assert post.foot_covariance_px2 == pytest.approx(16.0 * np.eye(2))


@pytest.mark.parametrize(("x", "y"), [(2.5, 0.4), (2.2, 0.9), (3.0, 1.2)])
def test_a_post_that_leans_in_the_image_has_its_edges_and_its_foot_where_they_are(x, y):
    (post,) = posts_of_boxes(image(boxes=[box_around(MOUNT, x, y, height=0.6)]), CAMERA, MOUNT, DetectionNoise())
    foot, _ = project_points(CAMERA, MOUNT, np.array([x, y, 0.0]))
    width = 500.0 * 0.1 / np.hypot(x - MOUNT.x_m, y)
    assert post.foot_px[0] == pytest.approx(foot[0], abs=1.0)
    assert np.ptp(post.edges_px[:, 0]) == pytest.approx(width, abs=3.0)
    box = box_around(MOUNT, x, y, height=0.6)
    assert abs(box[0] - foot[0]) > 3.0  # which the middle of the box would have missed
    assert box[2] > 1.4 * width


@pytest.mark.parametrize(
    ("box", "posts", "feet"),
    [
        ((320.0, 400.0, 20.0, 160.0), 1, 0),  # reaches the image's lower end
        ((320.0, 399.0, 20.0, 150.0), 1, 1),
        ((8.0, 200.0, 20.0, 160.0), 0, 0),  # cut off on the left
        ((632.0, 200.0, 20.0, 160.0), 0, 0),
        ((320.0, 200.0, 0.0, 160.0), 0, 0),
        ((320.0, 200.0, 20.0, -1.0), 0, 0),
    ],
)
def test_boxes_that_the_image_cuts_off_tell_less(box, posts, feet):
    found = posts_of_boxes(image(boxes=[box]), CAMERA, LEVEL, DetectionNoise())
    assert (len(found), sum(post.foot_px is not None for post in found)) == (posts, feet)


def test_a_detection_that_is_not_sure_enough_is_none():
    part = image(boxes=[(320.0, 200.0, 20.0, 160.0)], lines=[[[10, 400], [300, 420]]], confidences=0.4)
    for least, count in ((0.0, 2), (0.3, 2), (0.5, 0)):
        adapter = ImageAdapter(around(mapping=LogMapping(detections=DetectionNoise(min_confidence=least))), ["/x"])
        found = list(adapter.take("/x", 0, part))
        assert sum(len(features.posts) + len(features.lines) for features in found) == count
        on_ground = space(lines=[[[1.5, -0.3, 0.0], [2.0, 0.6, 0.0]]], confidence=0.4)
        assert len(list(adapter.take("/x", 0, on_ground))) == bool(count)


# Images


def test_what_several_topics_say_of_one_image_is_one_record():
    adapter = ImageAdapter(around(), ["/posts", "/lines"])
    post, line = image(boxes=[(320.0, 200.0, 20.0, 160.0)]), image(lines=[[[10, 400], [300, 420]]])
    assert list(adapter.take("/posts", ns(1.0), post)) == []
    (features,) = adapter.take("/lines", ns(1.0), line)
    assert (features.stamp_ns, len(features.posts), len(features.lines)) == (ns(1.0), 1, 1)
    assert features.lines[0].ends_px == pytest.approx(np.array([[10, 400], [300, 420]]))
    assert features.mount.tilt_rad == pytest.approx(0.3)
    assert list(adapter.finish()) == []


def test_a_topic_that_is_silent_holds_no_image_up_for_long():
    adapter = ImageAdapter(around(), ["/posts", "/lines"])
    line = image(lines=[[[10, 400], [300, 420]]])
    got = [[f.stamp_ns for f in adapter.take("/lines", ns(0.1 * i), line)] for i in range(8)]
    assert got == [[]] * 6 + [[ns(0.0)], [ns(0.1)]]
    assert [f.stamp_ns for f in adapter.take("/posts", ns(0.5), image(boxes=[(320.0, 200.0, 20.0, 160.0)]))] == [
        ns(0.2), ns(0.3), ns(0.4), ns(0.5)
    ]  # fmt: skip
    assert [f.stamp_ns for f in adapter.finish()] == [ns(0.6), ns(0.7)]


def test_an_image_in_which_nothing_was_seen_is_no_record_and_needs_no_transform():
    adapter = ImageAdapter(surroundings(camera=None), ["/x"])
    assert list(adapter.take("/x", 0, image())) == []
    assert adapter._around.notes.sentences({}) == ()


def test_lines_on_the_ground_go_back_to_the_pixels_they_came_from():
    ends = np.array([[[1.5, -0.3, 0.0], [2.0, 0.6, 0.0]]])
    pixels, seen = project_points(CAMERA, MOUNT, ends)
    assert seen.all()
    (features,) = ImageAdapter(around(), ["/x"]).take("/x", 0, space(lines=ends))
    assert features.lines[0].ends_px == pytest.approx(pixels[0], abs=1e-6)
    in_camera = (ends - [MOUNT.x_m, MOUNT.y_m, MOUNT.height_m]) @ robot_from_camera(MOUNT)
    part = space(lines=in_camera, frame="camera_optical_frame")
    (features,) = ImageAdapter(around(), ["/x"]).take("/x", 0, part)
    assert features.lines[0].ends_px == pytest.approx(pixels[0], abs=1e-6)


def test_lines_that_the_camera_cannot_have_seen_are_left_out():
    behind = [[-1.5, -0.3, 0.0], [-2.0, 0.6, 0.0]]
    aside = [[1.0, 9.0, 0.0], [1.2, 9.5, 0.0]]
    assert list(ImageAdapter(around(), ["/x"]).take("/x", 0, space(lines=[behind, aside]))) == []


@pytest.mark.parametrize(
    ("surrounding", "why"),
    [
        (lambda: around(camera=None), "no camera intrinsics: the log has none; give them with camera = FILE"),
        (lambda: surroundings(), "the log has no transforms"),
        (lambda: surroundings(transform("base_footprint", "arm", [0, 0, 1])), "no transform ever leads"),
    ],
)
def test_images_without_camera_or_its_place_are_counted_with_the_way_out(surrounding, why):
    adapter = ImageAdapter(surrounding(), ["/x"])
    for i in range(3):
        assert list(adapter.take("/x", ns(i), image(boxes=[(320.0, 200.0, 20.0, 160.0)]))) == []
    (sentence,) = adapter._around.notes.sentences({"/x": 5})
    assert sentence.startswith("3 of 5 messages left out, the first: /x at 0.0 s: ")
    assert why in sentence


@pytest.mark.parametrize("part", [image(boxes=[(np.nan, 1, 2, 3)]), image(lines=[[[np.inf, 1], [2, 3]]])])
def test_a_detection_that_is_no_number_spoils_its_message(part):
    with pytest.raises(Unusable, match="not finite"):
        list(ImageAdapter(around(), ["/x"]).take("/x", 0, part))


def test_a_mount_that_is_told_serves_a_log_without_transforms():
    mapping = LogMapping(mount=MountSettings(fixed=MOUNT))
    adapter = ImageAdapter(surroundings(mapping=mapping), ["/x"])
    (features,) = adapter.take("/x", 0, image(boxes=[(320.0, 200.0, 20.0, 160.0)]))
    assert features.mount is MOUNT
    ends = np.array([[[1.5, -0.3, 0.0], [2.0, 0.6, 0.0]]])
    (features,) = ImageAdapter(surroundings(mapping=mapping), ["/x"]).take("/x", 0, space(lines=ends))
    assert features.lines[0].ends_px == pytest.approx(project_points(CAMERA, MOUNT, ends)[0][0])


def test_the_leaning_head_s_attitude_is_that_at_the_image_s_stamp():
    frames = around().frames
    for i in range(3):
        head = transform("base_footprint", "gimbal", [0.0, 0.0, 0.6], about("z", 0.1 * i), 1.0 + 0.1 * i)
        frames.add([head], 0)
    optical = Rotation.from_matrix(robot_from_camera(LEVEL))
    frames.add([transform("gimbal", "eye", [0.0, 0.0, 0.0], optical)], 0, static=True)
    adapter = ImageAdapter(around(), ["/x"])
    adapter._around.__dict__["frames"] = frames
    (features,) = adapter.take("/x", ns(1.15), image(boxes=[(320.0, 200.0, 20.0, 160.0)], frame="eye"))
    assert features.mount.pan_rad == pytest.approx(0.15)
