from dataclasses import replace

import numpy as np
import pytest
from goal_views import GOAL, RADIUS_M
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fieldloc.camera import Camera
from fieldloc.covariance import central_difference
from fieldloc.fixes.cylinder import edge_bearings
from fieldloc.fixes.post_feet import PostSights, fix_two_posts_of_image, sight_posts
from fieldloc.fixes.post_fix import PostFix, fix_of_robot
from fieldloc.ground import project_points
from fieldloc.measurements import CameraMount, PostObservation
from fieldloc.pose import FloatArray, apply, compose, inverse, wrap

CAMERA = Camera("pinhole", 640, 480, 500.0, 510.0, 320.0, 240.0)
FISHEYE = Camera("fisheye", 640, 480, 280.0, 280.0, 320.0, 240.0, (0.02, -0.003, 0.0, 0.0))
MOUNT_NOISE = np.diag([0.005, 0.01, 0.01, 0.01]) ** 2
MOUNT = CameraMount(0.55, 0.2, 0.3, -0.05, MOUNT_NOISE, x_m=0.08, y_m=-0.03)
EDGE_NOISE = np.eye(4) * 0.2**2
FOOT_NOISE = np.eye(2) * 0.5**2

moderate = settings(deadline=None, max_examples=40)


def observe(points: FloatArray, camera: Camera = CAMERA, mount: CameraMount = MOUNT) -> tuple[PostObservation, ...]:
    """Posts whose axes stand at points (n, 2) of the robot frame: edges above the ground, the foot in front."""
    below = np.array([mount.x_m, mount.y_m])
    posts = []
    for point in points:
        along = point - below
        distance = float(np.hypot(*along))
        bearing = float(np.arctan2(along[1], along[0]))
        edges, _ = edge_bearings(np.array([distance, bearing]), RADIUS_M)
        to_tangent = np.sqrt(distance**2 - RADIUS_M**2)
        tangents = below + to_tangent * np.stack([np.cos(edges), np.sin(edges)], axis=-1)
        heights = np.array([mount.height_m, mount.height_m + 0.1])[:, None]
        edges_px, _ = project_points(camera, mount, np.concatenate([tangents, heights], axis=1))
        contact = below + along * (distance - RADIUS_M) / distance
        foot_px, _ = project_points(camera, mount, np.append(contact, 0.0))
        posts.append(PostObservation(edges_px, EDGE_NOISE, foot_px, FOOT_NOISE))
    return tuple(posts)


def expected_sights(points: FloatArray, mount: CameraMount = MOUNT) -> FloatArray:
    along = points - [mount.x_m, mount.y_m]
    return np.stack([np.arctan2(along[:, 1], along[:, 0]), 1 / np.hypot(along[:, 0], along[:, 1])], axis=-1)


def without_feet(posts: tuple[PostObservation, ...]) -> tuple[PostObservation, ...]:
    return tuple(replace(post, foot_px=None, foot_covariance_px2=None) for post in posts)


IN_VIEW = np.array([[2.0, 0.9], [3.0, -0.4], [1.2, 0.3]])


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["pinhole", "fisheye"])
@moderate
@given(forward=st.floats(0.8, 6.0), left=st.floats(-2.0, 3.0), tilt=st.floats(-0.2, 0.5), roll=st.floats(-0.3, 0.3))
def test_feet_and_widths_each_give_the_place_of_the_post(
    camera: Camera, forward: float, left: float, tilt: float, roll: float
) -> None:
    mount = replace(MOUNT, tilt_rad=tilt, roll_rad=roll)
    points = np.array([[forward, left]])
    bearing = np.arctan2(left - mount.y_m, forward - mount.x_m)
    assume(abs(bearing - mount.pan_rad) < 0.9)
    posts = observe(points, camera, mount)
    feet = sight_posts(camera, mount, tuple(replace(p, edges_px=p.edges_px[::-1]) for p in posts), RADIUS_M)
    widths = sight_posts(camera, mount, without_feet(posts), RADIUS_M)
    both = sight_posts(camera, mount, posts, RADIUS_M)
    for sights in (feet, widths, both):
        np.testing.assert_allclose(sights.bearing_inverse_range, expected_sights(points, mount), atol=1e-7)
    assert (feet.redundancy, widths.redundancy, both.redundancy) == (0, 0, 2)
    assert both.chi2 < 1e-6
    # knowing more never makes it worse
    for part in (feet, widths):
        assert np.all(np.diag(both.covariance) <= np.diag(part.covariance) * (1 + 1e-9))


def test_the_joint_covariance_is_the_one_propagated_by_central_differences() -> None:
    posts = observe(IN_VIEW)
    for case in (without_feet(posts), posts):
        radius = RADIUS_M if case is not posts else None  # widths alone, feet alone

        def sights(
            x: FloatArray, case: tuple[PostObservation, ...] = case, radius: float | None = radius
        ) -> FloatArray:
            mount = replace(MOUNT, height_m=x[0], pan_rad=x[1], tilt_rad=x[2], roll_rad=x[3])
            moved = tuple(
                replace(
                    post,
                    edges_px=x[4 + 6 * i : 8 + 6 * i].reshape(2, 2),
                    foot_px=None if post.foot_px is None else x[8 + 6 * i : 10 + 6 * i],
                )
                for i, post in enumerate(case)
            )
            return sight_posts(CAMERA, mount, moved, radius).bearing_inverse_range.ravel()

        pixels = [
            np.concatenate([post.edges_px.ravel(), np.zeros(2) if post.foot_px is None else post.foot_px])
            for post in case
        ]
        x = np.concatenate([[MOUNT.height_m, MOUNT.pan_rad, MOUNT.tilt_rad, MOUNT.roll_rad], *pixels])
        jacobian = central_difference(sights, x, 1e-5)
        noise = np.diag(np.concatenate([np.diag(MOUNT_NOISE), np.tile([0.2**2] * 4 + [0.5**2] * 2, 3)]))
        expected = jacobian @ noise @ jacobian.T
        actual = sight_posts(CAMERA, MOUNT, case, radius).covariance
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
        assert np.abs(expected[0::2, 0::2][0, 1]) > 0.5 * expected[0, 0]  # the pan they share


def test_the_fused_covariance_is_the_sampled_spread() -> None:
    rng = np.random.default_rng(9)
    exact = observe(IN_VIEW)
    mount_roots = np.sqrt(np.diag(MOUNT_NOISE))
    white, chi2 = [], []
    for _ in range(400):
        truth = CameraMount(
            *(np.array([0.55, 0.2, 0.3, -0.05]) + mount_roots * rng.normal(size=4)), MOUNT_NOISE, 0.08, -0.03
        )
        exact = observe(IN_VIEW, mount=truth)
        seen = tuple(
            replace(
                post,
                edges_px=post.edges_px + 0.2 * rng.normal(size=(2, 2)),
                foot_px=None if post.foot_px is None else post.foot_px + 0.5 * rng.normal(size=2),
            )
            for post in exact
        )
        sights = sight_posts(CAMERA, MOUNT, seen, RADIUS_M)
        error = (sights.bearing_inverse_range - expected_sights(IN_VIEW)).ravel()
        white.append(np.linalg.solve(np.linalg.cholesky(sights.covariance), error))
        chi2.append(sights.chi2)
    assert sights.redundancy == 6
    # 400 samples of a six-dimensional error leave 3 % on the mean square
    assert np.mean(np.square(white)) == pytest.approx(1.0, abs=0.12)
    assert np.mean(chi2) / 6 == pytest.approx(1.0, abs=0.12)


def test_range_and_bearing_follow_from_it() -> None:
    sights = sight_posts(CAMERA, MOUNT, observe(IN_VIEW), RADIUS_M)
    along = IN_VIEW - [MOUNT.x_m, MOUNT.y_m]
    np.testing.assert_allclose(sights.range_bearing[:, 0], np.hypot(along[:, 0], along[:, 1]), atol=1e-7)

    def flipped(x: FloatArray) -> FloatArray:
        return PostSights((0, 1, 2), x.reshape(3, 2), np.eye(6)).range_bearing.ravel()

    jacobian = central_difference(flipped, sights.bearing_inverse_range.ravel())
    np.testing.assert_allclose(
        sights.range_bearing_covariance, jacobian @ sights.covariance @ jacobian.T, rtol=1e-6, atol=1e-12
    )


def test_the_fix_of_an_image_is_the_pose_of_the_robot_not_of_its_camera() -> None:
    pose = np.array([2.0, 0.3, -0.25])
    points = apply(inverse(pose), GOAL)
    posts = observe(points)
    assert len(posts) == 2
    exact_mount = replace(MOUNT, covariance=MOUNT_NOISE * 1e-4)
    for image, radius in (((posts[0], posts[1]), None), ((posts[0], posts[1]), RADIUS_M)):
        fixes = fix_two_posts_of_image(CAMERA, exact_mount, image, GOAL, radius)
        front_of_post_m = RADIUS_M if radius is None else 1e-6  # without a radius the contact is taken for the axis
        assert np.abs(fixes[0].pose - pose).max() < front_of_post_m
    bare = without_feet(posts)
    (fix, *_) = fix_two_posts_of_image(CAMERA, exact_mount, (bare[0], bare[1]), GOAL, RADIUS_M)
    np.testing.assert_allclose(fix.pose, pose, atol=1e-6)
    assert fix_two_posts_of_image(CAMERA, exact_mount, (bare[0], bare[1]), GOAL) == ()


def test_a_wrong_height_shows_where_widths_and_feet_are_both_seen() -> None:
    posts = observe(IN_VIEW)
    good = sight_posts(CAMERA, MOUNT, posts, RADIUS_M)
    too_high = sight_posts(CAMERA, replace(MOUNT, height_m=0.75, tilt_rad=0.36), posts, RADIUS_M)
    assert good.chi2 < 1e-6
    assert too_high.chi2 > 50


def test_posts_that_show_nothing_are_left_out() -> None:
    good, *_ = observe(IN_VIEW)
    above = replace(good, foot_px=np.array([320.0, -400.0]), edges_px=good.edges_px[::-1])
    broken = replace(good, foot_px=np.array([np.nan, 300.0]), edges_px=np.full((2, 2), np.nan))
    bare = without_feet((good,))[0]
    sights = sight_posts(CAMERA, MOUNT, (above, good, broken, bare), RADIUS_M)
    assert sights.seen == (1, 3)
    assert sights.bearing_inverse_range.shape == (2, 2)
    assert sights.covariance.shape == (4, 4)
    assert sight_posts(CAMERA, MOUNT, (above, broken, bare)).seen == ()
    assert sight_posts(CAMERA, MOUNT, ()).covariance.shape == (0, 0)
    buried = replace(MOUNT, height_m=-0.1)
    assert sight_posts(CAMERA, buried, (good,)).seen == ()


def test_a_callers_mistake_is_a_value_error() -> None:
    good, *_ = observe(IN_VIEW)
    with pytest.raises(ValueError, match="without a foot_covariance_px2"):
        sight_posts(CAMERA, MOUNT, (replace(good, foot_covariance_px2=None),))
    with pytest.raises(ValueError, match="foot_px"):
        sight_posts(CAMERA, MOUNT, (replace(good, foot_px=np.zeros(3)),))
    with pytest.raises(ValueError, match="semidefinite"):
        sight_posts(CAMERA, MOUNT, (replace(good, foot_covariance_px2=-np.eye(2)),))
    with pytest.raises(ValueError, match="mount"):
        sight_posts(CAMERA, replace(MOUNT, covariance=np.eye(3)), (good,))
    with pytest.raises(ValueError, match="radius_m"):
        sight_posts(CAMERA, MOUNT, (good,), 0.0)
    with pytest.raises(ValueError, match="needs 2"):
        fix_two_posts_of_image(CAMERA, MOUNT, (good,), GOAL)  # type: ignore[arg-type]
    exact = replace(good, foot_covariance_px2=np.zeros((2, 2)))
    with pytest.raises(ValueError, match="not positive definite"):
        sight_posts(CAMERA, replace(MOUNT, covariance=np.zeros((4, 4))), (exact,))


@moderate
@given(x=st.floats(-2, 2), y=st.floats(-2, 2), heading=st.floats(-3, 3), turn=st.floats(-3, 3))
def test_a_fix_of_a_sensor_becomes_one_of_its_robot(x: float, y: float, heading: float, turn: float) -> None:
    robot_from_sensor = np.array([0.3, -0.2, turn])
    covariance = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])
    fix = PostFix(np.array([x, y, heading]), covariance, -1.5, "somewhere", 0.5, 0.1 * covariance)
    robot = fix_of_robot(fix, robot_from_sensor)
    np.testing.assert_allclose(compose(robot.pose, robot_from_sensor)[:2], fix.pose[:2], atol=1e-12)

    def moved(pose: FloatArray) -> FloatArray:
        change = fix_of_robot(replace(fix, pose=pose), robot_from_sensor).pose - robot.pose
        change[2] = wrap(change[2])
        return change

    jacobian = central_difference(moved, fix.pose)
    np.testing.assert_allclose(robot.covariance, jacobian @ covariance @ jacobian.T, atol=1e-8)
    np.testing.assert_allclose(robot.first_order_covariance, 0.1 * robot.covariance, atol=1e-12)
    assert (robot.log_weight, robot.solver, robot.chi2) == (-1.5, "somewhere", 0.5)
