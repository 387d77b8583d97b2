"""What a simulated detector misses, adds and gets wrong, against the numbers that were asked for."""

import math
from dataclasses import replace

import numpy as np
import pytest
from sight_course import DOWN, LEVEL, LINE_ONLY, POST_ONLY, ideal, see, standing

from fieldloc.field import FieldMap, load_field
from fieldloc.ground import robot_ground_points
from fieldloc.measurements import ImageFeatures
from fieldloc.pose import FloatArray
from logs.simulate.sight import SimulatedCamera
from logs.simulate.vision_settings import VisionSettings

EXACT = ideal(LEVEL)
DOWNWARD = ideal(DOWN)
NOWHERE = FieldMap("far", np.array([[[900.0, 0.0], [900.0, 1.0]]]), np.zeros((0, 3)), ())
CIRCLE = FieldMap("circle", np.zeros((0, 2, 2)), np.array([[0.0, 0.0, 0.75]]), ())
LONG = 200.0  # seconds: 3000 images


def _on_ground(image: ImageFeatures, settings: VisionSettings) -> FloatArray:
    """(m, 2, 2) of the lines' ends in the robot frame, as the logged mount has it."""
    pixels = np.array([line.ends_px for line in image.lines]).reshape(-1, 2, 2)
    points, mask = robot_ground_points(settings.camera, image.mount, pixels)
    assert mask.all()
    return points


def _within_four_sigmas(count: int, trials: int, chance: float) -> bool:
    return abs(count - trials * chance) <= 4.0 * math.sqrt(trials * chance * (1.0 - chance))


@pytest.mark.parametrize("range_m", [1.5, 4.0, 5.0, 6.5])
def test_posts_are_found_by_range(range_m: float) -> None:
    posts = replace(EXACT.posts, near_chance=0.9, half_range_m=5.0, range_scale_m=0.5)
    # the camera is 3 cm ahead of the robot
    images = see(standing([-range_m - 0.03, 0.0, 0.0], LONG), POST_ONLY, replace(EXACT, posts=posts))
    found = sum(len(image.posts) for image in images)
    assert _within_four_sigmas(found, len(images), 0.9 / (1.0 + math.exp((range_m - 5.0) / 0.5)))


@pytest.mark.parametrize("range_m", [1.5, 3.0, 4.5])
def test_lines_are_found_by_the_range_of_their_pictures_middle(range_m: float) -> None:
    lines = replace(DOWNWARD.lines, near_chance=0.9, half_range_m=3.2, range_scale_m=0.5)
    narrow = FieldMap("line", LINE_ONLY.lines * [1.0, 0.05], np.zeros((0, 3)), ())
    course = standing([-range_m, 0.0, 0.0], LONG)
    images = see(course, narrow, replace(DOWNWARD, lines=replace(lines, least_length_px=1.0)))
    mount = images[0].mount
    distance_m = math.hypot(range_m - mount.x_m, 0.15, mount.height_m)  # both ends are as far
    found = sum(len(image.lines) for image in images)
    assert _within_four_sigmas(found, len(images), 0.9 / (1.0 + math.exp((distance_m - 3.2) / 0.5)))


def test_the_middle_of_a_picture_is_nearer_than_the_middle_of_the_line() -> None:
    ahead = FieldMap("ahead", np.array([[[2.0, 0.1], [8.0, 0.1]]]), np.zeros((0, 3)), ())
    lines = replace(EXACT.lines, half_range_m=3.0, range_scale_m=1e-6)
    seen = [len(see(standing([x, 0.0, 0.0], 1.0), ahead, replace(EXACT, lines=lines))[0].lines) for x in (0.0, 0.4)]
    # from 2 to 8 m: the picture's middle is at 3.2 m, 2.8 m from a robot closer by 0.4 m
    assert seen == [0, 1]


def test_nothing_smaller_than_told_is_found() -> None:
    posts = replace(EXACT.posts, least_width_px=10.0)
    near, far = (see(standing([-r, 0.0, 0.0], 1.0), POST_ONLY, replace(EXACT, posts=posts)) for r in (4.9, 5.1))
    assert all(image.posts for image in near)  # 500 px * 0.1 m / 4.9 m
    assert not any(image.posts for image in far)
    tall = replace(EXACT, posts=replace(EXACT.posts, least_height_px=150.0))
    assert see(standing([-3.9, 0.0, 0.0], 1.0), POST_ONLY, tall)[0].posts  # 500 px * 1.2 m / 3.9 m
    assert not see(standing([-4.1, 0.0, 0.0], 1.0), POST_ONLY, tall)[0].posts
    short = FieldMap("short", LINE_ONLY.lines * [1.0, 0.05], np.zeros((0, 3)), ())  # 0.3 m
    for range_m, length_px, seen in ((3.0, 40.0, True), (3.0, 60.0, False)):
        settings = replace(DOWNWARD, lines=replace(DOWNWARD.lines, least_length_px=length_px))
        assert bool(see(standing([-range_m, 0.0, 0.0], 1.0), short, settings)[0].lines) is seen


@pytest.mark.parametrize("turn_radps", [1.0, 2.0])
def test_a_turning_head_finds_less_and_less_sharply(turn_radps: float) -> None:
    exposure = replace(EXACT.noise, exposure_s=0.01, blur_share=0.5)
    posts = replace(EXACT.posts, blur_half_px=5.0)
    settings = replace(EXACT, noise=exposure, posts=posts)
    course = standing([-2.0, 0.0, -0.4], 0.8 / turn_radps, turn_radps=turn_radps)
    blur_px = 500.0 * 0.01 * turn_radps
    found = images = 0
    for seed in range(150):
        for image in see(course, POST_ONLY, settings, seed):
            images += 1
            found += len(image.posts)
            for post in image.posts:
                np.testing.assert_allclose(post.covariance_px2, (0.5 * blur_px) ** 2 * np.eye(4), rtol=1e-6)
    assert _within_four_sigmas(found, images, 1.0 / (1.0 + (blur_px / 5.0) ** 2))


def test_pixel_noise_is_as_wide_as_told_and_as_claimed() -> None:
    noise = replace(EXACT.noise, sigma_px=0.5, sigma_px_per_m=0.25, foot_sigma_ratio=3.0, claim_ratio=0.8)
    settings = replace(DOWNWARD, noise=noise)
    course = standing([-2.0, 0.0, 0.0], LONG)
    (clean,) = see(course, POST_ONLY, DOWNWARD)[0].posts
    posts = [image.posts[0] for image in see(course, POST_ONLY, settings)]
    range_m = 2.0 - see(course, POST_ONLY, DOWNWARD)[0].mount.x_m
    sigma = 0.5 + 0.25 * range_m
    edges = np.array([post.edges_px - clean.edges_px for post in posts]).reshape(-1, 4)
    assert edges.std() == pytest.approx(sigma, rel=0.03)
    np.testing.assert_allclose(np.corrcoef(edges.T), np.eye(4), atol=0.08)
    assert np.abs(edges.mean(axis=0)).max() < 4.0 * sigma / math.sqrt(len(posts))
    assert clean.foot_px is not None
    feet = np.array([post.foot_px - clean.foot_px for post in posts if post.foot_px is not None])
    assert feet.std() == pytest.approx(3.0 * sigma, rel=0.04)
    np.testing.assert_allclose(posts[0].covariance_px2, (0.8 * sigma) ** 2 * np.eye(4))
    np.testing.assert_allclose(posts[0].foot_covariance_px2, (2.4 * sigma) ** 2 * np.eye(2))


def test_line_ends_are_noisier_the_farther_they_are() -> None:
    noise = replace(EXACT.noise, sigma_px=0.5, sigma_px_per_m=0.3)
    ahead = FieldMap("ahead", np.array([[[2.0, 0.0], [6.0, 0.5]]]), np.zeros((0, 3)), ())
    course = standing([0.0, 0.0, 0.0], LONG)
    (clean,) = see(course, ahead, DOWNWARD)[0].lines
    mount = see(course, ahead, DOWNWARD)[0].mount
    clean_ends = clean.ends_px[np.argsort(-clean.ends_px[:, 1])]  # near first
    offsets, claims = [], []
    for image in see(course, ahead, replace(DOWNWARD, noise=noise)):
        (line,) = image.lines
        order = np.argsort(-line.ends_px[:, 1])
        offsets.append(line.ends_px[order] - clean_ends)
        claims.append(np.sqrt(np.diagonal(line.covariance_px2)).reshape(2, 2)[order])
    distance_m = [math.hypot(x - mount.x_m, y, mount.height_m) for x, y in ((2.0, 0.0), (6.0, 0.5))]
    expected = 0.5 + 0.3 * np.array(distance_m)
    np.testing.assert_allclose(np.std(offsets, axis=0).mean(axis=1), expected, rtol=0.04)
    np.testing.assert_allclose(np.mean(claims, axis=0), np.repeat(expected[:, None], 2, axis=1))


def test_a_detector_never_claims_to_be_exact() -> None:
    image = see(standing([-2.0, 0.0, 0.0], 1.0), POST_ONLY, DOWNWARD)[0]
    np.testing.assert_allclose(image.posts[0].covariance_px2, 0.01 * np.eye(4))
    np.testing.assert_allclose(image.posts[0].foot_covariance_px2, 0.01 * np.eye(2))


def test_shortened_lines_end_inside_and_keep_their_direction() -> None:
    course = standing([-2.0, 0.3, 0.2], LONG)
    (whole,) = see(course, LINE_ONLY, DOWNWARD)[0].lines
    along = whole.ends_px[1] - whole.ends_px[0]
    length = float(np.linalg.norm(along))
    lost = []
    for image in see(course, LINE_ONLY, replace(DOWNWARD, lines=replace(DOWNWARD.lines, shortened_share=0.2))):
        (line,) = image.lines
        away = line.ends_px - whole.ends_px[0]
        np.testing.assert_allclose(away @ np.array([-along[1], along[0]]) / length, 0.0, atol=1e-9)
        shares = np.sort(away @ along) / length**2
        lost += [shares[0], 1.0 - shares[1]]
    # shares of the picture, evenly spread
    assert min(lost) >= -1e-12
    assert max(lost) <= 0.2 + 1e-12
    assert np.mean(lost) == pytest.approx(0.1, abs=0.003)
    assert np.std(lost) == pytest.approx(0.2 / math.sqrt(12.0), rel=0.05)


def test_split_lines_are_two_parts_of_one() -> None:
    course = standing([-2.0, 0.3, 0.2], LONG)
    (whole,) = see(course, LINE_ONLY, DOWNWARD)[0].lines
    along = whole.ends_px[1] - whole.ends_px[0]
    length = float(np.linalg.norm(along))
    images = see(course, LINE_ONLY, replace(DOWNWARD, lines=replace(DOWNWARD.lines, split_chance=0.3)))
    split = [image.lines for image in images if len(image.lines) == 2]
    assert _within_four_sigmas(len(split), len(images), 0.3)
    assert {len(image.lines) for image in images} == {1, 2}
    for pair in split:
        away = np.concatenate([line.ends_px for line in pair]) - whole.ends_px[0]
        np.testing.assert_allclose(away @ np.array([-along[1], along[0]]) / length, 0.0, atol=1e-9)
        shares = np.sort(away @ along) / length**2
        assert shares[[0, 3]] == pytest.approx([0.0, 1.0], abs=1e-9)
        assert 0.04 - 1e-9 <= shares[2] - shares[1] <= 0.15 + 1e-9
        assert 0.2 < shares[1] < shares[2] < 0.8


def test_arcs_of_a_circle_are_found_as_its_chords() -> None:
    settings = replace(DOWNWARD, lines=replace(DOWNWARD.lines, chord_chance=0.5))
    radii, angles, count = [], [], 0
    for image in see(standing([-1.8, 0.0, 0.0], 100.0), CIRCLE, settings):
        points = _on_ground(image, settings) - [1.8, 0.0]
        count += len(points)
        radii += np.linalg.norm(points, axis=-1).ravel().tolist()
        angles += np.arctan2(points[..., 1], points[..., 0]).ravel().tolist()
    np.testing.assert_allclose(radii, 0.75, atol=1e-9)  # all of it is in sight
    assert len(np.unique(np.round(angles, 6))) > 1000  # not always the same arcs
    assert count / 1500.0 == pytest.approx(4.0, abs=1.2)  # eight arcs but those too short in the picture
    assert see(standing([-1.8, 0.0, 0.0], 1.0), CIRCLE, DOWNWARD)[0].lines == ()


def test_the_carpets_border_is_taken_for_a_line_now_and_then() -> None:
    field = load_field("kidsize")
    lines = replace(EXACT.lines, border_chance=0.3, border_m=0.8)
    course = standing([3.0, 0.0, 0.0], LONG)
    settings = replace(EXACT, lines=lines)
    border = 0
    for image in see(course, field, settings):
        points = _on_ground(image, settings)
        border += int(np.sum(np.abs(points[..., 0] - (4.5 + 0.8 - 3.0)).max(axis=1) < 1e-6))
    assert _within_four_sigmas(border, 3000, 0.3)


def test_ghosts_are_as_many_as_told() -> None:
    settings = replace(
        EXACT, posts=replace(EXACT.posts, ghost_chance=0.1), lines=replace(EXACT.lines, ghost_chance=0.2)
    )
    images = see(standing([0, 0, 0], LONG), NOWHERE, settings)
    assert _within_four_sigmas(sum(len(image.posts) for image in images), 3000, 0.1)
    assert _within_four_sigmas(sum(len(image.lines) for image in images), 3000, 0.2)
    assert all(post.foot_px is not None for image in images for post in image.posts)


def test_people_stand_beside_the_field_and_are_taken_for_posts() -> None:
    field = FieldMap("box", load_field("kidsize").lines, np.zeros((0, 3)), ())
    settings = replace(EXACT, posts=replace(EXACT.posts, people=40, person_chance=1.0))
    images = see(standing([0.0, 0.0, 0.0], 2.0), field, settings)
    feet = {tuple(np.round(post.foot_px, 6)) for image in images for post in image.posts if post.foot_px is not None}
    assert len(feet) == len(images[0].posts) > 4  # they do not move
    points, _ = robot_ground_points(settings.camera, images[0].mount, np.array(sorted(feet)))
    outside = np.max(np.abs(points) - [4.5, 3.0], axis=1)
    assert (outside > 0.4).all()  # their feet's near sides
    assert (outside < 1.6).all()
    rare = replace(EXACT, posts=replace(EXACT.posts, people=40, person_chance=0.1))
    found = sum(len(image.posts) for image in see(standing([0.0, 0.0, 0.0], LONG), field, rare))
    assert _within_four_sigmas(found, 3000 * len(feet), 0.1)


def test_robots_legs_are_taken_for_posts() -> None:
    settings = replace(EXACT, posts=replace(EXACT.posts, robot_chance=0.2))
    course = standing([0.0, 0.0, 0.0], LONG, others=[[3.0, 0.5], [np.nan, np.nan], [-2.0, 0.0]])
    images = see(course, NOWHERE, settings)
    assert _within_four_sigmas(sum(len(image.posts) for image in images), 3000, 0.2)
    post = next(image.posts[0] for image in images if image.posts)
    assert post.foot_px is not None
    point, _ = robot_ground_points(settings.camera, images[0].mount, post.foot_px)
    assert np.linalg.norm(point - [3.0, 0.5]) == pytest.approx(0.05)


def test_the_claimed_mount_is_that_of_the_driver_and_read_only() -> None:
    (first, second) = see(standing([0, 0, 0], 0.2), POST_ONLY, VisionSettings())[:2]
    np.testing.assert_allclose(np.sqrt(np.diagonal(first.mount.covariance)), [0.012, 0.022, 0.027, 0.023])
    assert first.mount.covariance is second.mount.covariance
    assert not first.mount.covariance.flags.writeable


def test_the_default_errors_are_as_large_as_claimed() -> None:
    """A driver that claims too much or too little is a choice, not the default."""
    course = standing([0, 0, 0], 4.0, steps_hz=3.0)
    offs = []
    for seed in range(300):
        shots = SimulatedCamera(VisionSettings(), np.random.default_rng(seed)).shots(course)
        offs.append((shots.real.places - shots.believed.places)[20::10, 2:])
    claimed = VisionSettings().mount
    sigma = [claimed.claimed_height_m, claimed.claimed_pan_rad, claimed.claimed_tilt_rad, claimed.claimed_roll_rad]
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(np.concatenate(offs)), axis=0)), sigma, rtol=0.15)
