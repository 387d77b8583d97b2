import dataclasses

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import minimize

from fieldloc.camera import Camera
from fieldloc.covariance import central_difference
from fieldloc.field import load_field
from fieldloc.fixes.line_segments import LineSegments, agreeing, modulo_quarter, usable_segments
from fieldloc.fixes.lines import GroundLines, bearing_misfit, lines_on_the_ground
from fieldloc.ground import project_points, robot_ground_points
from fieldloc.measurements import CameraMount, LineObservation
from fieldloc.pose import FloatArray, apply, inverse
from fieldloc.view import visible_parts

CAMERA = Camera("pinhole", 640, 480, 450.0, 450.0, 319.5, 239.5, (-0.2, 0.05, 0.001, -0.001))
FISHEYE = Camera("fisheye", 640, 480, 220.0, 220.0, 319.5, 239.5, (0.05, -0.01, 0.0, 0.0))
LINES = load_field("spl").lines
POSE = np.array([1.3, -0.7, 0.4])
MOUNT_AT = np.array([0.5, 0.3, 0.35, 0.05])
NOISE = np.diag([0.01, 0.01, 0.01, 0.01]) ** 2
EXACT = np.zeros((4, 4))


def mount_at(parameters: FloatArray, covariance: FloatArray) -> CameraMount:
    height, pan, tilt, roll = (float(p) for p in parameters)
    return CameraMount(height, pan, tilt, roll, covariance, x_m=0.05, y_m=0.01)


def observation(ends_px: FloatArray, sigma_px: float) -> LineObservation:
    return LineObservation(ends_px, sigma_px**2 * np.eye(4))


def image_of(camera: Camera, mount: CameraMount, pose: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    """Ends (n, 2, 2) in pixels of the field lines longer than 20 px, and which lines they are."""
    parts, index = visible_parts(camera, mount, apply(inverse(pose), LINES))
    pixels, _ = project_points(camera, mount, np.pad(parts, ((0, 0), (0, 0), (0, 1))))
    long = np.linalg.norm(pixels[:, 0] - pixels[:, 1], axis=-1) > 20.0
    return pixels[long], index[long]


def true_lines(lines: GroundLines, pose: FloatArray, seen: FloatArray) -> FloatArray:
    """(1 + n,) the bearing and signed distances that an exact observer would report of the field lines (n, 2, 2)."""
    quarter = np.pi / 2 * np.rint((pose[2] + lines.bearing_rad) / (np.pi / 2))
    bearing = quarter - pose[2]
    turned = apply(np.array([0.0, 0.0, -bearing]), apply(inverse(pose), seen))
    constant = np.where((lines.families == 0)[:, None], turned[..., 1], turned[..., 0])
    np.testing.assert_allclose(constant[:, 0], constant[:, 1], atol=1e-12)  # every line runs along its family
    return np.concatenate([[bearing], constant[:, 0]])


def seen_from(pose: FloatArray, mount: CameraMount, camera: Camera = CAMERA) -> tuple[GroundLines, FloatArray]:
    ends, index = image_of(camera, mount, pose)
    lines = lines_on_the_ground(camera, mount, tuple(observation(e, 0.5) for e in ends))
    assert lines is not None
    return lines, LINES[index[lines.observed]]


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE])
@pytest.mark.parametrize("noise", [NOISE, EXACT])
@pytest.mark.parametrize("heading", [*np.linspace(-3.0, 3.0, 7), np.pi / 4, -np.pi / 2])
def test_an_exact_image_gives_the_exact_lines(camera: Camera, noise: FloatArray, heading: float) -> None:
    pose = np.array([POSE[0], POSE[1], heading])
    mount = mount_at(MOUNT_AT, noise)
    lines, seen = seen_from(pose, mount, camera)
    assert len(seen) >= 2
    found = np.concatenate([[lines.bearing_rad], lines.distances_m])
    np.testing.assert_allclose(found, true_lines(lines, pose, seen), atol=1e-9)
    assert lines.chi_square < 1e-12
    assert np.linalg.eigvalsh(lines.covariance)[0] > 0
    assert abs(lines.bearing_rad) <= np.pi / 4 + 1e-9
    turned = apply(np.array([0.0, 0.0, -lines.bearing_rad]), apply(inverse(pose), seen))
    along = np.where((lines.families == 0)[:, None], turned[..., 0], turned[..., 1])
    assert (lines.extents_m[:, 0] < lines.extents_m[:, 1]).all()
    assert (lines.extents_m[:, 0] > along.min(axis=1) - 1e-9).all()
    assert (lines.extents_m[:, 1] < along.max(axis=1) + 1e-9).all()


def test_the_covariance_is_the_spread_of_images_with_pixel_and_attitude_noise() -> None:
    rng = np.random.default_rng(5)
    sigma_px, count = 0.7, 600
    mount = mount_at(MOUNT_AT, NOISE)
    ends, index = image_of(CAMERA, mount, POSE)
    ground, _ = robot_ground_points(CAMERA, mount, ends)
    size = 1 + len(index)
    errors, extents, sigmas = [], [], []
    for parameters in rng.multivariate_normal(MOUNT_AT, NOISE, count):
        moved, _ = project_points(CAMERA, mount_at(parameters, NOISE), np.pad(ground, ((0, 0), (0, 0), (0, 1))))
        noisy = tuple(observation(e + rng.normal(0.0, sigma_px, e.shape), sigma_px) for e in moved)
        lines = lines_on_the_ground(CAMERA, mount, noisy)
        assert lines is not None
        if len(lines.observed) == size - 1:
            error = np.concatenate([[lines.bearing_rad], lines.distances_m]) - true_lines(lines, POSE, LINES[index])
            errors.append(np.linalg.solve(np.linalg.cholesky(lines.covariance), error))
            extents.append(lines.extents_m)
            sigmas.append(lines.extents_sigma_m)
    assert len(errors) > 0.9 * count
    # standard deviation of a sampled variance: sqrt(2 / 600) = 6 %, so four of them; of the mean 1 / sqrt(600) = 4 %
    np.testing.assert_allclose(np.cov(np.array(errors).T), np.eye(size), atol=0.25)
    np.testing.assert_allclose(np.mean(errors, axis=0), 0.0, atol=0.2)
    # 3 % of sampling; the rest is that an end's own pixels have a share in the bearing, which its sigma takes as free
    np.testing.assert_allclose(np.std(extents, axis=0) / np.mean(sigmas, axis=0), 1.0, atol=0.2)


def test_lines_of_one_image_share_the_error_of_the_mount() -> None:
    lines, _ = seen_from(POSE, mount_at(MOUNT_AT, NOISE))
    sigma = np.sqrt(np.diagonal(lines.covariance))
    correlation = lines.covariance / np.outer(sigma, sigma)
    assert np.abs(correlation - np.eye(len(sigma))).max() > 0.5
    exact, _ = seen_from(POSE, mount_at(MOUNT_AT, EXACT))
    assert (np.sqrt(np.diagonal(exact.covariance)) < sigma).all()
    pan_only, _ = seen_from(POSE, mount_at(MOUNT_AT, np.diag([0.0, 0.01**2, 0.0, 0.0])))
    np.testing.assert_allclose(pan_only.covariance[0, 0] - exact.covariance[0, 0], 0.01**2, rtol=1e-9)


def test_parallel_lines_that_look_skewed_correct_the_tilt() -> None:
    tilted = MOUNT_AT + np.array([0.0, 0.0, 0.02, 0.0])  # two standard deviations
    loose = np.diag([0.001, 0.001, 0.02, 0.001]) ** 2
    ends, index = image_of(CAMERA, mount_at(tilted, loose), POSE)
    lines = lines_on_the_ground(CAMERA, mount_at(MOUNT_AT, loose), tuple(observation(e, 0.1) for e in ends))
    assert lines is not None
    together = lines.distances_m - true_lines(lines, POSE, LINES[index[lines.observed]])[1:]
    for i, n in enumerate(lines.observed):
        alone = lines_on_the_ground(CAMERA, mount_at(MOUNT_AT, loose), (observation(ends[n], 0.1),))
        assert alone is not None
        wrong = alone.distances_m - true_lines(alone, POSE, LINES[index[[n]]])[1:]
        assert abs(together[i]) < 0.2 * abs(wrong[0]) + 1e-3


def test_lines_of_neither_family_are_left_out() -> None:
    rng = np.random.default_rng(8)
    mount = mount_at(MOUNT_AT, NOISE)
    ends, _ = image_of(CAMERA, mount, POSE)
    # nearly as many as the field's lines, all to one side of them: a plain mean would end in between
    directions = np.array([0.4, 0.45, 0.5, 0.55, 0.6]) + modulo_quarter(-POSE[2])
    clutter = [false_line(mount, np.array([1.6, 0.4]) + rng.uniform(-0.3, 0.3, 2), angle) for angle in directions]
    mixed = [clutter[0], *ends[:2], clutter[1], *ends[2:], *clutter[2:]]
    assert len(ends) == 6
    lines = lines_on_the_ground(CAMERA, mount, tuple(observation(e, 0.5) for e in mixed))
    assert lines is not None
    clean = lines_on_the_ground(CAMERA, mount, tuple(observation(e, 0.5) for e in ends))
    assert clean is not None
    assert lines.observed.tolist() == [1, 2, 4, 5, 6, 7]
    np.testing.assert_allclose(lines.distances_m, clean.distances_m, atol=1e-9)


def test_the_most_agreeing_bearing_wins_over_the_mean_modulo_90_degrees() -> None:
    quarter = np.pi / 2
    bearing = np.array([0.75, 0.77 + quarter, 0.76 - quarter, 0.1, 0.2, 0.3, 0.4])  # three agree, across +-pi/4 or not
    count = len(bearing)
    covariance = 0.02**2 * np.eye(count)
    segments = LineSegments(
        observed=np.arange(count),
        rays=np.zeros((count, 2, 3)),
        ray_to_pixel=np.zeros((count, 2, 3, 2)),
        covariance_px2=np.zeros((count, 4, 4)),
        normals=np.zeros((count, 3)),
        bearing_rad=bearing,
        bearing_covariance=covariance,
        bearing_variance=covariance.diagonal(),
        bearing_by_attitude=np.zeros((count, 3)),
    )
    agree, common = agreeing(segments)
    assert agree.tolist() == [True] * 3 + [False] * 4
    np.testing.assert_allclose(common, 0.76, atol=1e-3)
    agree, common = agreeing(
        dataclasses.replace(segments, bearing_rad=bearing + 0.03)
    )  # 0.78, 0.79, 0.80: over the edge
    assert agree.tolist() == [True] * 3 + [False] * 4
    np.testing.assert_allclose(common, 0.79 - quarter, atol=1e-3)


@pytest.mark.parametrize("skew_deg", [-10.0, -3.0, 3.0, 10.0])
def test_a_line_a_little_askew_is_found_although_an_attitude_error_could_excuse_it_alone(skew_deg: float) -> None:
    mount = mount_at(MOUNT_AT, NOISE)
    ends, _ = image_of(CAMERA, mount, POSE)
    askew = false_line(mount, np.array([2.0, 0.6]), np.deg2rad(skew_deg) - POSE[2])
    lines = lines_on_the_ground(CAMERA, mount, tuple(observation(e, 0.5) for e in [*ends, askew]))
    assert lines is not None
    assert lines.observed.tolist() == list(range(len(ends)))


def test_two_lines_that_contradict_each_other_end_as_one() -> None:
    mount = mount_at(MOUNT_AT, NOISE)
    contradicting = [
        false_line(mount, np.array([2.0, 0.5 + shift]), angle) for shift, angle in ((-0.4, 0.0), (0.4, 0.5))
    ]
    lines = lines_on_the_ground(CAMERA, mount, tuple(observation(e, 0.5) for e in contradicting))
    assert lines is not None
    assert len(lines.observed) == 1


def false_line(mount: CameraMount, middle: FloatArray, bearing: float) -> FloatArray:
    """Image (2, 2) of a segment 0.8 m long on the ground, in the robot frame."""
    half = 0.4 * np.array([np.cos(bearing), np.sin(bearing)])
    return project_points(CAMERA, mount, np.pad(np.array([middle - half, middle + half]), ((0, 0), (0, 1))))[0]


def test_a_line_through_the_cameras_foot_has_distance_zero() -> None:
    mount = dataclasses.replace(mount_at(MOUNT_AT, NOISE), x_m=0.0, y_m=0.0)
    bearing = 0.3
    points = np.array([[1.0, 0.0], [2.5, 0.0]]) @ np.array([[np.cos(bearing), np.sin(bearing)], [0.0, 0.0]])
    ends, _ = project_points(CAMERA, mount, np.pad(points, ((0, 0), (0, 1))))
    lines = lines_on_the_ground(CAMERA, mount, (observation(ends, 0.5),))
    assert lines is not None
    np.testing.assert_allclose([lines.bearing_rad, lines.distances_m[0]], [bearing, 0.0], atol=1e-9)


LEVEL = mount_at(np.array([0.5, 0.0, 0.0, 0.0]), NOISE)
GOOD = np.array([[100.0, 400.0], [500.0, 410.0]])


@pytest.mark.parametrize(
    "bad",
    [
        LineObservation(np.array([[100.0, 100.0], [500.0, 120.0]]), np.eye(4)),  # in the sky
        LineObservation(np.array([[100.0, 400.0], [500.0, 120.0]]), np.eye(4)),  # into the sky
        LineObservation(np.array([[100.0, 239.5], [500.0, 239.5]]), np.eye(4)),  # the horizon
        LineObservation(np.array([[100.0, 242.0], [500.0, 242.0]]), np.eye(4)),  # too near to it for the tilt's noise
        LineObservation(np.array([[100.0, 400.0], [100.0, 400.0]]), np.eye(4)),  # no length
        LineObservation(np.array([[100.0, 400.0], [101.0, 400.5]]), np.eye(4)),  # shorter than its noise
        LineObservation(np.array([[np.nan, 400.0], [500.0, 400.0]]), np.eye(4)),
        LineObservation(np.array([[np.inf, 400.0], [500.0, 400.0]]), np.eye(4)),
        LineObservation(GOOD, np.full((4, 4), np.nan)),
        LineObservation(GOOD, np.zeros((4, 4))),
        LineObservation(GOOD, -np.eye(4)),
    ],
)
def test_an_unusable_segment_is_left_out_and_alone_gives_nothing(bad: LineObservation) -> None:
    assert lines_on_the_ground(CAMERA, LEVEL, (bad,)) is None
    lines = lines_on_the_ground(CAMERA, LEVEL, (bad, observation(GOOD, 1.0)))
    assert lines is not None
    assert lines.observed.tolist() == [1]
    for array in (lines.distances_m, lines.covariance, lines.extents_m, lines.extents_sigma_m):
        assert np.isfinite(array).all()


def test_the_same_segment_twice_is_one_line_seen_twice() -> None:
    once = lines_on_the_ground(CAMERA, LEVEL, (observation(GOOD, 1.0),))
    twice = lines_on_the_ground(CAMERA, LEVEL, (observation(GOOD, 1.0), observation(GOOD, 1.0)))
    assert once is not None
    assert twice is not None
    np.testing.assert_allclose(twice.distances_m, [once.distances_m[0]] * 2, atol=1e-9)


def test_segments_count_from_four_sigmas_below_the_horizon() -> None:
    # 120 px beside the axis tilt and roll of 0.01 rad move the horizon by 0.01 sqrt(450^2 + 120^2) = 4.66 px
    for row, usable in ((239.5 + 3.8 * 4.66, False), (239.5 + 4.2 * 4.66, True)):
        ends = np.array([[199.5, row], [439.5, row]])
        lines = lines_on_the_ground(CAMERA, LEVEL, (observation(ends, 0.1),))
        assert (lines is not None) == usable


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE])
def test_the_covariance_of_the_bearings_follows_from_central_differences(camera: Camera) -> None:
    ends, _ = image_of(camera, mount_at(MOUNT_AT, NOISE), POSE)

    def bearings(x: FloatArray) -> FloatArray:
        moved = tuple(observation(e, 0.5) for e in x[4:].reshape(-1, 2, 2))
        segments = usable_segments(camera, mount_at(x[:4], NOISE), moved)
        assert segments is not None
        return segments.bearing_rad

    jacobian = central_difference(bearings, np.concatenate([MOUNT_AT, ends.ravel()]), step=1e-5)
    noise = np.diag(np.concatenate([np.diagonal(NOISE), np.full(ends.size, 0.25)]))
    segments = usable_segments(camera, mount_at(MOUNT_AT, NOISE), tuple(observation(e, 0.5) for e in ends))
    assert segments is not None
    assert len(segments.observed) == len(ends)
    np.testing.assert_allclose(segments.bearing_covariance, jacobian @ noise @ jacobian.T, rtol=1e-6)


@settings(deadline=None, max_examples=30)
@given(
    mount=st.tuples(st.floats(0.3, 1.0), st.floats(-3.0, 3.0), st.floats(0.3, 0.8), st.floats(-0.3, 0.3)).map(np.array),
    bearing=st.floats(-0.8, 0.8),
)
def test_the_jacobian_of_the_bearings_equals_central_differences(mount: FloatArray, bearing: float) -> None:
    ends = np.array([[[100.0, 400.0], [500.0, 420.0]], [[200.0, 450.0], [250.0, 390.0]]])
    pair = usable_segments(CAMERA, mount_at(mount, 1e-6 * NOISE), tuple(observation(e, 0.5) for e in ends))
    assert pair is not None
    at, jacobian = bearing_misfit(mount_at(mount, NOISE), pair, bearing)
    assume(np.abs(at).max() < np.pi / 4 - 1e-3)  # nor wrap within the step

    def misfit(attitude: FloatArray) -> FloatArray:
        return bearing_misfit(mount_at(np.append(mount[0], attitude), NOISE), pair, bearing)[0]

    np.testing.assert_allclose(jacobian, central_difference(misfit, mount[1:]), rtol=1e-6, atol=1e-7)


def joint_cost(x: FloatArray, ends: FloatArray, seen: GroundLines, noise: FloatArray) -> float:
    """Chi-square of (bearing, distances, true ends along the lines, mount) against the pixels (n, 2, 2)."""
    count = len(ends)
    bearing, distances = x[0], x[1 : 1 + count]
    places, parameters = x[1 + count : 1 + 3 * count].reshape(count, 2), x[-4:]
    flat = np.where(
        (seen.families == 0)[:, None, None],
        np.stack([places, np.repeat(distances[:, None], 2, axis=1)], axis=-1),
        np.stack([np.repeat(distances[:, None], 2, axis=1), places], axis=-1),
    )
    points = np.pad(apply(np.array([0.0, 0.0, bearing]), flat), ((0, 0), (0, 0), (0, 1)))
    pixels, _ = project_points(CAMERA, mount_at(parameters, noise), points)
    off = parameters - MOUNT_AT
    return float(np.sum((pixels - ends) ** 2) / 0.5**2 + off @ np.linalg.solve(noise, off))


def test_the_estimate_is_the_likeliest_of_all_lines_and_mounts() -> None:
    """The closed form against a general minimiser over everything that is unknown, ends along the lines included."""
    rng = np.random.default_rng(12)
    noise = np.diag([0.01, 0.02, 0.03, 0.02]) ** 2
    true = rng.multivariate_normal(MOUNT_AT, noise)
    ends, _ = image_of(CAMERA, mount_at(true, noise), POSE)
    ends = ends + rng.normal(0.0, 0.5, ends.shape)
    seen = lines_on_the_ground(CAMERA, mount_at(MOUNT_AT, noise), tuple(observation(e, 0.5) for e in ends))
    assert seen is not None
    ends = ends[seen.observed]
    start = np.concatenate([[seen.bearing_rad], seen.distances_m, seen.extents_m.ravel(), MOUNT_AT])
    swapped = []
    for i in range(len(ends)):
        other = start.copy()
        other[1 + len(ends) + 2 * i : 3 + len(ends) + 2 * i] = seen.extents_m[i, ::-1]
        swapped.append(joint_cost(other, ends, seen, noise) < joint_cost(start, ends, seen, noise))
    ends[swapped] = ends[swapped, ::-1]
    best = minimize(joint_cost, start, args=(ends, seen, noise), method="BFGS", options={"gtol": 1e-6}).x
    found = np.concatenate([[seen.bearing_rad], seen.distances_m])
    off = found - best[: len(found)]
    # a tenth of a standard deviation: what freezing the weights costs
    assert off @ np.linalg.solve(seen.covariance, off) < 0.1**2 * len(found)


def test_the_covariance_splits_into_the_pixels_share_and_the_mounts() -> None:
    noise = np.diag([0.01, 0.02, 0.015, 0.01]) ** 2
    ends, _ = image_of(CAMERA, mount_at(MOUNT_AT, noise), POSE)

    def estimate(x: FloatArray) -> GroundLines:
        moved = tuple(observation(e, 0.5) for e in x[4:].reshape(-1, 2, 2))
        lines = lines_on_the_ground(CAMERA, mount_at(x[:4], noise), moved)
        assert lines is not None
        return lines

    def numbers(x: FloatArray) -> FloatArray:
        lines = estimate(x)
        return np.append(lines.bearing_rad, lines.distances_m)

    x = np.concatenate([MOUNT_AT, ends.ravel()])
    seen = estimate(x)
    jacobian = central_difference(numbers, x, step=1e-4)
    np.testing.assert_allclose(seen.by_mount, jacobian[:, :4], rtol=1e-3, atol=1e-4)
    own = 0.25 * jacobian[:, 4:] @ jacobian[:, 4:].T
    scale = np.sqrt(np.outer(own.diagonal(), own.diagonal()))
    np.testing.assert_allclose(seen.pixel_covariance / scale, own / scale, atol=2e-3)
    whole = seen.pixel_covariance + seen.by_mount @ noise @ seen.by_mount.T
    np.testing.assert_allclose(seen.covariance, whole, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("change", [{"height_m": 0.0}, {"height_m": np.nan}, {"tilt_rad": np.nan}])
def test_a_camera_that_is_nowhere_sees_no_lines(change: dict[str, float]) -> None:
    mount = dataclasses.replace(LEVEL, **change)
    assert lines_on_the_ground(CAMERA, mount, (observation(GOOD, 1.0),)) is None
    assert lines_on_the_ground(CAMERA, LEVEL, ()) is None


def test_distance_and_bearing_follow_the_papers_ground_points() -> None:
    ends, _ = robot_ground_points(CAMERA, LEVEL, GOOD)
    lines = lines_on_the_ground(CAMERA, LEVEL, (observation(GOOD, 1.0),))
    assert lines is not None
    along = ends[1] - ends[0]
    bearing = modulo_quarter(np.arctan2(along[1], along[0]))
    np.testing.assert_allclose(lines.bearing_rad, bearing, atol=1e-12)
    assert lines.families.tolist() == [1]  # it runs across
    np.testing.assert_allclose(lines.distances_m[0], ends[0] @ np.array([np.cos(bearing), np.sin(bearing)]), rtol=1e-12)
