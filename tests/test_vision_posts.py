from pathlib import Path

import numpy as np
import pytest

from fieldloc.camera import Camera
from fieldloc.colours import COLOURS, FieldColours
from fieldloc.field import load_field
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray
from fieldloc.render import Goals, Scene, Sensor, Truth, render_with_truth
from fieldloc.vision.detections import SeenPost
from fieldloc.vision.picture import UInt8Array, load_picture
from fieldloc.vision.posts import find_posts
from fieldloc.vision.turf import find_turf

CAMERA = Camera("pinhole", 640, 480, 600.0, 600.0, 319.5, 239.5)
DATA = Path(__file__).parents[2] / "shared" / "data"


def view(name: str, pose: tuple[float, float, float], scene: Scene, camera: Camera = CAMERA, seed: int = 1):
    field = load_field(name)
    mount = CameraMount(0.5, 0.0, 0.08, 0.02, np.zeros((4, 4)))
    return *render_with_truth(scene, camera, field, mount, np.array(pose), np.random.default_rng(seed)), field.colours


def seen(picture: UInt8Array, colours: FieldColours, camera: Camera | None = None) -> tuple[SeenPost, ...]:
    return find_posts(picture, find_turf(picture), colours, camera)


def u_at(edge: FloatArray, v: float) -> float:
    return float(np.interp(v, edge[:, 1], edge[:, 0]))


def pairs(
    posts: tuple[SeenPost, ...], truth: Truth
) -> list[tuple[SeenPost, FloatArray, FloatArray, FloatArray | None]]:
    """Each true post whose two edges are seen, with the one found there."""
    out = []
    for true in truth.posts:
        if true.left_px is None or true.right_px is None:
            continue
        v = float(true.left_px[:, 1].mean())
        for post in posts:
            if abs(u_at(post.left_px, v) - u_at(true.left_px, v)) < 2.0:
                out.append((post, true.left_px, true.right_px, true.foot_px))
    return out


@pytest.mark.parametrize(("name", "x"), [("spl", 1.5), ("kidsize", 0.0), ("kidsize-2014", -0.5), ("adultsize", 0.5)])
def test_both_posts_of_a_goal_are_found_to_a_fraction_of_a_pixel_whatever_their_colour(name: str, x: float) -> None:
    picture, truth, colours = view(name, (x, 0.4, -0.05), Scene())
    found = seen(picture, colours)
    assert len(found) == 2
    matched = pairs(found, truth)
    assert len(matched) == 2
    for post, left, right, foot in matched:
        for edge, true in ((post.left_px, left), (post.right_px, right)):
            v = 0.5 * (max(edge[0, 1], true[0, 1]) + min(edge[1, 1], true[1, 1]))
            assert u_at(edge, v) == pytest.approx(u_at(true, v), abs=0.15)
        assert post.foot_px is not None
        assert foot is not None
        assert np.allclose(post.foot_px, foot, atol=[0.2, 0.7])
        assert post.top_px is not None


def test_edges_err_by_what_their_covariance_says() -> None:
    normalized = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        sensor = Sensor(rng.uniform(0.5, 0.9), read_noise=2.0, shot_noise=3.0, gamma=rng.uniform(1.0, 2.2))
        scene = Scene(goals=Goals(shading=rng.uniform(0.0, 0.3)), sensor=sensor)
        pose = rng.uniform(-1.0, 2.0), rng.uniform(-1.0, 1.0), rng.uniform(-0.2, 0.2)
        picture, truth, colours = view("spl", pose, scene, seed=seed)
        for post, left, right, _ in pairs(seen(picture, colours), truth):
            for edge, true, first in ((post.left_px, left, 0), (post.right_px, right, 4)):
                v = np.array([0.2, 0.8]) * (true[1, 1] - true[0, 1]) + true[0, 1]
                share = (v - edge[0, 1]) / (edge[1, 1] - edge[0, 1])
                normal = np.array([1.0, -(edge[1, 0] - edge[0, 0]) / (edge[1, 1] - edge[0, 1])])
                normal /= np.linalg.norm(normal)
                mix = np.hstack([(1.0 - share)[:, None] * normal, share[:, None] * normal])
                covariance = mix @ post.covariance_px2[first : first + 4, first : first + 4] @ mix.T
                error = normal[0] * np.array([u_at(edge, row) - u_at(true, row) for row in v])
                normalized.append(error @ np.linalg.solve(covariance, error) / 2.0)
    assert len(normalized) >= 20
    # tone and shading are the same on all edges of one picture: ten pictures are few, so the bounds are wide
    assert 0.15 < np.median(normalized) < 2.5


def test_a_fisheye_s_posts_are_straight_once_its_camera_is_given() -> None:
    wide = Camera("fisheye", 640, 480, 330.0, 330.0, 319.5, 239.5, (0.02, 0.0, 0.0, 0.0))
    picture, truth, colours = view("spl", (2.6, 0.3, 0.5), Scene(), wide)
    for post, left, right, _ in pairs(seen(picture, colours, wide), truth):
        for edge, true in ((post.left_px, left), (post.right_px, right)):
            # a true edge is given by its ends, and bends between them by less than this
            v = true[0, 1] + 0.1 * (true[1, 1] - true[0, 1])
            assert u_at(edge, v) == pytest.approx(u_at(true, v), abs=1.0)


def test_a_post_of_another_colour_is_none() -> None:
    picture, _, _ = view("spl", (1.5, 0.4, -0.05), Scene())
    assert seen(picture, FieldColours((COLOURS["yellow"],))) == ()


def test_a_post_s_covariance_is_that_of_a_matrix_and_lies_across_its_edges() -> None:
    picture, _, colours = view("spl", (1.5, 0.4, -0.05), Scene(sensor=Sensor(read_noise=3.0)))
    for post in seen(picture, colours):
        values = np.linalg.eigvalsh(post.covariance_px2)
        assert values[0] > -1e-9
        assert np.count_nonzero(values > 1e-9) <= 4
        along = post.left_px[1] - post.left_px[0]
        along /= np.linalg.norm(along)
        assert along @ post.covariance_px2[:2, :2] @ along < 1e-9
        assert post.observation().covariance_px2.shape == (4, 4)


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((480, 640, 3), dtype=np.uint8),
        np.full((480, 640, 3), 255, dtype=np.uint8),
        np.full((480, 640, 3), (40, 140, 40), dtype=np.uint8),
        np.random.default_rng(1).integers(0, 256, (480, 640, 3), dtype=np.uint8),
        np.full((480, 1, 3), (40, 140, 40), dtype=np.uint8),
        np.full((1, 640, 3), (40, 140, 40), dtype=np.uint8),
    ],
    ids=["black", "white", "green", "noise", "narrow", "low"],
)
def test_pictures_of_nothing_show_no_posts(picture: UInt8Array) -> None:
    assert seen(picture, FieldColours()) == ()


def test_a_field_without_goals_shows_no_posts() -> None:
    picture, _, colours = view("spl", (0.0, -2.0, -1.57), Scene())
    assert seen(picture, colours) == ()


@pytest.mark.skipif(not (DATA / "nao").exists(), reason="the NAO recordings are not here")
@pytest.mark.parametrize(
    ("point", "feet"),
    [(2, [(276.0, 314.0), (411.5, 313.0)]), (5, [(60.0, 222.0), (220.0, 216.0)])],
)
def test_the_posts_that_a_nao_saw_stand_where_people_picked_them(point: int, feet: list[tuple[float, float]]) -> None:
    picture = load_picture(DATA / "nao" / "black1" / f"point{point}" / "imagetop.jpg")
    found = seen(picture, FieldColours())
    lower = [0.5 * (post.left_px[1] + post.right_px[1]) for post in found]
    for foot in feet:
        assert min(abs(at[0] - foot[0]) for at in lower) < 3.0  # picked to 1 or 2 px
    assert len(found) <= 5
