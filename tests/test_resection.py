import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from fieldloc.covariance import central_difference, propagate
from fieldloc.fixes.resection import resection_fix, three_point_resection
from fieldloc.pose import FloatArray, apply, compose, inverse, wrap

SIGMA_RAD = 0.01
MOUNT = np.array([0.1, 0.05, -0.4])
GOAL_AND_POLE = np.array([[4.5, 0.8], [4.5, -0.8], [0.0, 3.2]])


def seen(pose: FloatArray, positions: FloatArray, mount: FloatArray | None = None) -> FloatArray:
    """Bearings (n,) without error."""
    points = apply(inverse(pose if mount is None else compose(pose, mount)), positions)
    return np.arctan2(points[:, 1], points[:, 0])


def danger(positions: FloatArray, point: FloatArray) -> float:
    """How far the point and the positions are from lying on one circle or line, relative to their size: 0 is on one."""
    # x^2 + y^2, x, y and 1 are linearly dependent over the points of a circle
    rows = np.vstack([positions, point])
    rows = rows - rows.mean(axis=0)
    scale = np.abs(rows).max()
    table = np.column_stack([(rows**2).sum(axis=1) / scale**2, rows / scale, np.ones(len(rows))])
    return float(np.linalg.svd(table, compute_uv=False)[-1])


points = st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=3, max_size=6).map(np.array)
poses = st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-7, 7)).map(np.array)


def well_placed(positions: FloatArray, pose: FloatArray) -> bool:
    """Neither on a landmark nor near the danger circle, with the sensor on the robot's origin or on its mount."""
    sensors = (pose[:2], compose(pose, MOUNT)[:2])
    near = min(np.linalg.norm(positions - sensor, axis=1).min() for sensor in sensors)
    return bool(near > 0.2 and min(danger(positions, sensor) for sensor in sensors) > 0.05)


@given(points, poses, st.booleans())
@settings(deadline=None, max_examples=150)
def test_the_fix_is_the_pose_that_made_the_bearings(positions: FloatArray, pose: FloatArray, mounted: bool) -> None:
    assume(well_placed(positions, pose))
    mount = MOUNT if mounted else None
    noise = 1e-8 * np.eye(len(positions))
    (fix,) = resection_fix(positions, seen(pose, positions, mount), noise, robot_from_sensor=mount)
    assert np.allclose(fix.pose[:2], pose[:2], atol=1e-6)
    assert abs(wrap(fix.pose[2] - pose[2])) < 1e-6
    assert np.all(np.linalg.eigvalsh(fix.covariance) > 0)


@given(points, poses)
@settings(deadline=None, max_examples=150)
def test_three_points_give_the_pose_in_closed_form(positions: FloatArray, pose: FloatArray) -> None:
    positions = positions[:3]
    assume(well_placed(positions, pose))
    found, solved = three_point_resection(positions, seen(pose, positions))
    assert solved
    assert np.allclose(found[:2], pose[:2], atol=1e-6)
    assert abs(wrap(found[2] - pose[2])) < 1e-6


def test_the_closed_form_solves_a_stack_as_it_solves_one() -> None:
    rng = np.random.default_rng(0)
    positions, bearings = rng.uniform(-5, 5, (4, 5, 3, 2)), rng.uniform(-3, 3, (4, 5, 3))
    found, solved = three_point_resection(positions, bearings)
    assert found.shape == (4, 5, 3)
    for i, j in np.ndindex(4, 5):
        one, one_solved = three_point_resection(positions[i, j], bearings[i, j])
        assert bool(one_solved) == solved[i, j]
        assert np.allclose(one, found[i, j])


def test_bearings_that_no_pose_can_have_give_none() -> None:
    # the right bearings, but one landmark seen straight behind where it is
    bearings = seen(np.array([1.0, 0.5, 0.3]), GOAL_AND_POLE)
    bearings[2] += np.pi
    assert not three_point_resection(GOAL_AND_POLE, bearings)[1]
    assert resection_fix(GOAL_AND_POLE, bearings, 1e-4 * np.eye(3)) == ()


@pytest.mark.parametrize("mount", [None, MOUNT])
@pytest.mark.parametrize("n", [3, 5])
def test_the_covariance_is_the_solution_s_derivative_times_the_noise(n: int, mount: FloatArray | None) -> None:
    # correlated noise of the bearings and errors of the survey, through the whole solver by central differences
    rng = np.random.default_rng(n)
    positions = np.vstack([GOAL_AND_POLE, rng.uniform(-4, 4, (2, 2))])[:n]
    pose = np.array([0.5, -0.4, 0.8])
    bearings = seen(pose, positions, mount)
    noise = 1e-6 * (np.eye(n) + 0.5 * np.ones((n, n)))
    survey = np.tile(1e-6 * np.array([[4.0, 1.0], [1.0, 2.0]]), (n, 1, 1))

    def solve(x: FloatArray) -> FloatArray:
        (fix,) = resection_fix(x[: 2 * n].reshape(n, 2), x[2 * n :], noise, survey, mount)
        return fix.pose

    jacobian = central_difference(solve, np.concatenate([positions.ravel(), bearings]))
    all_noise = np.zeros((3 * n, 3 * n))
    for i in range(n):
        all_noise[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = survey[i]
    all_noise[2 * n :, 2 * n :] = noise
    (fix,) = resection_fix(positions, bearings, noise, survey, mount)
    assert fix.nonlinearity < 0.05
    assert np.allclose(fix.covariance, propagate(jacobian, all_noise), rtol=1e-5, atol=1e-12)


def test_bearings_that_are_wrong_together_turn_the_robot_and_do_not_move_it() -> None:
    pose = np.array([1.0, 0.5, 0.3])
    noise = 1e-8 * np.eye(3) + 1e-2 * np.ones((3, 3))
    (fix,) = resection_fix(GOAL_AND_POLE, seen(pose, GOAL_AND_POLE), noise)
    alone = resection_fix(GOAL_AND_POLE, seen(pose, GOAL_AND_POLE), 1e-8 * np.eye(3))[0]
    assert np.allclose(fix.covariance[:2, :2], alone.covariance[:2, :2], rtol=1e-4)
    assert np.isclose(fix.covariance[2, 2] - alone.covariance[2, 2], 1e-2, rtol=1e-4)


@pytest.mark.parametrize(
    ("positions", "pose", "survey_m"),
    [
        (GOAL_AND_POLE, np.array([2.0, 0.5, 0.2]), 0.0),
        (GOAL_AND_POLE, np.array([2.0, 0.5, 0.2]), 0.03),
        (np.vstack([GOAL_AND_POLE, [[-4.5, 0.8], [-4.5, -0.8]]]), np.array([-1.0, -1.0, 2.0]), 0.02),
        (np.array([[3.0, 0.0], [-2.0, 2.5], [-2.0, -2.5]]), np.array([0.2, 0.3, 0.5]), 0.0),
    ],
)
def test_errors_of_many_fixes_have_the_covariance_they_claim(
    positions: FloatArray, pose: FloatArray, survey_m: float
) -> None:
    rng = np.random.default_rng(2)
    n, runs = len(positions), 400
    survey = np.tile(survey_m**2 * np.eye(2), (n, 1, 1))
    bearings = seen(pose, positions, MOUNT)
    nees, fits = [], []
    for _ in range(runs):
        surveyed = positions + survey_m * rng.normal(size=(n, 2))
        noisy = bearings + SIGMA_RAD * rng.normal(size=n)
        (fix,) = resection_fix(surveyed, noisy, SIGMA_RAD**2 * np.eye(n), survey, MOUNT)
        error = fix.pose - pose
        error[2] = wrap(error[2])
        nees.append(float(error @ np.linalg.solve(fix.covariance, error)))
        fits.append(fix.chi2)
    # four sigmas of the mean, and 5 % for what is beyond first order
    assert abs(np.mean(nees) - 3) < 4 * np.sqrt(6 / runs) + 0.15
    if n > 3:
        assert abs(np.mean(fits) - (n - 3)) < 4 * np.sqrt(2 * (n - 3) / runs) + 0.1
    else:
        assert max(fits) < 1e-6


def test_towards_the_danger_circle_the_uncertainty_grows_until_there_is_no_fix() -> None:
    # three landmarks on a circle of 3 m about the origin
    angles = np.array([0.3, 1.4, 2.9])
    positions = 3.0 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    sigmas, counts = [], []
    for radius in (1.5, 2.4, 2.8, 2.9, 2.99, 3.0):
        pose = np.array([0.0, -radius, 1.0])
        fixes = resection_fix(positions, seen(pose, positions), SIGMA_RAD**2 * np.eye(3))
        counts.append(len(fixes))
        sigmas += [float(np.sqrt(np.linalg.eigvalsh(fix.covariance[:2, :2])[-1])) for fix in fixes]
    assert counts[:2] == [1, 1]
    assert counts[-2:] == [0, 0]
    assert np.all(np.diff(sigmas) > 0)
    assert sigmas[-1] > 3 * sigmas[0]


def test_near_the_danger_circle_the_covariance_still_covers_the_errors() -> None:
    angles = np.array([0.3, 1.4, 2.9])
    positions = 3.0 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    pose, rng, nees, missing = np.array([0.0, -2.4, 1.0]), np.random.default_rng(6), [], 0
    bearings = seen(pose, positions)
    for _ in range(300):
        fixes = resection_fix(positions, bearings + SIGMA_RAD * rng.normal(size=3), SIGMA_RAD**2 * np.eye(3))
        missing += not fixes
        for fix in fixes:
            error = fix.pose - pose
            error[2] = wrap(error[2])
            nees.append(float(error @ np.linalg.solve(fix.covariance, error)))
    assert missing < 30
    assert np.mean(nees) < 3.75
    assert np.percentile(nees, 99) < 3 * chi2.isf(0.01, 3)


def test_the_bearing_of_a_wrongly_identified_landmark_stands_out() -> None:
    positions = np.vstack([GOAL_AND_POLE, [[-4.5, 0.8], [-4.5, -0.8], [2.0, -3.0]]])
    bearings = seen(np.array([-1.0, -1.0, 2.0]), positions)
    bearings[3] += 0.15
    (fix,) = resection_fix(positions, bearings, SIGMA_RAD**2 * np.eye(6))
    assert int(np.argmax(fix.chi2_each)) == 3
    (without,) = resection_fix(np.delete(positions, 3, axis=0), np.delete(bearings, 3), SIGMA_RAD**2 * np.eye(5))
    assert np.isclose(fix.chi2_each[3], fix.chi2 - without.chi2, rtol=0.1)


@pytest.mark.parametrize(
    ("positions", "bearings"),
    [
        (np.zeros((0, 2)), np.zeros(0)),
        (GOAL_AND_POLE[:2], np.array([0.1, -0.1])),
        (np.array([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]]), np.zeros(3)),
        (np.array([[1.0, 0.0], [1.0, 0.0], [3.0, 1.0]]), np.array([0.0, 0.0, 0.5])),
        (np.ones((3, 2)), np.array([0.0, 0.5, 1.0])),
        (GOAL_AND_POLE, np.zeros(3)),
        (GOAL_AND_POLE, np.array([0.1, np.nan, 1.0])),
        (GOAL_AND_POLE * [[1, np.inf]], np.array([0.1, 0.0, 1.0])),
    ],
)
def test_what_does_not_determine_a_pose_gives_none(positions: FloatArray, bearings: FloatArray) -> None:
    assert resection_fix(positions, bearings, 1e-4 * np.eye(len(positions))) == ()


@given(
    st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(-4, 4)), min_size=3, max_size=5),
    st.floats(1e-4, 1.0),
)
@settings(deadline=None, max_examples=200)
def test_nonsense_never_gives_a_value_that_is_not_finite(rows: list[tuple[float, ...]], sigma: float) -> None:
    table = np.array(rows)
    for fix in resection_fix(table[:, :2], table[:, 2], sigma**2 * np.eye(len(table))):
        for value in (fix.pose, fix.covariance, fix.log_weight, fix.chi2, fix.chi2_each, fix.nonlinearity):
            assert np.all(np.isfinite(value))
        assert np.all(np.linalg.eigvalsh(fix.covariance) > 0)


def test_shapes_and_covariances_that_cannot_be_are_value_errors() -> None:
    bearings = np.array([0.1, 0.2, 1.0])
    for arguments in (
        (GOAL_AND_POLE, bearings[:2], np.eye(3)),
        (GOAL_AND_POLE, bearings, np.eye(2)),
        (GOAL_AND_POLE, bearings, np.zeros((3, 3))),
        (GOAL_AND_POLE, bearings, -np.eye(3)),
        (GOAL_AND_POLE, bearings, np.eye(3), np.zeros((2, 2, 2))),
    ):
        with pytest.raises(ValueError):
            resection_fix(*arguments)
