"""An ideal simulated camera sees exactly what geometry says."""

import math
from dataclasses import replace

import image_scene
import numpy as np
import pytest
from sight_course import DOWN, ideal, see, standing

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.factors import Factor, PoseFactor
from fieldloc.field import load_field
from fieldloc.ground import project_points
from fieldloc.measurements import ImageFeatures
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.pose import FloatArray
from fieldloc.view import visible_parts
from logs.schema import BY_KIND, decode, encode
from logs.simulate.clipping import on_image
from logs.simulate.sight import SimulatedCamera
from logs.simulate.vision_settings import HeadSettings, VisionSettings

FIELD = load_field("kidsize")
POSES = [[0.5, 0.2, 0.05], [-2.0, 1.5, 2.5], [3.4, -0.4, -0.3], [-1.0, -2.5, 1.2]]
BARREL = Camera("pinhole", 640, 480, 500.0, 505.0, 319.5, 239.5, (-0.3, 0.1, 0.001, -0.002))
FISHEYE = Camera("fisheye", 640, 480, 400.0, 400.0, 319.5, 239.5, (0.02, -0.01, 0.0, 0.0))


def _sorted(ends: list[FloatArray]) -> FloatArray:
    """Ends and lines in an order that does not depend on theirs."""
    each = [line[np.lexsort(line.T.round(3))] for line in ends]
    flat = np.array(each).reshape(-1, 4)
    return flat[np.lexsort(flat.T.round(3))]


def _length(ends: FloatArray) -> float:
    return math.dist(ends[0], ends[1])


@pytest.mark.parametrize("pose", POSES)
def test_lines_are_the_visible_parts_of_the_maps_lines(pose: list[float]) -> None:
    settings = ideal(HeadSettings(ball_every_s=3.0))
    images = see(standing(pose), FIELD, settings)
    assert len(images) == 150
    count = 0
    for image in images[::3]:
        in_robot = se2.apply(se2.inverse(np.array(pose)), FIELD.lines)
        parts, _ = visible_parts(settings.camera, image.mount, in_robot)
        pixels = project_points(settings.camera, image.mount, np.pad(parts, ((0, 0), (0, 0), (0, 1))))[0]
        expected = [ends for ends in pixels if _length(ends) >= settings.lines.least_length_px]
        count += len(expected)
        assert len(image.lines) == len(expected)
        seen = _sorted([line.ends_px for line in image.lines])
        np.testing.assert_allclose(seen, _sorted(expected), atol=1e-6)  # a crossing of the border, seen far away
    assert count > 50


@pytest.mark.parametrize("camera", [BARREL, FISHEYE])
def test_a_lens_bends_the_visible_parts(camera: Camera) -> None:
    settings = replace(ideal(HeadSettings(ball_every_s=0.0)), camera=camera)
    pose = np.array(POSES[0])
    for image in see(standing(pose, 4.0), FIELD, settings)[::5]:
        parts, index = visible_parts(camera, image.mount, se2.apply(se2.inverse(pose), FIELD.lines))
        pixels = project_points(camera, image.mount, np.pad(parts, ((0, 0), (0, 0), (0, 1))))[0]
        # a line that leaves and comes back through the lens is seen from its first to its last bit
        whole = [np.array([pixels[index == i][0, 0], pixels[index == i][-1, 1]]) for i in sorted(set(index.tolist()))]
        expected = [ends for ends in whole if _length(ends) >= settings.lines.least_length_px]
        seen = [line.ends_px for line in image.lines]
        assert len(seen) == len(expected)
        np.testing.assert_allclose(_sorted(seen), _sorted(expected), atol=1e-6)


def test_a_line_that_leaves_and_comes_back_through_the_lens_is_one() -> None:
    start, end = np.array([[-0.7, 0.512, 1.0]]), np.array([[0.7, 0.512, 1.0]])
    assert BARREL.project(start)[1].all()
    assert BARREL.project(end)[1].all()
    assert not BARREL.project(0.5 * (start + end))[1].any()  # bulges over the lower border
    low, high = on_image(BARREL, start, end)
    np.testing.assert_allclose([low, high], [[0.0], [1.0]], atol=1e-9)


@pytest.mark.parametrize("pose", POSES)
def test_posts_and_feet_are_those_of_the_other_scene(pose: list[float]) -> None:
    settings = ideal(HeadSettings(far_tilt_rad=0.05, ball_every_s=0.0))
    compared = 0
    for image in see(standing(pose), FIELD, settings):
        scene = image_scene.see(FIELD, np.array(pose), 0, np.random.default_rng(1), 0.0, image.mount)
        feet = {tuple(np.round(post.foot_px, 5)): post for post in image.posts if post.foot_px is not None}
        for post in scene.posts:
            assert post.foot_px is not None
            seen = feet[tuple(np.round(post.foot_px, 5))]
            np.testing.assert_allclose(seen.foot_px, post.foot_px, atol=1e-9)
            level = project_points(settings.camera, image.mount, np.array([[9.0, 0.0, image.mount.height_m]]))[0]
            if 0.0 < level[0, 1] < 479.0:  # otherwise the other scene takes its edges near the foot
                np.testing.assert_allclose(seen.edges_px, post.edges_px, atol=1e-9)
                compared += 1
    if pose[2] in (0.05, -0.3):  # these look at a goal
        assert compared > 40


def test_without_noise_the_logged_mount_is_the_true_one() -> None:
    camera = SimulatedCamera(ideal(HeadSettings()), np.random.default_rng(3))
    course = standing(POSES[1])
    shots = camera.shots(course)
    for index, (log_time_ns, image) in enumerate(camera.images(course, FIELD)):
        shot = shots.shot(index)
        assert (log_time_ns, image.stamp_ns) == (shot.stamp_ns, shot.stamp_ns)
        np.testing.assert_array_equal(shot.pose, POSES[1])
        places = [(m.x_m, m.y_m, m.height_m, m.pan_rad, m.tilt_rad, m.roll_rad) for m in (shot.mount, image.mount)]
        np.testing.assert_allclose(*places, atol=1e-12)
    assert index == len(shots) - 1


def test_the_neck_carries_the_camera_forward_and_down_as_it_nods() -> None:
    (image, *_) = see(standing([0, 0, 0], 0.1), FIELD, ideal(DOWN))
    # 3 cm ahead of and 8 cm above an axis at 47 cm, turned by 0.3 rad
    assert image.mount.x_m == pytest.approx(0.03 * math.cos(0.3) + 0.08 * math.sin(0.3))
    assert image.mount.height_m == pytest.approx(0.47 + 0.08 * math.cos(0.3) - 0.03 * math.sin(0.3))
    assert (image.mount.pan_rad, image.mount.tilt_rad) == pytest.approx((0.0, 0.3))


def _likeliest(builder: MixtureBuilder, image: ImageFeatures, about: FloatArray) -> tuple[Factor, ...]:
    """What the image says to a robot that roughly knows where it is, if it is more than nothing."""
    mixture = builder.build(image)
    if mixture is None:
        return ()
    near = mixture.expand(about[None], np.diag([0.2, 0.2, 0.1])[None] ** 2)
    if not len(near.ids) or near.evidence.max() < mixture.log_outlier:
        return ()
    return mixture.chosen(int(near.ids[np.argmax(near.evidence)]))


@pytest.mark.parametrize("pose", POSES)
def test_an_ideal_image_gives_back_the_pose(pose: list[float]) -> None:
    settings = ideal(HeadSettings(ball_every_s=0.0))
    builder = MixtureBuilder(FIELD, settings.camera)
    truth = np.array(pose)
    fixes = 0
    for image in see(standing(pose, 4.9), FIELD, settings):
        for factor in _likeliest(builder, image, se2.retract(truth, np.array([0.1, -0.08, 0.05]))):
            # the line solver stops where its last step is 1e-4 sigmas long, some 1e-5 metres
            np.testing.assert_allclose(factor.error(truth), 0.0, atol=1e-4)
            fixes += isinstance(factor, PoseFactor)
    assert fixes > 10


def test_a_moving_robot_is_seen_where_it_is_at_the_stamp() -> None:
    settings = ideal(HeadSettings(ball_every_s=0.0))
    course = standing([0.5, 0.2, 0.0], 8.0, turn_radps=1.2)
    builder = MixtureBuilder(FIELD, settings.camera)
    fixes = 0
    for image in see(course, FIELD, settings):
        truth = course.poses_at(np.array(image.stamp_ns))
        for factor in _likeliest(builder, image, truth):
            np.testing.assert_allclose(factor.error(truth), 0.0, atol=1e-4)
            fixes += 1
    assert fixes > 50


def test_a_detector_knows_no_names_and_no_order() -> None:
    images = see(standing(POSES[0]), FIELD, ideal(DOWN))
    assert {post.label for image in images for post in image.posts} == {None}
    firsts = {tuple(np.sort(image.lines[0].ends_px, axis=0).round(6).ravel()) for image in images}
    assert len(firsts) == len(images[0].lines) > 3
    left_first = {bool(image.posts[0].edges_px[0, 0] < image.posts[1].edges_px[0, 0]) for image in images}
    assert left_first == {True, False}
    directions = {bool(image.lines[0].ends_px[0, 0] < image.lines[0].ends_px[1, 0]) for image in images}
    assert directions == {True, False}


def _bits(images: list[tuple[int, ImageFeatures]]) -> list[object]:
    return [
        (
            time,
            image.stamp_ns,
            repr(image.mount),
            [(p.edges_px.tobytes(), p.foot_px is None or p.foot_px.tobytes()) for p in image.posts],
            [line.ends_px.tobytes() for line in image.lines],
        )
        for time, image in images
    ]


def test_a_seed_gives_one_game_bit_for_bit() -> None:
    course = standing(POSES[0], 60.0, steps_hz=3.0, others=[[2.0, 0.3], [3.0, -1.0]])
    first, again, other = (
        _bits(list(SimulatedCamera(VisionSettings(), np.random.default_rng(seed)).images(course, FIELD)))
        for seed in (1, 1, 2)
    )
    assert first == again
    assert first != other


def test_a_camera_can_be_asked_twice() -> None:
    camera = SimulatedCamera(VisionSettings(), np.random.default_rng(4))
    course = standing(POSES[0], 20.0)
    assert _bits(list(camera.images(course, FIELD))) == _bits(list(camera.images(course, FIELD)))


def test_what_is_seen_survives_the_log() -> None:
    course = standing(POSES[0], 20.0, steps_hz=3.0, others=[[2.0, 0.3], [np.nan, np.nan]])
    images = list(SimulatedCamera(VisionSettings(), np.random.default_rng(1)).images(course, FIELD))
    feet = 0
    for _, image in images:
        again = decode(BY_KIND[ImageFeatures], "/image_features", encode(image))
        assert isinstance(again, ImageFeatures)
        assert _bits([(0, again)]) == _bits([(0, image)])
        feet += sum(post.foot_px is not None for post in image.posts)
    assert feet > 20


def test_everything_seen_is_on_the_image() -> None:
    noisy = replace(VisionSettings(), noise=replace(VisionSettings().noise, sigma_px=5.0))
    camera = noisy.camera
    for image in see(standing(POSES[0], 60.0, steps_hz=3.0), FIELD, noisy):
        points = [line.ends_px for line in image.lines] + [post.edges_px for post in image.posts]
        points += [post.foot_px[None] for post in image.posts if post.foot_px is not None]
        for pixels in points:
            # an end cut at the border may miss it by rounding
            assert (pixels > -0.5 - 1e-9).all()
            assert (pixels < np.array([camera.width_px, camera.height_px]) - 0.5 + 1e-9).all()
