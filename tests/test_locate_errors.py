"""Jacobians of locate's residuals, its attitudes and its priors."""

from dataclasses import replace

import numpy as np
import pytest
from seen_scenes import NAO, Look, Scene

from fieldloc.covariance import central_difference
from fieldloc.field import load_field
from fieldloc.ground import robot_from_camera
from fieldloc.locate import CameraPrior, LocateSettings, locate
from fieldloc.locate.amounts import AMOUNTS, log_often
from fieldloc.locate.attitude import attitudes
from fieldloc.locate.cameras import ERROR, FOCAL, Cameras
from fieldloc.locate.circle_errors import circle_errors, circle_rows
from fieldloc.locate.line_errors import line_rows
from fieldloc.locate.matching import match
from fieldloc.locate.noise import Noise
from fieldloc.locate.post_errors import post_errors, post_rows
from fieldloc.locate.shape import shape_of
from fieldloc.locate.sight import Sight, sight_of
from fieldloc.locate.states import rotations, turn_axes
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray
from fieldloc.vision.detections import Detections, SeenCircle

FIELD = load_field("spl")
SHAPE = shape_of(FIELD)
LOOKS = [Look(np.array([1.6, 0.7, -0.1]), 0.5, 0.22, 0.03), Look(np.array([-1.9, 1.1, 2.6 - np.pi]), 0.45, 0.2, -0.2)]


def state_of(look: Look) -> FloatArray:
    return np.array([*look.pose, look.height_m, look.pitch_rad, look.roll_rad])


def test_a_state_turns_as_a_mount_of_that_attitude() -> None:
    mount = CameraMount(0.5, 0.7, 0.3, -0.2, np.zeros((4, 4)))
    np.testing.assert_allclose(
        rotations(np.array([[0.0, 0.0, 0.7, 0.5, 0.3, -0.2]]))[0], robot_from_camera(mount), atol=1e-15
    )


def test_turns_are_about_the_axes_told() -> None:
    state = np.array([1.0, 2.0, 0.7, 0.5, 0.3, -0.2])
    axes, ray = turn_axes(state[None], rotations(state[None]))[0], np.array([0.3, -0.2, 1.0])
    numeric = central_difference(lambda s: rotations(s[None])[0] @ ray, state)
    for column, axis in zip((2, 4, 5), axes, strict=True):
        np.testing.assert_allclose(numeric[:, column], np.cross(axis, rotations(state[None])[0] @ ray), atol=1e-8)


@pytest.mark.parametrize("look", LOOKS)
def test_jacobians_are_those_of_the_errors(look: Look) -> None:
    sight = sight_of(Scene(NAO, FIELD, np.random.default_rng(0), 1e-4).seen(look), NAO)
    state = state_of(look)

    def at(state: FloatArray) -> Cameras:
        return Cameras.at(state[None], sight, SHAPE)

    matches = match(at(state), Noise(sight, SHAPE, LocateSettings()))
    assert (matches.lines >= 0).sum() > 2
    lines = np.maximum(matches.lines, 0)
    exact = line_rows(at(state), lines)[0].reshape(-1, 8)[:, :6]  # of ends and of widths
    numeric = central_difference(lambda s: line_rows(at(s), lines)[0][..., ERROR].ravel(), state)
    # what is painted thinner than lenses blur has a slope that only pulls
    wide = line_rows(at(state), lines)[1][0] * SHAPE.line_width_m > 1.5
    known = np.stack([np.ones_like(wide), wide & np.isfinite(sight.widths)], axis=1).ravel()
    assert np.count_nonzero(known) > wide.size
    np.testing.assert_allclose(exact[known], numeric[known], atol=1e-2)  # of up to a thousand px
    if len(sight.post_rays):
        posts = np.maximum(matches.posts, 0)
        rows = post_rows(at(state), posts)
        numeric = central_difference(lambda s: post_rows(at(s), posts)[..., ERROR].ravel(), state)
        # a foot's place on the post turns with the camera's
        np.testing.assert_allclose(rows[..., :6].reshape(-1, 6), numeric, atol=5.0)
        np.testing.assert_array_equal(rows[..., ERROR], post_errors(at(state), posts[..., None])[0][:, :, 0])
    if len(sight.circle_rays):
        circle, thin = SHAPE.circles[0], replace(SHAPE, line_width_m=0.0)  # a wide one's middle is taken as it is
        rows = circle_rows(Cameras.at(state[None], sight, thin), circle)[0]
        numeric = central_difference(
            lambda s: circle_errors(Cameras.at(s[None], sight, thin), circle)[0].ravel(), state
        )
        np.testing.assert_allclose(rows[0, :, :6], numeric, atol=0.05)
        wide = circle_rows(at(state), circle)[0]
        np.testing.assert_array_equal(wide[..., :6], rows[..., :6])
        np.testing.assert_array_equal(wide[..., ERROR], circle_errors(at(state), circle)[0])


@pytest.mark.parametrize("look", LOOKS)
def test_a_longer_focal_length_moves_all_that_is_seen_outwards(look: Look) -> None:
    longer = 1e-4
    seen = Scene(NAO, FIELD, np.random.default_rng(0), 1e-4).seen(look)
    sight = sight_of(seen, NAO)
    focal_px = NAO.fx_px * (1.0 + longer)
    other = sight_of(seen, replace(NAO, fx_px=focal_px, fy_px=focal_px))  # the same pixels: should be farther out
    state = state_of(look)[None]
    matches = match(Cameras.at(state, sight, SHAPE), Noise(sight, SHAPE, LocateSettings()))
    lines, posts = np.maximum(matches.lines, 0), np.maximum(matches.posts, 0)

    def rows(sight: Sight) -> list[FloatArray]:
        cameras = Cameras.at(state, sight, SHAPE)
        ends = line_rows(cameras, lines)[0][:, :, 0]
        edges = [post_rows(cameras, posts)] if posts.size else []
        return [ends, *edges, *([circle_rows(cameras, SHAPE.circles[0])[0]] if len(sight.circle_rays) else [])]

    for before, after in zip(rows(sight), rows(other), strict=True):
        used = before[..., FOCAL] != 0.0
        change = (after - before)[..., ERROR] / longer
        np.testing.assert_allclose(change[used], before[..., FOCAL][used], rtol=0.02, atol=2.0)


@pytest.mark.parametrize("look", LOOKS)
def test_lines_posts_and_circle_show_how_the_camera_is_turned(look: Look) -> None:
    sight = sight_of(Scene(NAO, FIELD, np.random.default_rng(1), 0.1).seen(look), NAO)
    found = attitudes(sight, CameraPrior.told()).angles
    quarter = (found[:, 0] - look.pose[2] + np.pi / 4) % (np.pi / 2) - np.pi / 4
    wrong = np.abs(np.column_stack([quarter, found[:, 1] - look.pitch_rad, found[:, 2] - look.roll_rad]))
    assert np.degrees(wrong.max(axis=1).min()) < 2.5  # good enough to begin with; what is told is fitted jointly


def _middles_between_edges(look: Look, x: float, y: float, radius: float, width_m: float) -> FloatArray:
    """(n, 2) pixels: where the ring is cut across in the picture, the middle on the ground between its two edges."""
    angle = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    out = []
    for one in angle:
        step = 1e-4

        def at(turn: float) -> FloatArray:
            return np.array([x, y]) + radius * np.array([np.cos(turn), np.sin(turn)])

        points = np.array([at(one), at(one + step), at(one) + [step, 0.0], at(one) + [0.0, step]])
        pixels, inside = look.on_image(NAO, points)
        if not inside.all():
            continue
        along, by_x, by_y = pixels[1:] - pixels[0]
        # the direction on the ground that is at right angles to the circle in the picture
        across = np.linalg.solve(np.column_stack([by_x, by_y]), [-along[1], along[0]])
        across /= np.linalg.norm(across)
        away = points[0] - [x, y]
        b = float(away @ across)
        ends = [
            -b + np.sqrt(b * b - radius**2 + edge**2) * np.sign(b)
            for edge in (radius - 0.5 * width_m, radius + 0.5 * width_m)
        ]
        out.append(points[0] + 0.5 * (ends[0] + ends[1]) * across)
    pixels, inside = look.on_image(NAO, np.array(out))
    return np.asarray(pixels[inside])


def test_a_circle_is_where_the_middle_between_its_lines_edges_says() -> None:
    look = Look(np.array([-2.2, 0.2, 0.0]), 0.45, 0.2, 0.0)
    x, y, radius = SHAPE.circles[0]
    pixels = _middles_between_edges(look, x, y, radius, SHAPE.line_width_m)
    seen = Detections(640, 480, circles=(SeenCircle(pixels, np.full(len(pixels), 0.1), np.zeros(5)),))
    sight = sight_of(seen, NAO)
    assert len(sight.circle_rays) > 15
    error, _ = circle_errors(Cameras.at(state_of(look)[None], sight, SHAPE), SHAPE.circles[0])
    thin = replace(SHAPE, line_width_m=0.0)
    middles = circle_errors(Cameras.at(state_of(look)[None], sight, thin), SHAPE.circles[0])[0]
    assert np.abs(middles).max() > 0.5  # a bent stripe that is cut askew
    assert np.all(np.abs(error) < 0.02 + 0.13 * np.abs(middles))  # what is of higher order


def test_lines_as_straight_as_a_drawings_make_it_likelier_that_the_map_is_exact() -> None:
    drawn, real = (
        sight_of(Scene(NAO, FIELD, np.random.default_rng(0), sigma_px).seen(LOOKS[0]), NAO) for sigma_px in (0.02, 0.2)
    )
    exact = AMOUNTS < 0.1
    odds = [np.exp(log_often(sight)[exact]).sum() / np.exp(log_often(sight)[~exact]).sum() for sight in (drawn, real)]
    assert odds[0] > 5.0  # noise alone makes lines of an exact map rough, too: that says little
    assert 0.5 < odds[1] < 1.0
    nothing = sight_of(Detections(640, 480), NAO)
    assert 1.0 < np.exp(log_often(nothing)[exact]).sum() / np.exp(log_often(nothing)[~exact]).sum() < 2.0


def test_where_a_foot_is_across_the_posts_edges_have_said_already() -> None:
    look = LOOKS[0]
    seen = Scene(NAO, FIELD, np.random.default_rng(0), 0.05).seen(look)
    moved = tuple(
        post if post.foot_px is None else replace(post, foot_px=post.foot_px + [0.3, 0.0]) for post in seen.posts
    )
    prior = CameraPrior.told(look.height_m, look.pitch_rad, look.roll_rad)
    one, other = (locate(some, NAO, FIELD, prior).hypotheses[0] for some in (seen, replace(seen, posts=moved)))
    assert any(post.foot_px is not None for post in seen.posts)
    assert np.abs(one.pose - other.pose).max() < 2e-4  # a third of a pixel at 3 m is 1.5 mm


def test_a_prior_without_sense_is_refused() -> None:
    with pytest.raises(ValueError, match="height"):
        CameraPrior.told(height_m=-0.5)
    with pytest.raises(ValueError, match="positive definite"):
        CameraPrior(np.array([0.5, 0.0, 0.0]), np.zeros((3, 3)))
    with pytest.raises(ValueError, match="finite"):
        CameraPrior.told(pitch_rad=float("nan"))


def test_a_mounts_prior_is_its_height_tilt_and_roll() -> None:
    mount = CameraMount(0.5, 0.7, 0.3, -0.2, np.diag([0.01, 0.02, 0.03, 0.04]) ** 2)
    prior = CameraPrior.of_mount(mount)
    np.testing.assert_allclose(prior.mean, [0.5, 0.3, -0.2])
    np.testing.assert_allclose(prior.sigmas, [0.01, 0.03, 0.04], rtol=0.01)
