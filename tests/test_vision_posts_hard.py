"""Posts that are half hidden, before boards and nets, faint or thin; and what is none."""

import cv2
import numpy as np
import pytest

from fieldloc.camera import Camera
from fieldloc.colours import FieldColours
from fieldloc.field import load_field
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray
from fieldloc.render import Goals, Scene, Truth, render_with_truth
from fieldloc.vision.detections import SeenPost
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.posts import find_posts
from fieldloc.vision.posts_colour import View
from fieldloc.vision.posts_extent import extent_of
from fieldloc.vision.posts_pairs import Strips, _among_slimmest
from fieldloc.vision.turf import find_turf

CAMERA = Camera("pinhole", 640, 480, 600.0, 600.0, 319.5, 239.5)


def view(name: str, pose: tuple[float, float, float], goals: Goals, seed: int = 1) -> tuple[UInt8Array, Truth]:
    mount = CameraMount(0.5, 0.0, 0.08, 0.02, np.zeros((4, 4)))
    field = load_field(name)
    return render_with_truth(Scene(goals=goals), CAMERA, field, mount, np.array(pose), np.random.default_rng(seed))


def seen(picture: UInt8Array) -> list[SeenPost]:
    return sorted(find_posts(picture, find_turf(picture), FieldColours(), CAMERA), key=lambda post: post.left_px[1, 0])


def off_px(post: SeenPost, left: FloatArray, right: FloatArray) -> float:
    """The most that an edge is off, at a fifth and at four fifths of the way down."""
    return max(
        abs(float(np.interp(v, found[:, 1], found[:, 0]) - np.interp(v, true[:, 1], true[:, 0])))
        for found, true in ((post.left_px, left), (post.right_px, right))
        for v in true[0, 1] + np.array([0.2, 0.8]) * (true[1, 1] - true[0, 1])
    )


def both(truth: Truth) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Edges and feet of the two posts of the goal in view, the left one first."""
    found = [
        (post.left_px, post.right_px, post.foot_px)
        for post in truth.posts
        if post.left_px is not None and post.right_px is not None and post.foot_px is not None
    ]
    assert len(found) == 2
    return sorted(found, key=lambda post: float(post[2][0]))


def test_a_post_whose_foot_something_hides_is_seen_by_its_crossbar_and_has_no_foot() -> None:
    picture, truth = view("spl", (1.5, 0.4, -0.05), Goals())
    first, second = both(truth)
    u, v = np.rint(first[2]).astype(int)
    picture[v - 22 : v + 18, u - 20 : u + 20] = 25
    posts = seen(picture)
    assert len(posts) == 2
    assert posts[0].foot_px is None
    assert posts[1].foot_px is not None
    assert off_px(posts[0], *first[:2]) < 0.5
    assert off_px(posts[1], *second[:2]) < 0.5


def test_a_board_of_the_posts_colour_between_them_hides_neither() -> None:
    picture, truth = view("spl", (1.5, 0.4, -0.05), Goals())
    (*_, left), (*_, right) = both(truth)
    height = 0.4 * float(left[1] - both(truth)[0][0][0, 1])
    corners = [left, right, right - (0.0, height), left - (0.0, height)]
    cv2.fillPoly(picture, [np.rint(np.array(corners) - (0.0, 4.0)).astype(np.int32)], (215, 215, 215))
    posts = seen(picture)
    assert len(posts) == 2
    for post, (*edges, foot) in zip(posts, both(truth), strict=True):
        assert off_px(post, *edges) < 1.0
        assert post.foot_px is not None
        assert post.foot_px[1] == pytest.approx(foot[1], abs=1.5)


@pytest.mark.parametrize("x", [0.0, 0.9, 1.5, 1.8, 2.1])
def test_of_a_goal_with_a_net_just_the_posts_are_found_without_the_cords_beside_them(x: float) -> None:
    picture, truth = view("spl", (x, 0.4, -0.05), Goals(net=True))
    posts = seen(picture)
    assert len(posts) == 2
    for post, (*edges, _) in zip(posts, both(truth), strict=True):
        assert off_px(post, *edges) < 0.5


def test_high_posts_that_are_dark_towards_their_sides_are_not_too_thin() -> None:
    picture, truth = view("adultsize", (-1.5, 0.4, -0.05), Goals(shading=0.4))
    posts = seen(picture)
    assert len(posts) == 2
    for post, (*edges, _) in zip(posts, both(truth), strict=True):
        assert off_px(post, *edges) < 1.0


def test_a_strip_is_broken_off_where_the_wall_below_it_has_no_edges() -> None:
    picture, _ = view("spl", (0.0, -2.0, -1.57), Goals())
    turf = find_turf(picture)
    assert turf.boundary_px is not None
    foot = round(float(np.interp(300.0, turf.boundary_px[:, 0], turf.boundary_px[:, 1])))
    picture[foot - 60 : foot] = 190  # a wall
    picture[foot - 160 : foot - 60, 300:320] = 240  # a window above it
    picture[foot - 160 : foot, 400:420] = 240  # a post before it
    seen_rows = np.array([[foot - 150.0, foot - 70.0]] * 2)
    lines = np.array([[299.5, 0.0], [399.5, 0.0]])
    strips = Strips(lines, lines + (20.0, 0.0), seen_rows, np.full(2, 20.0), np.full(2, 100.0))
    extent = extent_of(strips, View(picture, (255, 255, 255)), turf, np.full((2, 3), 240.0))
    assert extent.unbroken.tolist() == [False, True]
    assert extent.foot_v[1] == pytest.approx(foot, abs=8.0)  # the samples' distance


def test_of_the_ends_that_go_with_a_beginning_the_slimmest_pairs_are_kept() -> None:
    begins = np.repeat([3, 1], [10, 4])
    width = np.concatenate([np.arange(10.0)[::-1], np.arange(4.0)])
    assert _among_slimmest(begins, width).tolist() == [False] * 4 + [True] * 10


def test_nothing_of_a_post_s_colour_shows_no_posts() -> None:
    picture, _ = view("spl", (1.5, 0.4, -0.05), Goals(colour=(60.0, 60.0, 60.0)))
    assert seen(picture) == []
