"""From what is detected in a picture to where it was taken: poses, twins, covariances, and when there is no answer."""

import numpy as np
import pytest
from seen_scenes import NAO, Look, Scene, off

from fieldloc.camera import Camera
from fieldloc.field import FieldMap, load_field
from fieldloc.locate import CameraPrior, Located, locate, mixture
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray, compose, inverse, wrap
from fieldloc.vision.detections import Detections

FIELD = load_field("spl")
GOAL = Look(np.array([1.6, 0.7, -0.1]), 0.5, 0.22, 0.03)  # both posts, lines of both directions, no circle
CIRCLE = Look(np.array([-1.9, 1.1, -0.5]), 0.45, 0.2, -0.02)  # the circle and the halfway line


def told(look: Look, pitch_off_deg: float = 0.0, roll_off_deg: float = 0.0) -> CameraPrior:
    return CameraPrior.told(
        look.height_m, look.pitch_rad + np.radians(pitch_off_deg), look.roll_rad + np.radians(roll_off_deg)
    )


def seen(look: Look, seed: int = 0, camera: Camera = NAO, clutter: int = 0, field: FieldMap = FIELD) -> Detections:
    return Scene(camera, field, np.random.default_rng(seed)).seen(look, clutter)


def error(located: Located, look: Look, field: FieldMap = FIELD) -> FloatArray:
    return off(located.hypotheses[0].pose, look.pose, field.symmetries)


@pytest.mark.parametrize("look", [GOAL, CIRCLE])
@pytest.mark.parametrize("prior", [True, False])
def test_the_first_hypothesis_is_where_the_picture_was_taken(look: Look, prior: bool) -> None:
    located = locate(seen(look), NAO, FIELD, told(look) if prior else None)
    x, y, heading = error(located, look)
    assert np.hypot(x, y) < 0.05  # 0.3 px at 3 to 4 m and 1 cm of map
    assert abs(heading) < np.radians(1.0)
    first = located.hypotheses[0]
    assert abs(first.pitch_rad - look.pitch_rad) < np.radians(0.5)
    assert abs(first.roll_rad - look.roll_rad) < np.radians(0.7)
    assert abs(first.height_m - look.height_m) < 0.02


@pytest.mark.parametrize("look", [GOAL, CIRCLE])
def test_a_prior_that_is_two_degrees_off_spoils_nothing(look: Look) -> None:
    for pitch, roll in ((2.0, 0.0), (-2.0, 2.0), (0.0, -2.0)):
        x, y, heading = error(locate(seen(look), NAO, FIELD, told(look, pitch, roll)), look)
        assert np.hypot(x, y) < 0.05
        assert abs(heading) < np.radians(1.0)


def test_both_halves_of_the_field_are_equally_likely_to_the_last_digit() -> None:
    first, twin = locate(seen(GOAL), NAO, FIELD, told(GOAL)).hypotheses[:2]
    assert first.probability == twin.probability
    np.testing.assert_allclose(first.pose[:2], -twin.pose[:2], atol=1e-12)
    assert abs(wrap(first.pose[2] - twin.pose[2] - np.pi)) < 1e-12
    np.testing.assert_allclose(
        first.covariance[:2, :2], twin.covariance[:2, :2], atol=1e-15
    )  # a half turn changes none


def test_probabilities_add_up_to_one() -> None:
    located = locate(seen(GOAL, clutter=4), NAO, FIELD, told(GOAL))
    total = sum(one.probability for one in located.hypotheses) + located.none
    assert total == pytest.approx(1.0, abs=1e-12)
    assert located.none >= 0.0


def test_window_frames_and_robots_legs_are_told_from_posts_and_lines() -> None:
    clean = seen(CIRCLE)
    cluttered = seen(CIRCLE, clutter=4)
    located = locate(cluttered, NAO, FIELD, told(CIRCLE))
    x, y, _ = error(located, CIRCLE)
    assert np.hypot(x, y) < 0.05
    first = located.hypotheses[0]
    assert (first.lines[len(clean.lines) :] == -1).sum() >= 3  # one may lie on a line by chance
    assert first.circle == 0


def test_two_posts_alone_are_enough_where_height_and_attitude_are_known() -> None:
    whole = seen(GOAL)
    located = locate(Detections(640, 480, posts=whole.posts), NAO, FIELD, told(GOAL))
    assert len(whole.posts) == 2
    errors = [off(one.pose, GOAL.pose, FIELD.symmetries) for one in located.hypotheses]
    distances = [e @ np.linalg.solve(h.covariance, e) for e, h in zip(errors, located.hypotheses, strict=True)]
    assert min(distances) < 16.0


def test_nothing_seen_is_no_pose() -> None:
    located = locate(Detections(640, 480), NAO, FIELD)
    assert located.hypotheses == ()
    assert located.none == 1.0


def test_a_single_line_is_no_pose() -> None:
    line = seen(GOAL).lines[:1]
    assert locate(Detections(640, 480, line), NAO, FIELD, told(GOAL)).hypotheses == ()


def test_clutter_alone_is_hardly_ever_taken_for_a_place() -> None:
    sure = 0
    for seed in range(12):
        random = np.random.default_rng(seed)
        scene = Scene(NAO, FIELD, random)
        sky = Look(np.array([0.0, 0.0, 0.0]), 0.5, -1.2, 0.0)  # looks up: all that is seen is clutter
        located = locate(scene.seen(sky, clutter=6), NAO, FIELD, CameraPrior.told(0.5, 0.2, 0.0))
        sure += bool(located.hypotheses) and 2.0 * located.hypotheses[0].probability > 0.9
    assert sure <= 1


@pytest.mark.parametrize("model", ["distorted", "fisheye"])
def test_any_lens_will_do(model: str) -> None:
    camera = {
        "distorted": Camera("pinhole", 640, 480, 500.0, 510.0, 318.0, 243.0, (-0.25, 0.06, 0.001, -0.001)),
        "fisheye": Camera("fisheye", 640, 480, 300.0, 300.0, 320.0, 240.0, (0.02, -0.01, 0.0, 0.0)),
    }[model]
    random = np.random.default_rng(2)
    x, y, heading = error(
        locate(Scene(camera, FIELD, random, 0.1).seen(GOAL), camera, FIELD, told(GOAL, 1.5, -1.0)), GOAL
    )
    assert np.hypot(x, y) < 0.06  # what is straight on the ground is bent in the picture, and its ends say enough
    assert abs(heading) < np.radians(1.0)


@pytest.mark.parametrize("name", ["spl", "kidsize", "kidsize-2014", "adultsize"])
def test_the_stated_covariance_covers_what_noise_does(name: str) -> None:
    field = load_field(name)
    size = np.array(field.bounds[2:])
    random = np.random.default_rng(5)
    squares, wrong, views = [], 0, 0
    while views < 25:
        pose = np.array([*random.uniform(-size, size), random.uniform(-np.pi, np.pi)])
        look = Look(pose, random.uniform(0.4, 0.8), np.radians(random.uniform(8, 30)), np.radians(random.normal(0, 2)))
        detections = Scene(NAO, field, random).seen(look)
        if len(detections.posts) < 2 and (len(detections.lines) < 3 or not detections.circles):
            continue
        views += 1
        located = locate(detections, NAO, field, told(look, *random.normal(0, 3, 2)))
        best = min(
            (float(e @ np.linalg.solve(h.covariance, e)) / 3.0, float(np.hypot(e[0], e[1])))
            for h in located.hypotheses
            for e in [off(h.pose, look.pose, field.symmetries)]
        )
        squares.append(best[0])
        first = located.hypotheses[0]
        wrong += 2.0 * first.probability > 0.9 and float(np.hypot(*error(located, look, field)[:2])) > 0.5
    assert wrong == 0
    # whose own spread is 0.16; noise of 0.3 px looks much as a lens that is off by 0.3 px would, and that is left open
    assert 0.25 < np.mean(squares) < 1.6
    assert np.mean(np.array(squares) < 16.0 / 3.0) > 0.95


def test_the_mixture_says_the_same_of_the_robot_that_the_hypotheses_say_of_the_camera() -> None:
    located = locate(seen(GOAL), NAO, FIELD, told(GOAL))
    mount = CameraMount(0.5, 0.3, 0.2, 0.0, np.diag([0.0, 0.01, 0.0, 0.0]) ** 2, x_m=0.1, y_m=-0.05)
    factor = mixture(located, FIELD, 7, mount)
    assert factor is not None
    assert factor.by_sight
    assert factor.symmetric
    solutions = factor.solutions()
    camera_on_robot = np.array([0.1, -0.05, 0.3])
    np.testing.assert_allclose(
        solutions.poses[0], compose(located.hypotheses[0].pose, inverse(camera_on_robot)), atol=1e-9
    )
    at = factor.log_likelihood(solutions.poses[:1])[0]
    away = factor.log_likelihood(solutions.poses[:1] + np.array([0.5, 0.0, 0.0]))[0]
    assert at > away + 5.0
    # the posterior of a robot that may be anywhere is what locate says
    nowhere = np.exp(factor.log_outlier - np.logaddexp(factor.log_integral - np.log(440.0), factor.log_outlier))
    assert nowhere < located.none + 0.1


def test_no_pose_is_no_mixture() -> None:
    assert mixture(Located((), 1.0), FIELD, 0) is None
