"""The renderer against exact projection: edges to a small part of a pixel, through any lens."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import ConvexHull

from fieldloc.camera import Camera
from fieldloc.field import FieldMap, Landmark, Section, load_field
from fieldloc.ground import project_points, robot_from_camera
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray, apply, inverse
from fieldloc.render import Ball, Goals, Robot, Scene, Sensor, Turf, render, render_with_truth
from fieldloc.render.crossings import crossings_of

CAMERAS = {
    "pinhole": Camera("pinhole", 320, 240, 250.0, 250.0, 159.5, 119.5),
    "distorted": Camera("pinhole", 317, 240, 240.0, 243.0, 161.0, 118.0, (-0.2, 0.05, 0.001, -0.002)),
    "fisheye": Camera("fisheye", 320, 240, 140.0, 140.0, 160.0, 120.0, (0.02, -0.01, 0.0, 0.0)),
}
MOUNT = CameraMount(0.5, 0.2, 0.35, 0.05, np.zeros((4, 4)))
POSE = np.array([0.4, -0.3, 0.5])
TURF, WHITE = 40.0, 235.0  # of a clean scene, red
NEAR_PX = 0.05  # what a detector on these pictures may take for its own error

NO_LINES, NO_CIRCLES = np.zeros((0, 2, 2)), np.zeros((0, 3))
EMPTY = FieldMap("empty", NO_LINES, NO_CIRCLES, ())
GREEN = (50.0, 130.0, TURF)
PLAIN = Scene(turf=Turf(GREEN, floor=GREEN), goals=Goals(colour=(255.0, 255.0, 255.0)), ceiling=GREEN)

each_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)


def painted(lines: FloatArray = NO_LINES, circles: FloatArray = NO_CIRCLES) -> FieldMap:
    return FieldMap("test", lines, circles, ())


def red(field: FieldMap, camera: Camera, scene: Scene) -> FloatArray:
    picture = render(scene, camera, field, MOUNT, POSE, np.random.default_rng(0))
    assert picture.shape == (camera.height_px, camera.width_px, 3)
    assert picture.dtype == np.uint8
    return picture[..., 2].astype(np.float64)


def pixels_of(camera: Camera, points: FloatArray) -> FloatArray:
    """(n, 2) of points (n, 3) of the field."""
    in_robot = np.column_stack([apply(inverse(POSE), points[:, :2]), points[:, 2]])
    return project_points(camera, MOUNT, in_robot)[0]


def crossings(curve: FloatArray, across: FloatArray, axis: int) -> FloatArray:
    """Where a curve of pixels (n, 2) has coordinate 1 - axis at `across` (m,): its coordinate `axis`; NaN elsewhere."""
    order = np.argsort(curve[:, 1 - axis])
    return np.interp(across, curve[order, 1 - axis], curve[order, axis], left=np.nan, right=np.nan)


@each_camera
@pytest.mark.parametrize(
    "ends",
    [
        ((2.0, -4.0), (2.5, 6.0)),
        ((0.6, 0.6), (6.0, 1.5)),
        ((2.9, -6.0), (3.0, 9.0)),
        ((4.0, -6.0), (4.5, 12.0)),
    ],
    ids=["across", "ahead", "a pixel wide", "half as wide"],
)
def test_a_line_is_as_bright_as_its_projected_edges_say_and_where_they_say(
    camera: Camera, ends: tuple[tuple[float, float], tuple[float, float]]
) -> None:
    line = np.array(ends)
    field = painted(lines=line[None])
    picture = red(field, camera, PLAIN)
    along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    left = 0.5 * field.line_width_m * np.array([-along[1], along[0]])
    middle = line[0] + np.linspace(0.0, 1.0, 4000)[:, None] * (line[1] - line[0])
    edges = [pixels_of(camera, np.column_stack([middle + side, np.zeros(len(middle))])) for side in (left, -left)]
    edges = [edge[np.isfinite(edge).all(axis=1) & camera.contains(edge)] for edge in edges]
    extent = np.ptp(edges[0], axis=0)
    axis = int(extent[1] < extent[0])  # summed down columns where the line lies flat
    inner = [edge[:, 1 - axis].min() for edge in edges], [edge[:, 1 - axis].max() for edge in edges]
    checked = 0
    for at in range(int(max(inner[0])) + 6, int(min(inner[1])) - 6):  # the line's ends are cut off square
        profile = picture[:, at] if axis == 1 else picture[at]
        bounds = np.sort([crossings(edge, np.array([float(at)]), axis)[0] for edge in edges])
        if not (bounds[0] > 5.0 and bounds[1] < len(profile) - 6.0):
            continue
        window = np.arange(int(bounds[0]) - 4, int(bounds[1]) + 6)
        share = (profile[window] - TURF) / (WHITE - TURF)
        assert share.sum() == pytest.approx(bounds[1] - bounds[0], abs=NEAR_PX)
        # numbers are rounded to 1 / 195 of the white: that moves the middle of a faint line
        assert (share @ window) / share.sum() == pytest.approx(bounds.mean(), abs=NEAR_PX * max(1.0, 1.0 / share.sum()))
        checked += 1
    assert checked > 60


@each_camera
def test_a_circle_is_where_its_points_are(camera: Camera) -> None:
    circle = np.array([2.4, 1.2, 0.5])
    field = painted(circles=circle[None])
    picture, truth = render_with_truth(PLAIN, camera, field, MOUNT, POSE, np.random.default_rng(0))
    share = (picture[..., 2].astype(np.float64) - TURF) / (WHITE - TURF)
    turn = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
    rims = []
    for radius in (circle[2] - 0.025, circle[2] + 0.025):
        points = circle[:2] + radius * np.column_stack([np.cos(turn), np.sin(turn)])
        rims.append(pixels_of(camera, np.column_stack([points, np.zeros(len(points))])))
    inner, outer = (0.5 * abs(shoelace(rim)) for rim in rims)
    assert share.sum() == pytest.approx(outer - inner, rel=0.005)
    centre = (area_middle(rims[1]) * outer - area_middle(rims[0]) * inner) / (outer - inner)
    v, u = np.mgrid[: camera.height_px, : camera.width_px]
    seen = np.array([(share * u).sum(), (share * v).sum()]) / share.sum()
    assert seen == pytest.approx(centre, abs=NEAR_PX)
    (found,) = truth.circles
    assert len(found.points_px) == 800
    across = np.abs(crossing_distance(found.points_px, rims))
    assert across.max() < 0.1 * np.sqrt(outer)


def shoelace(points: FloatArray) -> float:
    """Twice the area of a polygon (n, 2)."""
    x, y = points.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def area_middle(points: FloatArray) -> FloatArray:
    following = np.roll(points, -1, axis=0)
    cross = points[:, 0] * following[:, 1] - following[:, 0] * points[:, 1]
    return np.asarray(((points + following) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum()))


def crossing_distance(points: FloatArray, rims: list[FloatArray]) -> FloatArray:
    """By how much points (n, 2) are nearer to one rim than to the other."""
    return np.subtract(*(np.linalg.norm(points[:, None] - rim, axis=-1).min(axis=1) for rim in rims))


@each_camera
@pytest.mark.parametrize("section", ["round", "square"])
@pytest.mark.parametrize("height_m", [0.25, 0.6], ids=["seen from above", "above the camera"])
def test_a_post_fills_what_is_between_the_outermost_of_its_upright_lines(
    camera: Camera, section: Section, height_m: float
) -> None:
    at = np.array([2.6, 1.1])
    mark = Landmark("post", at, 0.12, np.zeros((2, 2)), height_m)
    field = FieldMap("test", NO_LINES, NO_CIRCLES, (mark,), post_section=section)
    picture, truth = render_with_truth(PLAIN, camera, field, MOUNT, POSE, np.random.default_rng(0))
    share = (picture[..., 2].astype(np.float64) - TURF) / (255.0 - TURF)
    eye = apply(POSE, np.array([MOUNT.x_m, MOUNT.y_m]))
    rim = at + 0.06 * outline(section)
    (x, y), spokes = at - eye, rim - eye
    aside = (x * spokes[:, 1] - y * spokes[:, 0]) / (spokes @ (at - eye))
    (post,) = truth.posts
    edges = []
    for touched, found in ((rim[aside.argmax()], post.left_px), (rim[aside.argmin()], post.right_px)):
        upright = np.column_stack([np.tile(touched, (500, 1)), np.linspace(height_m, 0.0, 500)])
        edges.append(pixels_of(camera, upright))
        assert found == pytest.approx(edges[-1][[0, -1]], abs=0.01)
    first, last = max(edge[:, 1].min() for edge in edges) + 5, min(edge[:, 1].max() for edge in edges) - 5
    for row in range(int(np.ceil(first)), int(last)):
        left, right = (crossings(edge, np.array([float(row)]), 0)[0] for edge in edges)
        assert share[row].sum() == pytest.approx(right - left, abs=NEAR_PX)
        assert (share[row] @ np.arange(camera.width_px)) / share[row].sum() == pytest.approx(
            0.5 * (left + right), abs=NEAR_PX
        )
    assert last - first > 2


@pytest.mark.parametrize("section", ["round", "square"])
@pytest.mark.parametrize("height_m", [0.25, 0.6], ids=["seen from above", "above the camera"])
def test_a_post_covers_the_hull_of_its_rims(section: Section, height_m: float) -> None:
    camera, at = CAMERAS["pinhole"], np.array([2.6, 1.1])
    mark = Landmark("post", at, 0.12, np.zeros((2, 2)), height_m)
    field = FieldMap("test", NO_LINES, NO_CIRCLES, (mark,), post_section=section)
    share = (red(field, camera, PLAIN) - TURF) / (255.0 - TURF)
    rims = [np.column_stack([at + 0.06 * outline(section), np.full(4000, level)]) for level in (0.0, height_m)]
    pixels = pixels_of(camera, np.concatenate(rims))
    assert camera.contains(pixels).all(), pixels.min(axis=0)
    hull = pixels[ConvexHull(pixels).vertices]
    area = 0.5 * abs(shoelace(hull))
    v, u = np.mgrid[: camera.height_px, : camera.width_px]
    assert share.sum() == pytest.approx(area, rel=0.003)
    middle = np.array([(share * u).sum(), (share * v).sum()]) / share.sum()
    assert middle == pytest.approx(area_middle(hull), abs=NEAR_PX)


def outline(section: Section) -> FloatArray:
    """(4000, 2) of a post of radius 1."""
    turn = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False) + np.pi / 4
    around = np.column_stack([np.cos(turn), np.sin(turn)])
    return around if section == "round" else around / np.abs(around).max(axis=1)[:, None]


@each_camera
def test_a_ball_covers_the_cone_of_rays_that_touch_it(camera: Camera) -> None:
    ball = Ball(2.0, 0.8, 0.11, colour=(255.0, 255.0, 255.0), patches=(255.0, 255.0, 255.0))
    share = [red(EMPTY, camera, replace(PLAIN, balls=balls, sensor=Sensor(blur_px=0.0))) for balls in ((), (ball,))]
    v, u = np.mgrid[: camera.height_px, : camera.width_px]
    near = np.flatnonzero(ndimage.binary_dilation(share[1] - share[0], iterations=3))
    cells = np.stack(np.meshgrid(*[(np.arange(16) - 7.5) / 16] * 2), axis=-1).reshape(-1, 2)
    rays, _ = camera.ray(np.stack([u.ravel()[near], v.ravel()[near]], axis=-1)[:, None] + cells)
    centre = np.append(apply(inverse(POSE), np.array([2.0, 0.8])), 0.11) - [MOUNT.x_m, MOUNT.y_m, MOUNT.height_m]
    axis = robot_from_camera(MOUNT).T @ centre
    distance = np.linalg.norm(axis)
    inside = rays @ axis / distance > np.sqrt(1.0 - (0.11 / distance) ** 2)
    lit = (share[1] - share[0]) / (255.0 - share[0])
    covered = np.zeros(lit.shape)
    covered.flat[near] = inside.mean(axis=1)
    assert np.abs(lit - covered).max() < 0.05
    assert lit.sum() == pytest.approx(covered.sum(), rel=0.005)


def test_the_truth_knows_what_a_robot_hides() -> None:
    field, camera = load_field("kidsize"), CAMERAS["pinhole"]
    mount = CameraMount(0.5, 0.0, 0.2, 0.0, np.zeros((4, 4)))
    pose = np.zeros(3)
    random = np.random.default_rng(0)
    free = render_with_truth(Scene(), camera, field, mount, pose, random)[1]
    robot = Robot(3.6, 0.0, height_m=0.6)
    hidden = render_with_truth(Scene(robots=(robot,)), camera, field, mount, pose, random)[1]
    goal_line = int(np.flatnonzero((field.lines[:, :, 0] == 4.5).all(axis=1))[0])
    pieces = [[each.ends_px for each in truth.lines if each.line == goal_line] for truth in (free, hidden)]
    for truth, ends in zip((free, hidden), pieces, strict=True):
        shown = ~truth.hidden[round(ends[0][0, 1])]
        counted = np.abs(np.diff(np.array(ends)[:, :, 0], axis=1)).sum()
        assert counted == pytest.approx(shown.sum(), abs=0.01)
        assert len(ends) == np.count_nonzero(np.diff(shown.astype(int)) > 0) + shown[0]
    assert len(pieces[1]) > len(pieces[0])


def test_a_post_behind_a_robot_has_no_foot() -> None:
    field, camera = load_field("kidsize"), CAMERAS["pinhole"]
    mount = CameraMount(0.5, 0.0, 0.0, 0.0, np.zeros((4, 4)))
    place = field.positions[field.labels.index("post_opponent_left")]
    pose = np.append(place - [3.0, 0.0], 0.0)
    towards = place - [1.0, 0.1]
    truths = [
        render_with_truth(scene, camera, field, mount, pose, np.random.default_rng(0))[1]
        for scene in (Scene(), Scene(robots=(Robot(*towards, height_m=1.0),)))
    ]
    free, behind = ({post.label: post for post in truth.posts}["post_opponent_left"] for truth in truths)
    assert free.foot_px is not None
    assert behind.foot_px is None
    assert free.left_px is not None
    assert behind.left_px is not None
    assert behind.left_px[1, 1] < free.left_px[1, 1]
    assert behind.left_px[0] == pytest.approx(free.left_px[0])


def test_a_camera_under_the_ground_is_refused() -> None:
    mount = CameraMount(0.0, 0.0, 0.0, 0.0, np.zeros((4, 4)))
    with pytest.raises(ValueError, match="height_m"):
        render(Scene(), CAMERAS["pinhole"], EMPTY, mount, POSE, np.random.default_rng(0))


def test_a_net_covers_what_its_threads_cover_and_hides_nothing() -> None:
    field, camera = load_field("spl"), CAMERAS["pinhole"]
    mount = CameraMount(0.4, 0.0, 0.0, 0.0, np.zeros((4, 4)))
    pose = np.array([2.0, 0.0, 0.0])
    pictures, truths = [], []
    for goals in (Goals(), Goals(net=True)):
        scene = Scene(goals=goals, ceiling=(0.0, 0.0, 0.0), turf=Turf(floor=(0.0, 0.0, 0.0)))
        picture, truth = render_with_truth(scene, camera, field, mount, pose, np.random.default_rng(0))
        pictures.append(picture.astype(np.float64))
        truths.append(truth)
    # the back of the net, before a black wall: threads of 4 mm, 8 cm apart, along both sides
    back = pictures[1][90:112, 110:210, 0]
    assert pictures[0][90:112, 110:210].max() == 0.0
    assert back.mean() / 235.0 == pytest.approx(1.0 - 0.95**2, rel=0.1)
    assert len(truths[0].lines) == len(truths[1].lines)
    for one, other in zip(truths[0].lines, truths[1].lines, strict=True):
        np.testing.assert_array_equal(one.ends_px, other.ends_px)
    assert np.array_equal(truths[0].hidden, truths[1].hidden)


def test_the_truth_names_the_crossings_in_sight_by_how_lines_meet() -> None:
    field = load_field("kidsize")
    kinds = [one.kind for one in crossings_of(field)]
    # corners of the field and of four areas; the halfway line and each area's sides end on another line; the goal
    # areas lie within the penalty areas, nothing passes through another line
    assert (kinds.count("L"), kinds.count("T"), kinds.count("X")) == (4 + 8, 2 + 8, 0)
    mount = CameraMount(0.5, 0.0, 0.3, 0.0, np.zeros((4, 4)))
    camera, pose = CAMERAS["pinhole"], np.array([1.5, 1.5, 0.3])
    _, truth = render_with_truth(Scene(), camera, field, mount, pose, np.random.default_rng(0))
    assert len(truth.crossings) > 2
    for one in truth.crossings:
        ends = [line.ends_px for line in truth.lines if line.line in one.lines]
        to_pieces = [np.cross([*(end[1] - end[0]), 0.0], [*(one.point_px - end[0]), 0.0])[2] for end in ends]
        lengths = [np.linalg.norm(end[1] - end[0]) for end in ends]
        assert np.abs(np.array(to_pieces) / lengths).min() < 0.01


def test_lines_that_pass_through_each_other_make_an_x() -> None:
    lines = np.array([[[0.0, 0.0], [4.0, 0.0]], [[1.0, -1.0], [1.0, 1.0]], [[3.0, 0.01], [3.0, 1.0]]])
    field = FieldMap("cross", lines, NO_CIRCLES, ())
    assert [(one.kind, one.lines) for one in crossings_of(field)] == [("X", (0, 1)), ("T", (0, 2))]
    np.testing.assert_allclose([one.point for one in crossings_of(field)], [[1.0, 0.0], [3.0, 0.0]], atol=1e-12)
