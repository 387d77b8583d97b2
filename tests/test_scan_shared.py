"""Errors that all of a scan share, against one dense covariance of all that was seen."""

from itertools import product

import numpy as np
import pytest

from fieldloc import pose as se2
from fieldloc.covariance import central_difference, log_peaks
from fieldloc.detection import Detection
from fieldloc.factors import LandmarkFactor, PoseFactor
from fieldloc.field import FieldMap, Landmark
from fieldloc.fixes.landmarks import landmark_fix
from fieldloc.measurements import LandmarkScan
from fieldloc.mixture import Expansion
from fieldloc.pose import FloatArray
from fieldloc.scan_fix import scan_fixes, scan_misfit
from fieldloc.scan_mixture import ScanMixture, scan_mixture
from fieldloc.scan_noise import ScanNoise
from fieldloc.scan_quadratics import quadratics

POSITIONS = np.array([[2.0, 1.0], [2.0, -1.5], [-1.5, 2.0], [0.5, -3.0], [3.5, 0.2]])
SURVEY = np.array([[0.004, 0.001], [0.001, 0.002]])
MOUNT = np.array([0.2, -0.1, 0.7])
POSE = np.array([0.3, -0.2, 0.4])
NOISE = ScanNoise(0.5, 0.2, 0.4, 1.5)
DETECTION = Detection(clutter=0.03, nothing_right=0.1)
RANGE_SHARE, BEARING_RAD = 0.05, 0.03
NARROW = np.diag([0.02, 0.02, 0.02]) ** 2


def field_of(surveyed: bool = False, positions: FloatArray = POSITIONS) -> FieldMap:
    survey = SURVEY if surveyed else np.zeros((2, 2))
    marks = tuple(Landmark(str(i), position, 0.1, survey) for i, position in enumerate(positions))
    return FieldMap("test", np.zeros((0, 2, 2)), np.zeros((0, 3)), marks)


def expected_of(poses: FloatArray, which: FloatArray) -> FloatArray:
    """(..., 2n): ranges and bearings of places (n, 2) from the sensor's pose."""
    at = se2.apply(se2.inverse(poses)[..., None, :], which)
    seen = np.stack([np.hypot(at[..., 0], at[..., 1]), np.arctan2(at[..., 1], at[..., 0])], axis=-1)
    return np.asarray(seen.reshape(*poses.shape[:-1], -1))


def dense(stated: FloatArray, noise: ScanNoise, wider: FloatArray | None = None) -> FloatArray:
    """(2n, 2n) of stated (n, 2, 2). wider: (4,) own range, own bearing, shared range, shared bearing."""
    wider = np.ones(4) if wider is None else wider
    out = np.zeros((2 * len(stated), 2 * len(stated)))
    for i, one in enumerate(stated):
        scale = np.diag(np.sqrt([noise.own_range * wider[0], noise.own_bearing * wider[1]]))
        out[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = scale @ one @ scale
    longer, turned = np.zeros(len(out)), np.zeros(len(out))
    longer[::2] = np.sqrt(stated[:, 0, 0])
    turned[1::2] = np.sqrt(stated[:, 1, 1].mean())
    out += noise.shared_range * wider[2] * np.outer(longer, longer)
    out += noise.shared_bearing * wider[3] * np.outer(turned, turned)
    return out


def surveyed_too(covariance: FloatArray, sensor: FloatArray, which: FloatArray, field: FieldMap) -> FloatArray:
    out = covariance.copy()
    for i, place in enumerate(which):
        by_place = central_difference(lambda p: expected_of(sensor, p[None]), place)
        out[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += by_place @ field.landmarks[0].covariance @ by_place.T
    return out


def scan_of(which: list[int], mount: FloatArray, labelled: bool, seed: int = 1) -> LandmarkScan:
    sensor = se2.compose(POSE, mount)
    seen = expected_of(sensor, POSITIONS[which])
    sigmas = np.stack([RANGE_SHARE * seen[::2], np.full(len(which), BEARING_RAD)], axis=-1)
    stated = sigmas[:, :, None] ** 2 * np.eye(2)
    stated[:, 0, 1] = stated[:, 1, 0] = 0.3 * sigmas[:, 0] * sigmas[:, 1]
    noisy = seen + np.random.default_rng(seed).multivariate_normal(np.zeros(len(seen)), dense(stated, NOISE))
    labels = tuple(str(i) if labelled else None for i in which)
    return LandmarkScan(7, labels, noisy.reshape(-1, 2), stated, mount)


def mixture(
    scan: LandmarkScan, field: FieldMap, noise: ScanNoise = NOISE, wider: FloatArray | None = None
) -> ScanMixture:
    wider = np.ones(4) if wider is None else wider
    own = np.tile(wider[:2], (len(field.landmarks), 1))
    out = scan_mixture(scan, field, DETECTION, own, None, noise, wider[2:])
    assert out is not None
    return out


def log_joint(scan: LandmarkScan, field: FieldMap, match: list[int], pose: FloatArray) -> float:
    """log p(scan, assignment | pose), all errors in one covariance."""
    (x_min, y_min, x_max, y_max), m = field.bounds, len(field.landmarks)
    anywhere = 1.0 / (2 * np.pi * np.hypot(x_max - x_min, y_max - y_min))
    out = np.log(1 - DETECTION.nothing_right)
    for label, j in zip(scan.labels, match, strict=True):
        among = m if label is None else 1
        out += np.log(DETECTION.clutter * anywhere if j < 0 else (1 - DETECTION.clutter) / among)
    rows = [i for i, j in enumerate(match) if j >= 0]
    which = field.positions[[match[i] for i in rows]]
    sensor = se2.compose(pose, scan.robot_from_sensor)
    numbers = np.ravel([[2 * i, 2 * i + 1] for i in rows]).astype(int)
    covariance = dense(scan.covariance, NOISE)[np.ix_(numbers, numbers)]
    covariance = surveyed_too(covariance, sensor, which, field)
    error = scan.range_bearing[rows].ravel() - expected_of(sensor, which)
    error[1::2] = se2.wrap(error[1::2])
    return float(out + log_peaks(covariance) - 0.5 * error @ np.linalg.solve(covariance, error))


CASES = {
    f"{len(which)}{' mounted' * mounted}{' surveyed' * surveyed}{' labels' * labelled}": (
        scan_of(which, MOUNT if mounted else np.zeros(3), labelled),
        field_of(surveyed),
    )
    for which, mounted, surveyed, labelled in (
        ([0], False, False, False),
        ([0, 1], False, True, True),
        ([0, 1, 3], False, False, False),
        ([0, 1, 3], True, True, False),
        ([0, 1, 3, 4], True, False, True),
    )
}
each = pytest.mark.parametrize(("scan", "field"), CASES.values(), ids=CASES.keys())


def all_matches(scan: LandmarkScan, field: FieldMap) -> list[list[int]]:
    m = len(field.landmarks)
    every = product(*(range(-1, m) if label is None else (-1, int(label)) for label in scan.labels))
    return [list(one) for one in every if len({j for j in one if j >= 0}) == sum(j >= 0 for j in one) and max(one) >= 0]


@each
def test_an_expansion_is_the_logarithm_of_the_density_under_one_dense_covariance(
    scan: LandmarkScan, field: FieldMap
) -> None:
    one = mixture(scan, field)
    near = one.expand(POSE[None], NARROW[None])
    best = max(log_joint(scan, field, match, POSE) for match in all_matches(scan, field))
    found = [one.matches(int(i)).tolist() for i in near.ids]
    for match, step, constant, gradient, information in zip(
        found, near.step, near.constant, near.gradient, near.information, strict=True
    ):
        # where it was linearised it is exact; and so is the curvature, up to that of the errors
        at = constant + gradient @ step - 0.5 * step @ information @ step
        np.testing.assert_allclose(at, log_joint(scan, field, match, se2.retract(POSE, step)), atol=0.02)
    for match in all_matches(scan, field):
        if log_joint(scan, field, match, POSE) > best - 5.0:
            assert match in found


def test_what_is_shared_is_taken_out_exactly() -> None:
    scan, field = CASES["4 mounted labels"]
    one = mixture(scan, field)
    sensor, which = se2.compose(POSE, MOUNT), field.positions[[0, 1, 3, 4]]
    terms = one.model.terms(sensor[None], np.array([[0, 1, 3, 4]]), None)
    sums, _ = quadratics(terms)
    of_pose = sums.of_pose(sums.freed())
    jacobian = central_difference(lambda d: expected_of(se2.retract(sensor, d), which), np.zeros(3))
    precision = np.linalg.inv(dense(scan.covariance, NOISE))
    np.testing.assert_allclose(of_pose.information[0], jacobian.T @ precision @ jacobian, rtol=1e-6)
    error = expected_of(sensor, which) - scan.range_bearing.ravel()
    np.testing.assert_allclose(of_pose.gradient[0], -jacobian.T @ precision @ error, rtol=1e-6)


@each
def test_particles_and_hypotheses_are_told_the_same(scan: LandmarkScan, field: FieldMap) -> None:
    one = mixture(scan, field)
    poses = se2.retract(POSE, np.random.default_rng(1).normal(0, 0.05, (10, 3)))
    for pose, value in zip(poses, one.log_likelihood(poses), strict=True):
        terms = [log_joint(scan, field, match, pose) for match in all_matches(scan, field)]
        # assignments that differ are taken for one that is all of them, in proportion
        np.testing.assert_allclose(value, np.logaddexp.reduce([*terms, one.log_outlier]), atol=0.1)


@each
def test_a_wider_scan_says_the_same_whether_by_its_density_or_by_its_quadratic(
    scan: LandmarkScan, field: FieldMap
) -> None:
    wider = np.array([8.0, 3.0, 2.0, 5.0])
    one = mixture(scan, field, wider=wider)
    near = one.expand(POSE[None], 1e-6 * NARROW[None])
    (value,) = one.log_likelihood(POSE[None])
    np.testing.assert_allclose(np.logaddexp.reduce([*near.constant, one.log_outlier]), value, atol=0.1)


def test_the_widened_density_has_the_peak_of_the_one_that_is_not() -> None:
    scan, field = CASES["4 mounted labels"]
    wider = np.array([8.0, 3.0, 2.0, 5.0])
    sensor, which = se2.compose(POSE, MOUNT), field.positions[[0, 1, 3, 4]]
    error = expected_of(sensor, which) - scan.range_bearing.ravel()
    plain, widened = dense(scan.covariance, NOISE), dense(scan.covariance, NOISE, wider)
    expected = log_peaks(plain) - 0.5 * error @ np.linalg.solve(widened, error)
    one = mixture(scan, field, wider=wider)
    near = one.expand(POSE[None], 1e-6 * NARROW[None])
    whole = [one.matches(int(i)).tolist() for i in near.ids].index([0, 1, 3, 4])
    prior = log_joint(scan, field, [0, 1, 3, 4], POSE) - (
        log_peaks(plain) - 0.5 * error @ np.linalg.solve(plain, error)
    )
    np.testing.assert_allclose(near.constant[whole], expected + prior, atol=1e-3)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("wider", [None, np.array([8.0, 3.0, 2.0, 5.0])])
def test_what_follows_from_a_quadratic_is_the_same_worked_out_anew(name: str, wider: FloatArray | None) -> None:
    one = mixture(*CASES[name], wider=wider)
    near = one.expand(POSE[None], NARROW[None])
    columns = near.parent, near.ids, near.constant, near.gradient, near.information, near.covariance
    for carried, anew in zip(near.after, Expansion(*columns).after, strict=True):
        np.testing.assert_allclose(carried, anew, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_a_pose_alone_is_expanded_as_one_of_many(name: str) -> None:
    one = mixture(*CASES[name])
    alone, many = one.expand(POSE[None], NARROW[None]), one.expand(np.tile(POSE, (2, 1)), np.tile(NARROW, (2, 1, 1)))
    count = len(alone.ids)
    assert count
    assert len(many.ids) == 2 * count
    of_first = np.flatnonzero(many.parent == 0)
    np.testing.assert_array_equal(alone.ids, many.ids[of_first])
    for ours, theirs in ((alone.constant, many.constant), (alone.gradient, many.gradient), (alone.step, many.step)):
        np.testing.assert_allclose(ours, theirs[of_first], rtol=1e-7, atol=1e-9)


def test_a_fix_is_that_of_least_squares_under_the_dense_covariance() -> None:
    scan, field = CASES["4 mounted labels"]
    one = mixture(scan, field)
    match = np.array([0, 1, 3, 4])
    (fix,) = scan_fixes(one.model, match, MOUNT, None)
    which, precision = field.positions[match], np.linalg.inv(dense(scan.covariance, NOISE))

    def seen_after(step: FloatArray) -> FloatArray:
        return expected_of(se2.compose(se2.retract(pose, step), MOUNT), which)

    pose = POSE
    for _ in range(8):
        by_pose = central_difference(seen_after, np.zeros(3))
        error = scan.range_bearing.ravel() - seen_after(np.zeros(3))
        covariance = np.linalg.inv(by_pose.T @ precision @ by_pose)
        pose = se2.retract(pose, covariance @ by_pose.T @ precision @ error)
    off = se2.local(pose, fix.pose)
    assert off @ np.linalg.solve(covariance, off) < 1e-8
    in_robot = PoseFactor.from_fix(7, fix).covariance
    np.testing.assert_allclose(in_robot, covariance, atol=1e-4 * np.abs(covariance).max())
    assert fix.chi2 == pytest.approx(float(error @ precision @ error), rel=1e-6)
    assert scan_misfit(one.model, match, MOUNT, fix.pose) == pytest.approx(fix.chi2, rel=1e-9)


def test_what_leaving_a_landmark_out_gains_is_right_with_ranges_that_err_together() -> None:
    positions = field_of().positions[:4]
    z = expected_of(POSE, positions).reshape(-1, 2) + [[0.02, 0.01], [-0.01, 0.005], [0.015, -0.01], [0.0, 0.005]]
    own, longer = np.tile(np.diag([0.01, 0.01]) ** 2, (4, 1, 1)), 0.05 * z[:, 0]
    (whole,) = landmark_fix(positions, z, own, shared_range_m=longer)
    for i in range(4):
        rest = np.arange(4) != i
        (without,) = landmark_fix(positions[rest], z[rest], own[rest], shared_range_m=longer[rest])
        assert np.isclose(whole.chi2_each[i], whole.chi2 - without.chi2, rtol=0.02, atol=1e-3)


def test_fixes_of_scans_with_shared_errors_are_as_far_off_as_they_say() -> None:
    far_off = []
    for seed in range(300):
        scan = scan_of([0, 1, 3, 4], MOUNT, labelled=True, seed=seed)
        one = mixture(scan, field_of())
        near = one.expand(POSE[None], 100 * NARROW[None])
        factor, *_ = one.chosen(int(near.ids[np.argmax(near.evidence)]))
        if isinstance(factor, PoseFactor):
            error = factor.error(POSE)
            far_off.append(float(error @ np.linalg.solve(factor.covariance, error)))
    # mean of 300 chi-square of three: 3 +- 0.14; four of these
    assert len(far_off) > 280
    assert np.mean(far_off) == pytest.approx(3.0, abs=0.57)


def test_solutions_are_as_sure_as_the_fix_of_their_landmarks() -> None:
    scan, field = CASES["3 mounted surveyed"]
    one = mixture(scan, field)
    found = one.solutions()
    ids = {tuple(one.matches(int(i)).tolist()): row for row, i in enumerate(found.ids)}
    row = ids[(0, 1, 3)]
    (fix,) = scan_fixes(one.model, np.array([0, 1, 3]), MOUNT, None)
    np.testing.assert_allclose(found.poses[row], fix.pose, atol=2e-3)
    in_robot = PoseFactor.from_fix(7, fix).covariance
    np.testing.assert_allclose(found.covariances[row], in_robot, atol=0.1 * np.abs(in_robot).max())


def test_one_landmark_alone_is_as_uncertain_as_both_its_errors() -> None:
    scan, field = CASES["1"]
    one = mixture(scan, field)
    near = one.expand(POSE[None], NARROW[None])
    (factor,) = one.chosen(int(near.ids[0]))
    assert isinstance(factor, LandmarkFactor)
    r, b = scan.range_bearing[0]
    axes = se2.rotation(b) * [1.0, r]
    np.testing.assert_allclose(factor.covariance, axes @ dense(scan.covariance, NOISE) @ axes.T, rtol=1e-9)
