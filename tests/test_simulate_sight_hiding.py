"""Other robots hide what is behind them, and only that."""

import math
from dataclasses import replace

import numpy as np
import pytest
from sight_course import DOWN, LEVEL, LINE_ONLY, POST_ONLY, ideal, see, standing

from fieldloc import pose as se2
from fieldloc.ground import robot_ground_points
from fieldloc.pose import FloatArray
from logs.simulate.hiding import hidden_below, hidden_part
from logs.simulate.vision_settings import OtherRobotSettings, VisionSettings

LOOK = ideal(DOWN)
BEFORE_POST = [-1.0, 0.0]


def _hits_robot(eye: FloatArray, point: FloatArray, robot: FloatArray, settings: OtherRobotSettings) -> bool:
    """Whether the line of sight passes through the cylinder: looked at in small steps."""
    shares = np.linspace(0.0, 1.0, 4001)[:, None]
    on_way = eye + shares * (point - eye)
    inside = np.linalg.norm(on_way[:, :2] - robot, axis=1) < settings.radius_m
    return bool((inside & (on_way[:, 2] < settings.height_m)).any())


@pytest.mark.parametrize("height_m", [0.3, 0.55, 0.8])
def test_the_hidden_part_of_a_line_is_what_lines_of_sight_through_the_robot_meet(height_m: float) -> None:
    settings = OtherRobotSettings(height_m=height_m)
    random = np.random.default_rng(1)
    some = 0
    for _ in range(60):
        eye = np.array([0.0, 0.0, 0.55])
        robot = random.uniform([0.5, -1.0], [2.0, 1.0])
        start, end = random.uniform([0.3, -2.0], [5.0, 2.0], (2, 2))
        low, high = (float(each[0]) for each in hidden_part(eye[None], robot[None], settings, start[None], end[None]))
        some += high > low
        for share in np.linspace(0.0, 1.0, 41):
            point = start + share * (end - start)
            distance = np.linalg.norm(robot)
            ahead = robot / distance
            along, across = point @ ahead, abs(point @ np.array([-ahead[1], ahead[0]]))
            width = along * 0.2 / math.sqrt(distance**2 - 0.04)
            reach = (distance + 0.2) * 0.55 / (0.55 - height_m) if height_m < 0.55 else np.inf
            # the shadow has corners beside the robot's near side and at its far end, where in truth it is round
            in_corner = distance - 0.21 < along < distance and np.linalg.norm(point - robot) > 0.19
            doubtful = in_corner or abs(across - width) < 0.01 or reach - 0.7 < along < reach + 0.01
            if doubtful or not 0.0 < share < 1.0:
                continue
            truly = _hits_robot(eye, np.append(point, 0.0), robot, settings)
            assert (low < share < high) == truly
    assert some > 10


def test_posts_are_hidden_up_to_where_lines_of_sight_pass_the_robot() -> None:
    random = np.random.default_rng(2)
    both = set()
    for _ in range(300):
        settings = OtherRobotSettings(height_m=float(random.uniform(0.3, 0.8)))
        eye = np.array([[0.0, 0.0, 0.55]])
        robot, point = random.uniform([0.5, -0.5], [2.0, 0.5]), random.uniform([0.5, -0.8], [4.0, 0.8])
        below = float(hidden_below(eye, robot[None, None], settings, point[None, None])[0, 0])
        if abs(np.linalg.norm(point) - np.linalg.norm(robot)) < 0.25:
            continue
        across = abs(point[0] * robot[1] - point[1] * robot[0]) / np.linalg.norm(point)
        if abs(across - 0.2) < 0.01:
            continue
        both.add(below > 0.0)
        for height in np.linspace(0.0, 1.2, 13):
            # within the robot's own width the ray goes up or down by this much
            slack = 0.2 * abs(height - 0.55) / np.linalg.norm(robot) * np.linalg.norm(point) + 0.01
            if abs(height - below) > slack:
                assert (height < below) == _hits_robot(eye[0], np.append(point, height), robot, settings)
    assert both == {True, False}


def test_a_line_is_cut_by_a_robot_in_front_of_it() -> None:
    course = standing([-2.0, 0.0, 0.0], 2.0, others=[[-1.0, 0.1]])
    for image in see(course, LINE_ONLY, LOOK):
        assert len(image.lines) == 2
        pixels = np.array([line.ends_px for line in image.lines])
        points = robot_ground_points(LOOK.camera, image.mount, pixels)[0]
        across = np.sort(se2.apply(np.array([-2.0, 0.0, 0.0]), points)[..., 1].ravel())
        eye = np.array([-2.0 + image.mount.x_m, 0.0])
        to_robot = np.array([-1.0, 0.1]) - eye
        bearing, half = math.atan2(to_robot[1], to_robot[0]), math.asin(0.2 / np.linalg.norm(to_robot))
        expected = [math.tan(bearing + side * half) * -eye[0] for side in (-1.0, 1.0)]
        np.testing.assert_allclose(across[1:3], expected, atol=1e-9)


def test_a_cut_line_is_merged_as_often_as_told() -> None:
    course = standing([-2.0, 0.0, 0.0], 100.0, others=[[-0.8, 0.3], [-0.8, -0.3]])
    apart = {len(image.lines) for image in see(course, LINE_ONLY, LOOK)}
    assert apart == {3}
    lines = replace(LOOK.lines, merge_chance=0.4)
    images = see(course, LINE_ONLY, replace(LOOK, lines=lines))
    whole = [image.lines[0].ends_px for image in images if len(image.lines) == 1]
    assert abs(len(whole) - 0.4 * 1500) < 4.0 * math.sqrt(1500 * 0.4 * 0.6)
    alone = see(standing([-2.0, 0.0, 0.0], 1.0), LINE_ONLY, LOOK)[0].lines[0].ends_px
    for ends in whole:
        np.testing.assert_allclose(np.sort(ends, axis=0), np.sort(alone, axis=0), atol=1e-9)


def _posts_beside(robots: list[list[float]], settings: VisionSettings = LOOK) -> list[tuple[int, bool]]:
    """How many posts and whether the first has a foot, image by image, 2 m in front of the post."""
    images = see(standing([-2.0, 0.0, 0.0], 1.0, others=robots), POST_ONLY, settings)
    return [(len(image.posts), bool(image.posts) and image.posts[0].foot_px is not None) for image in images]


def test_a_post_behind_a_robot_loses_its_foot() -> None:
    assert set(_posts_beside([[9.0, 9.0]])) == {(1, True)}
    level = ideal(LEVEL)
    assert set(_posts_beside([BEFORE_POST], level)) == {(1, False)}
    (image, *_) = see(standing([-2.0, 0.0, 0.0], 1.0, others=[BEFORE_POST]), POST_ONLY, level)
    horizon = level.camera.cy_px
    assert (image.posts[0].edges_px[:, 1] <= horizon).all()  # above the robot


def test_a_post_behind_a_tall_robot_is_lost() -> None:
    tall = replace(ideal(LEVEL), robots=OtherRobotSettings(height_m=1.0))
    assert set(_posts_beside([BEFORE_POST], tall)) == {(0, False)}


def test_a_robot_beside_or_behind_a_post_hides_nothing() -> None:
    assert set(_posts_beside([[1.0, 0.0]])) == {(1, True)}
    assert set(_posts_beside([[-1.0, 0.5]])) == {(1, True)}
    assert set(_posts_beside([[np.nan, np.nan]])) == {(1, True)}


def test_hiding_can_be_turned_off() -> None:
    glass = replace(LOOK, robots=OtherRobotSettings(hide=False))
    assert set(_posts_beside([BEFORE_POST], glass)) == {(1, True)}
    course = standing([-2.0, 0.0, 0.0], 1.0, others=[BEFORE_POST])
    assert {len(image.lines) for image in see(course, LINE_ONLY, glass)} == {1}


def test_a_robot_at_the_cameras_feet_is_survived() -> None:
    for others in ([[-2.0, 0.0]], [[-1.97, 0.0]], [[-1.9, 0.05]]):
        course = standing([-2.0, 0.0, 0.0], 1.0, others=others)
        for image in see(course, LINE_ONLY, VisionSettings()):
            assert all(np.isfinite(line.ends_px).all() for line in image.lines)
