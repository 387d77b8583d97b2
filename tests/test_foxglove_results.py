import numpy as np
import pytest
from foxglove_wire import strictly
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.base import Estimate
from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.field import PRESETS, FieldMap, Landmark, load_field
from fieldloc.ground import project_points
from fieldloc.measurements import (
    CameraMount,
    Compass,
    ImageFeatures,
    LandmarkScan,
    LineObservation,
    Odometry,
    PostObservation,
)
from logs.foxglove import topics
from logs.foxglove.results import (
    estimate_messages,
    estimates_messages,
    field_messages,
    hypothesis_messages,
    measurement_messages,
    trajectory_messages,
)
from logs.foxglove.shapes import LAST_STAMP_NS
from logs.foxglove.topics import Frames

SECOND = 10**9
STAMP_NS = 1_700_000_000_123_456_789
POSE = np.array([1.5, -2.0, 2.5])
COVARIANCE = np.array([[0.04, 0.015, 0.002], [0.015, 0.02, -0.001], [0.002, -0.001, 0.01]])
ESTIMATE = Estimate(STAMP_NS, POSE, COVARIANCE)
ODOM = np.array([-0.5, 4.0, -1.0])
GRID_M = 0.5e-3  # drawn points are on a grid of a millimetre
KIDSIZE = load_field("kidsize")
WOODS = FieldMap(
    "two tubes",
    np.zeros((0, 2, 2)),
    np.zeros((0, 3)),
    (Landmark("a", np.array([4.0, 1.0]), 0.0, np.zeros((2, 2))), Landmark("b", np.array([0.0, 3.0]), 0.2, np.eye(2))),
)


def by_topic(messages):
    out = {message.source.topic: strictly(message) for message in messages}
    assert len(out) == len(messages)
    return out


def ns(time):
    return time.seconds * SECOND + time.nanos


def heading(rotation):
    assert rotation.x == rotation.y == 0.0
    assert rotation.z**2 + rotation.w**2 == pytest.approx(1.0)
    return 2 * np.arctan2(rotation.z, rotation.w)


def flat(pose):
    """Of a published Pose."""
    return np.array([pose.position.x, pose.position.y, heading(pose.orientation)])


def outline(points):
    return np.array([[point.x, point.y] for point in points])


def entity(update):
    """The only one, drawn in the field and moving with it."""
    (one,) = update.entities
    assert one.frame_id == "field"
    assert one.frame_locked
    return one


def placed(primitive):
    """Its points in the frame of its entity."""
    assert primitive.pose.orientation.w == 1.0
    return outline(primitive.points) + [primitive.pose.position.x, primitive.pose.position.y]


def lines(update):
    """(n, 2, 2) of each line list."""
    return [placed(line).reshape(-1, 2, 2) for line in entity(update).lines if line.type == line.LINE_LIST]


def same_pose(a, b):
    difference = np.asarray(a) - b
    difference[2] = se2.wrap(difference[2])
    assert difference == pytest.approx(0.0, abs=1e-12)


def triangles(update, name):
    """(n, 3, 2) of the entity of that name."""
    (one,) = [one for one in update.entities if one.id == name]
    out = [placed(part)[np.array(part.indices)].reshape(-1, 3, 2) for part in one.triangles]
    return np.concatenate([np.zeros((0, 3, 2)), *out])


def areas(corners):
    """Positive where counter-clockwise."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


@pytest.mark.parametrize("name", PRESETS)
def test_lines_and_circles_are_as_wide_and_long_as_on_the_field(name):
    field = load_field(name)
    update = by_topic(field_messages(field, STAMP_NS))[topics.FIELD]
    width = field.line_width_m
    lengths = np.linalg.norm(field.lines[:, 1] - field.lines[:, 0], axis=-1)
    drawn = areas(triangles(update, "lines"))
    assert (drawn > 0).all()  # seen from above
    of_lines, of_circles = drawn[: 2 * len(lengths)], drawn[2 * len(lengths) :]
    assert of_lines.reshape(-1, 2).sum(axis=1) == pytest.approx((lengths + width) * width)
    # a regular polygon of n sides has n / (2 pi) sin(2 pi / n) of its circle's area
    share = 96 / (2 * np.pi) * np.sin(2 * np.pi / 96)
    assert of_circles.sum() == pytest.approx(share * 2 * np.pi * field.circles[:, 2].sum() * width)


def test_a_line_lies_around_its_middle():
    field = FieldMap("slanted", np.array([[[1.0, 2.0], [4.0, 6.0]]]), np.zeros((0, 3)), (), 0.1)
    corners = triangles(by_topic(field_messages(field, 0))[topics.FIELD], "lines").reshape(-1, 2)
    along, across = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    assert set(np.round((corners - [1.0, 2.0]) @ along, 9)) == {-0.05, 5.05}
    assert set(np.round((corners - [1.0, 2.0]) @ across, 9)) == {-0.05, 0.05}


def test_a_circle_lies_around_its_middle():
    field = FieldMap("round", np.zeros((0, 2, 2)), np.array([[1.0, -2.0, 0.75]]), (), 0.1)
    corners = triangles(by_topic(field_messages(field, 0))[topics.FIELD], "lines").reshape(-1, 2)
    radii = np.linalg.norm(corners - [1.0, -2.0], axis=-1)
    assert set(np.round(radii, 9)) == {0.7, 0.8}


@pytest.mark.parametrize("field", [KIDSIZE, WOODS], ids=lambda field: field.name)
def test_posts_stand_on_the_ground_where_the_map_has_them(field):
    update = by_topic(field_messages(field, STAMP_NS))[topics.FIELD]
    (marks,) = [one for one in update.entities if one.id == "landmarks"]
    assert np.array([flat(post.pose)[:2] for post in marks.cylinders]) == pytest.approx(field.positions)
    for post, mark in zip(marks.cylinders, field.landmarks, strict=True):
        assert post.pose.position.z == post.size.z / 2 > 0
        assert post.size.x == post.size.y == (mark.diameter_m or 0.05)
        assert post.bottom_scale == post.top_scale == 1.0  # 0 is a point
        assert post.color.a == 1.0
    assert [text.text for text in marks.texts] == list(field.labels)


def test_the_lawn_is_below_everything_on_the_map():
    update = by_topic(field_messages(KIDSIZE, STAMP_NS))[topics.FIELD]
    ground = triangles(update, "ground")
    (lawn,) = next(one for one in update.entities if one.id == "ground").triangles
    xmin, ymin, xmax, ymax = KIDSIZE.bounds
    assert areas(ground).sum() == pytest.approx((xmax - xmin + 2) * (ymax - ymin + 2))
    assert lawn.pose.position.z < 0


def test_a_map_replaces_the_one_before():
    update = by_topic(field_messages(KIDSIZE, STAMP_NS))[topics.FIELD]
    (gone,) = update.deletions
    assert gone.type == gone.ALL
    assert ns(gone.timestamp) == STAMP_NS
    assert {one.id for one in update.entities} == {"ground", "lines", "landmarks"}
    assert all(one.frame_id == "field" and one.frame_locked and not ns(one.lifetime) for one in update.entities)
    assert all(ns(one.timestamp) == STAMP_NS for one in update.entities)


def test_an_estimate_is_a_pose_with_its_covariance():
    messages = estimate_messages(ESTIMATE, ODOM)
    assert {message.log_time_ns for message in messages} == {STAMP_NS}
    shown = by_topic(messages)
    assert set(shown) == {topics.POSE, topics.STATE, topics.TRANSFORMS, topics.UNCERTAINTY}
    for topic in (topics.POSE, topics.STATE):
        assert shown[topic].frame_id == "field"
        assert ns(shown[topic].timestamp) == STAMP_NS
        same_pose(flat(shown[topic].pose), POSE)
    assert shown[topics.STATE].body_frame_id == "robot"
    assert not shown[topics.STATE].HasField("linear_velocity")  # not said
    in_space = np.array(shown[topics.STATE].pose_covariance).reshape(6, 6)
    planar = [0, 1, 5]
    assert np.array_equal(in_space[np.ix_(planar, planar)], COVARIANCE)
    assert not in_space[2:5].any()
    assert not in_space[:, 2:5].any()


def test_transforms_lead_from_the_field_over_the_odometry_to_the_robot():
    first, second = by_topic(estimate_messages(ESTIMATE, ODOM))[topics.TRANSFORMS].transforms
    assert (first.parent_frame_id, first.child_frame_id) == ("field", "odom")
    assert (second.parent_frame_id, second.child_frame_id) == ("odom", "robot")
    assert ns(first.timestamp) == ns(second.timestamp) == STAMP_NS

    def of(link):
        return np.array([link.translation.x, link.translation.y, heading(link.rotation)])

    same_pose(of(second), ODOM)
    same_pose(se2.compose(of(first), of(second)), POSE)


def test_without_odometry_the_robot_is_in_the_field():
    (link,) = by_topic(estimate_messages(ESTIMATE, None))[topics.TRANSFORMS].transforms
    assert (link.parent_frame_id, link.child_frame_id) == ("field", "robot")
    same_pose([link.translation.x, link.translation.y, heading(link.rotation)], POSE)


def test_frames_have_the_names_that_are_asked_for():
    shown = by_topic(estimate_messages(ESTIMATE, ODOM, Frames("map", "a", "b")))
    links = [(link.parent_frame_id, link.child_frame_id) for link in shown[topics.TRANSFORMS].transforms]
    assert links == [("map", "a"), ("a", "b")]
    assert shown[topics.POSE].frame_id == shown[topics.UNCERTAINTY].entities[0].frame_id == "map"


def covariances(scale):
    roots = st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9).map(lambda v: np.array(v).reshape(3, 3))
    return roots.map(lambda root: scale**2 * (root @ root.T + 0.01 * np.eye(3)))


@given(covariance=st.sampled_from([1e-3, 0.1, 10.0]).flatmap(covariances))
@settings(deadline=None, max_examples=100)
def test_the_ellipse_is_three_sigma_away_in_every_direction(covariance):
    update = by_topic(estimate_messages(Estimate(STAMP_NS, POSE, covariance), None))[topics.UNCERTAINTY]
    ellipse = entity(update).lines[0]
    assert ellipse.type == ellipse.LINE_LOOP
    away = placed(ellipse) - POSE[:2]
    sigmas = np.sqrt(np.sum(away @ np.linalg.inv(covariance[:2, :2]) * away, axis=1))
    # the grid is 1/1024 of the outline's size, and the thin side of the thinnest ellipse drawn here 1/25 of that
    assert sigmas == pytest.approx(3.0, abs=3 * 25 * np.sqrt(2) / 1024)
    around = areas(np.stack([0 * away, away, np.roll(away, -1, axis=0)], axis=1)).sum()
    exact = 9 * np.sqrt(np.linalg.det(covariance[:2, :2])) * 16 * np.sin(2 * np.pi / 32)
    assert abs(around) == pytest.approx(exact, rel=25 * np.sqrt(2) / 1024)


def test_the_ellipse_holds_what_three_sigma_hold():
    random = np.random.default_rng(5)
    away = outline(entity(by_topic(estimate_messages(ESTIMATE, None))[topics.UNCERTAINTY]).lines[0].points)
    samples = random.multivariate_normal(np.zeros(2), COVARIANCE[:2, :2], 100_000)
    edges = np.roll(away, -1, axis=0) - away
    offsets = samples[:, None] - away
    sides = edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0]
    inside = (sides > 0).all(axis=1) | (sides < 0).all(axis=1)
    # 1 - exp(-9/2) in two dimensions; the sides of the polygon cut off 0.0003, sampling is off by 0.0003 (one sigma)
    assert inside.mean() == pytest.approx(1 - np.exp(-4.5), abs=0.0015)


def test_the_fan_opens_three_sigma_to_both_sides_of_the_heading():
    fan = entity(by_topic(estimate_messages(ESTIMATE, None))[topics.UNCERTAINTY]).lines[1]
    apex, *arc = placed(fan) - POSE[:2]
    assert apex == pytest.approx(0.0)
    angles = se2.wrap(np.arctan2(*np.transpose(arc)[::-1]) - POSE[2])
    assert [angles.min(), angles.max()] == pytest.approx([-0.3, 0.3], abs=2 * GRID_M / 0.5)
    assert angles.mean() == pytest.approx(0.0, abs=GRID_M / 0.5)


def test_a_heading_that_nobody_knows_opens_the_fan_all_round():
    lost = Estimate(STAMP_NS, POSE, np.diag([0.01, 0.01, 50.0]))
    fan = entity(by_topic(estimate_messages(lost, None))[topics.UNCERTAINTY]).lines[1]
    _, *arc = placed(fan) - POSE[:2]
    assert arc[0] == pytest.approx(arc[-1], abs=2 * GRID_M)
    assert np.linalg.norm(arc, axis=1) == pytest.approx(0.5, abs=2 * GRID_M)


@pytest.mark.parametrize(
    ("where", "value"), [((0, 0), np.nan), ((0, 0), np.inf), ((1, 1), -1.0), ((2, 2), np.nan), ((2, 2), -1.0)]
)
def test_an_estimate_without_a_covariance_shows_no_ellipse(where, value):
    broken = COVARIANCE.copy()
    broken[where] = value
    update = by_topic(estimate_messages(Estimate(STAMP_NS, POSE, broken), None))[topics.UNCERTAINTY]
    (gone,) = update.deletions
    assert not update.entities
    assert (gone.type, gone.id) == (gone.MATCHING_ID, "uncertainty")


def test_an_exact_position_has_an_ellipse_without_size():
    update = by_topic(estimate_messages(Estimate(STAMP_NS, POSE, np.zeros((3, 3))), None))[topics.UNCERTAINTY]
    assert placed(entity(update).lines[0]) == pytest.approx(np.tile(POSE[:2], (32, 1)))


def test_many_estimates_say_the_same_as_each_alone():
    random = np.random.default_rng(2)
    estimates = [Estimate(i * SECOND, random.normal(size=3), COVARIANCE * (1 + i % 7)) for i in range(5000)]
    odom = random.normal(size=(5000, 3))
    together = list(estimates_messages(estimates, odom))
    assert together[: 4 * 100] == [
        m for e, o in zip(estimates[:100], odom, strict=False) for m in estimate_messages(e, o)
    ]
    assert together[-4:] == list(estimate_messages(estimates[-1], odom[-1]))
    assert len(together) == 4 * 5000


def test_the_uncertainty_comes_at_most_ten_times_a_second():
    stamps_ns = [round(i * SECOND / 30) for i in range(300)]
    messages = list(estimates_messages([Estimate(ns, POSE, COVARIANCE) for ns in stamps_ns], None))
    times_ns = [m.log_time_ns for m in messages if m.source.topic == topics.UNCERTAINTY]
    assert np.diff(times_ns).min() >= SECOND / 10
    assert np.diff(times_ns).max() <= SECOND / 10 + SECOND / 30
    assert sum(m.source.topic == topics.POSE for m in messages) == 300


def test_an_entity_keeps_its_name():
    messages = estimates_messages([Estimate(i * SECOND, POSE, COVARIANCE) for i in range(3)], None)
    names = {entity(strictly(m)).id for m in messages if m.source.topic == topics.UNCERTAINTY}
    assert names == {"uncertainty"}


def walk(count):
    t = np.linspace(0.0, 20.0, count)
    return [Estimate(i, np.array([3 * np.cos(s), 2 * np.sin(s), 0.3 * s]), COVARIANCE) for i, s in enumerate(t)]


def test_a_trajectory_is_thinned_without_leaving_its_way():
    estimates = walk(20_000)
    shown = by_topic(trajectory_messages(estimates, STAMP_NS))[topics.TRAJECTORY]
    kept = np.array([flat(pose) for pose in shown.poses])
    assert shown.frame_id == "field"
    assert ns(shown.timestamp) == STAMP_NS
    assert 500 < len(kept) < 2500  # 51 m and 6 rad of way
    same_pose(kept[0], estimates[0].pose)
    same_pose(kept[-1], estimates[-1].pose)
    poses = np.array([estimate.pose for estimate in estimates])
    distance = np.abs(poses[::50, None, :2] - kept[None, :, :2]).max(axis=-1).min(axis=1)
    assert distance.max() < 0.05


def test_a_trajectory_has_at_most_5000_poses():
    random = np.random.default_rng(1)
    jumping = [Estimate(i, 5 * random.normal(size=3), COVARIANCE) for i in range(12_000)]
    shown = by_topic(trajectory_messages(jumping, 0))[topics.TRAJECTORY]
    assert 2000 < len(shown.poses) <= 5000


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_a_short_trajectory_is_whole_at_its_ends(count):
    estimates = walk(count)
    shown = by_topic(trajectory_messages(estimates, 0, topic="/truth_way"))["/truth_way"]
    if count:
        same_pose(flat(shown.poses[0]), estimates[0].pose)
        same_pose(flat(shown.poses[-1]), estimates[-1].pose)
    assert min(count, 2) <= len(shown.poses) <= count


def test_standing_still_is_one_place():
    still = [Estimate(i, POSE, COVARIANCE) for i in range(100)]
    assert len(by_topic(trajectory_messages(still, 0))[topics.TRAJECTORY].poses) == 2


def test_hypotheses_are_sorted_by_weight_and_fade_with_it():
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [-1.0, 0.5, -1.0]])
    shown = by_topic(hypothesis_messages(poses, np.array([1.0, 4.0, 2.0]), STAMP_NS))
    in_order = [flat(pose) for pose in shown[topics.HYPOTHESES].poses]
    arrows = entity(shown[topics.WEIGHTS]).arrows
    for drawn in (in_order, [flat(arrow.pose) for arrow in arrows]):
        for pose, expected in zip(drawn, poses[[1, 2, 0]], strict=True):
            same_pose(pose, expected)
    assert [arrow.color.a for arrow in arrows] == pytest.approx([1.0, 0.55, 0.325])


def test_no_hypotheses_clear_those_before():
    shown = by_topic(hypothesis_messages(np.zeros((0, 3)), np.zeros(0), STAMP_NS))
    assert not shown[topics.HYPOTHESES].poses
    assert [gone.id for gone in shown[topics.WEIGHTS].deletions] == ["hypotheses"]


def scan_of(field, pose, labels, sensor=(0.2, -0.1, 0.5)):
    """An exact scan of the landmarks with these labels; None is the first, unnamed."""
    robot_from_sensor = np.array(sensor)
    at = field.positions[[field.index_of(label or "a") for label in labels]]
    seen = se2.apply(se2.inverse(se2.compose(pose, robot_from_sensor)), at)
    polar = np.stack([np.linalg.norm(seen, axis=-1), np.arctan2(seen[:, 1], seen[:, 0])], axis=-1)
    return LandmarkScan(
        STAMP_NS, tuple(labels), polar, np.tile(0.01 * np.eye(2), (len(labels), 1, 1)), robot_from_sensor
    )


def test_rays_lead_from_the_sensor_to_what_it_saw():
    scan = scan_of(WOODS, POSE, ["b", None])
    (rays,) = lines(by_topic(measurement_messages(scan, POSE, None))[topics.SIGHTS])
    eye = se2.apply(POSE, scan.robot_from_sensor[:2])
    assert rays[:, 0] == pytest.approx(np.tile(eye, (2, 1)), abs=GRID_M)
    assert rays[:, 1] == pytest.approx(WOODS.positions[[1, 0]], abs=GRID_M)


def test_a_red_line_leads_from_where_a_named_landmark_was_seen_to_where_it_is():
    scan = scan_of(WOODS, POSE, ["b", None])
    wrong = POSE + [0.3, 0.0, 0.0]
    rays, residuals = lines(by_topic(measurement_messages(scan, wrong, None, WOODS))[topics.SIGHTS])
    assert residuals == pytest.approx(np.array([[rays[0, 1], WOODS.positions[1]]]), abs=GRID_M)
    assert residuals[0, 0] - residuals[0, 1] == pytest.approx([0.3, 0.0], abs=2 * GRID_M)


def test_what_was_seen_fades_and_an_empty_scan_clears_it():
    scan = scan_of(WOODS, POSE, ["a"])
    shown = entity(by_topic(measurement_messages(scan, POSE, None))[topics.SIGHTS])
    assert ns(shown.lifetime) == SECOND
    nothing = LandmarkScan(STAMP_NS, (), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    update = by_topic(measurement_messages(nothing, POSE, None))[topics.SIGHTS]
    assert not update.entities
    assert [gone.id for gone in update.deletions] == [shown.id]


CAMERA = Camera("pinhole", 640, 480, 500.0, 510.0, 320.0, 235.0, (-0.2, 0.05, 0.001, -0.002))
MOUNT = CameraMount(0.55, 0.2, 0.35, 0.03, 1e-4 * np.eye(4), 0.05, -0.02)


def image_of(points):
    """An image with a post at each robot-frame point (2,), its foot on the ground, and a line from first to second."""
    ground = np.column_stack([np.array(points), np.zeros(len(points))])
    feet, seen = project_points(CAMERA, MOUNT, ground)
    tops, _ = project_points(CAMERA, MOUNT, ground + [0.0, 0.0, 0.4])
    assert seen.all()
    posts = [
        PostObservation(np.stack([top - [5.0, 0.0], top + [5.0, 0.0]]), np.eye(4), foot, np.eye(2), label)
        for top, foot, label in zip(tops, feet, ["a", None, "b"], strict=False)
    ]
    return ImageFeatures(STAMP_NS, MOUNT, tuple(posts), (LineObservation(feet[:2], np.eye(4)),))


def test_feet_and_lines_of_an_image_are_where_they_stand_on_the_field():
    points = np.array([[2.0, 0.3], [2.5, 0.8]])
    shown = by_topic(measurement_messages(image_of(points), POSE, CAMERA))
    rays, seen_line = lines(shown[topics.SIGHTS])
    assert rays[:, 0] == pytest.approx(np.tile(se2.apply(POSE, np.array([0.05, -0.02])), (2, 1)), abs=GRID_M)
    assert rays[:, 1] == pytest.approx(se2.apply(POSE, points), abs=GRID_M)
    assert seen_line == pytest.approx(se2.apply(POSE, points)[None], abs=GRID_M)


def test_a_post_without_a_foot_is_a_ray_in_its_direction():
    at = np.array([3.0, 0.5])
    image = image_of([at, at])
    post = image.posts[0]
    footless = ImageFeatures(STAMP_NS, MOUNT, (PostObservation(post.edges_px, np.eye(4)),))
    (rays,) = lines(by_topic(measurement_messages(footless, POSE, CAMERA))[topics.SIGHTS])
    (ray,) = rays
    towards = se2.apply(POSE, at) - ray[0]
    along = ray[1] - ray[0]
    assert np.linalg.norm(along) == pytest.approx(4.0, abs=2 * GRID_M)
    # the middle of both edges is not quite the post's middle through a distorting lens
    assert np.cross(np.append(along, 0), np.append(towards, 0))[2] / 4.0 == pytest.approx(0.0, abs=0.01)
    assert along @ towards > 0


def test_lines_that_reach_the_horizon_have_no_place_on_the_ground():
    up = np.array([[320.0, 10.0], [330.0, 400.0]])
    image = ImageFeatures(STAMP_NS, MOUNT, (), (LineObservation(up, np.eye(4)),))
    shown = by_topic(measurement_messages(image, POSE, CAMERA))
    assert [gone.id for gone in shown[topics.SIGHTS].deletions] == ["sights"]
    assert outline(shown[topics.ANNOTATIONS].points[0].points) == pytest.approx(up)


def test_annotations_are_the_pixels_that_were_seen():
    image = image_of([[2.0, 0.3], [2.5, 0.8]])
    shown = by_topic(measurement_messages(image, None, CAMERA))
    assert set(shown) == {topics.ANNOTATIONS}
    drawn = shown[topics.ANNOTATIONS]
    assert ns(drawn.timestamp) == STAMP_NS
    expected = [*(post.edges_px for post in image.posts), *(line.ends_px for line in image.lines)]
    assert all(one.type == one.LINE_LIST and one.thickness > 0 for one in drawn.points)
    for one, ends in zip(drawn.points, expected, strict=True):
        assert np.array_equal(outline(one.points), ends)
    feet = [[circle.position.x, circle.position.y] for circle in drawn.circles]
    assert np.array_equal(feet, [post.foot_px for post in image.posts])
    assert [text.text for text in drawn.texts] == ["a"]


def test_an_image_without_a_camera_has_annotations_only():
    messages = measurement_messages(image_of([[2.0, 0.3], [2.5, 0.8]]), POSE, None)
    assert set(by_topic(messages)) == {topics.ANNOTATIONS}


@pytest.mark.parametrize("measurement", [Odometry(1, np.zeros(3)), Compass(1, 0.0, 0.1)])
def test_what_sees_nothing_shows_nothing(measurement):
    assert measurement_messages(measurement, POSE, CAMERA, KIDSIZE) == ()


@pytest.mark.parametrize("stamp_ns", [0, LAST_STAMP_NS])
def test_stamps_are_kept_to_the_nanosecond(stamp_ns):
    shown = by_topic(estimate_messages(Estimate(stamp_ns, POSE, COVARIANCE), None))
    assert ns(shown[topics.POSE].timestamp) == stamp_ns


@pytest.mark.parametrize("stamp_ns", [-1, LAST_STAMP_NS + 1])
def test_a_stamp_that_foxglove_cannot_hold_is_refused(stamp_ns):
    with pytest.raises(ValueError, match=str(stamp_ns)):
        estimate_messages(Estimate(stamp_ns, POSE, COVARIANCE), None)
