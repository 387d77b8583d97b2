"""A scan's mixture against sums over all assignments, one by one, and integrals over all poses, by sums."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from fieldloc import pose as se2
from fieldloc.detection import Detection
from fieldloc.factors import LandmarkFactor, PoseFactor
from fieldloc.field import FieldMap, Landmark, load_field
from fieldloc.fixes.landmarks import landmark_fix
from fieldloc.measurements import LandmarkScan
from fieldloc.pose import FloatArray
from fieldloc.resolution import Belief, sure
from fieldloc.scan_mixture import ScanMixture, scan_mixture

DETECTION = Detection(clutter=0.03, nothing_right=0.1)
SIGMA = np.array([0.05, 0.03])
MOUNT = np.array([0.2, -0.1, 0.7])
SURVEY = np.array([[0.004, 0.001], [0.001, 0.002]])
POSITIONS = np.array([[2.0, 1.0], [2.0, -1.5], [-1.5, 2.0], [0.5, -3.0], [3.5, 0.2]])
NARROW = np.diag([0.02, 0.02, 0.02]) ** 2
Labels = Sequence[str | None]


def field_of(positions: FloatArray = POSITIONS, survey: FloatArray | None = None) -> FieldMap:
    covariance = np.zeros((2, 2)) if survey is None else survey
    marks = tuple(Landmark(str(i), position, 0.1, covariance) for i, position in enumerate(positions))
    return FieldMap("test", np.zeros((0, 2, 2)), np.zeros((0, 3)), marks)


def scan_of(
    pose: FloatArray, which: FloatArray, mount: FloatArray | None = None, noise: FloatArray | float = 0.0
) -> LandmarkScan:
    """What is seen at places which (n, 2) from a pose, with an error of so many sigmas."""
    mount = np.zeros(3) if mount is None else mount
    at = se2.apply(se2.inverse(se2.compose(pose, mount)), which)
    seen = np.stack([np.hypot(at[:, 0], at[:, 1]), np.arctan2(at[:, 1], at[:, 0])], axis=-1)
    covariance = np.tile(np.diag(SIGMA**2), (len(which), 1, 1))
    return LandmarkScan(7, (None,) * len(which), seen + noise * SIGMA, covariance, mount)


def labelled(scan: LandmarkScan, labels: Labels) -> LandmarkScan:
    return LandmarkScan(scan.stamp_ns, tuple(labels), scan.range_bearing, scan.covariance, scan.robot_from_sensor)


def mixture(scan: LandmarkScan, field: FieldMap, wider: float = 1.0) -> ScanMixture:
    out = scan_mixture(scan, field, DETECTION, np.full((len(field.landmarks), 2), wider))
    assert out is not None
    return out


def log_normal(error: FloatArray, covariance: FloatArray) -> float:
    return float(-0.5 * (error @ np.linalg.solve(covariance, error) + np.linalg.slogdet(2 * np.pi * covariance)[1]))


def every_assignment(scan: LandmarkScan, field: FieldMap) -> Iterator[tuple[int, ...]]:
    m = len(field.landmarks)
    options = [range(-1, m) if label is None else (-1, int(label)) for label in scan.labels]
    for match in product(*options):
        taken = [j for j in match if j >= 0]
        if len(set(taken)) == len(taken):
            yield match


def log_prior(scan: LandmarkScan, field: FieldMap, match: Sequence[int]) -> float:
    """Of a scan that is right with just these matches, and the density of its clutter."""
    (x_min, y_min, x_max, y_max), m = field.bounds, len(field.landmarks)
    anywhere = 1.0 / (2 * np.pi * np.hypot(x_max - x_min, y_max - y_min))
    out = np.log(1 - DETECTION.nothing_right)
    for label, j in zip(scan.labels, match, strict=True):
        among = m if label is None else 1
        out += np.log(DETECTION.clutter * anywhere if j < 0 else (1 - DETECTION.clutter) / among)
    return float(out)


def log_joint(scan: LandmarkScan, field: FieldMap, match: Sequence[int], pose: FloatArray) -> float:
    """log p(scan, assignment | pose), from the words of the module."""
    sensor = se2.compose(pose, scan.robot_from_sensor)
    out = log_prior(scan, field, match)
    for i, j in enumerate(match):
        if j >= 0:
            to = field.positions[j] - sensor[:2]
            d = np.hypot(*to)
            u = to / d
            by_place = np.array([u, np.array([-u[1], u[0]]) / d])
            error = scan.range_bearing[i] - [d, np.arctan2(to[1], to[0]) - sensor[2]]
            error[1] = se2.wrap(error[1])
            out += log_normal(error, scan.covariance[i] + by_place @ field.positions_covariance[j] @ by_place.T)
    return out


def log_wrong(scan: LandmarkScan, field: FieldMap) -> float:
    (x_min, y_min, x_max, y_max), n = field.bounds, len(scan.labels)
    return float(np.log(DETECTION.nothing_right) - n * np.log(2 * np.pi * np.hypot(x_max - x_min, y_max - y_min)))


POSE = np.array([0.3, -0.2, 0.4])
CASES = {
    "one": (scan_of(POSE, POSITIONS[:1], noise=0.5), field_of()),
    "three": (scan_of(POSE, POSITIONS[[0, 1, 3]], noise=0.5), field_of()),
    "mounted": (scan_of(POSE, POSITIONS[[0, 1, 3]], MOUNT, noise=0.5), field_of()),
    "surveyed": (scan_of(POSE, POSITIONS[[0, 1, 3]], MOUNT, noise=0.5), field_of(survey=SURVEY)),
    "labels": (labelled(scan_of(POSE, POSITIONS[[0, 1, 3]], noise=0.5), ["0", None, "3"]), field_of()),
    "twice": (scan_of(POSE, POSITIONS[[0, 0, 1]] + [[0, 0], [0.05, 0.05], [0, 0]]), field_of()),
    "thrice": (scan_of(POSE, POSITIONS[[0, 0, 0]] + [[0, 0], [0.05, 0.05], [-0.05, 0]]), field_of()),
    "clutter": (scan_of(POSE, np.array([[2.0, 1.0], [1.0, 0.5], [2.0, -1.5]])), field_of()),
    "crowded": (scan_of(POSE, POSITIONS[[0, 1]]), field_of(np.vstack([POSITIONS, POSITIONS[:2] + 0.08]), SURVEY)),
}
each = pytest.mark.parametrize(("scan", "field"), CASES.values(), ids=CASES.keys())


@each
def test_the_likelihood_is_the_sum_over_all_assignments(scan: LandmarkScan, field: FieldMap) -> None:
    poses = se2.retract(POSE, np.random.default_rng(1).normal(0, 0.1, (20, 3)))
    found = mixture(scan, field).log_likelihood(poses)
    for pose, value in zip(poses, found, strict=True):
        terms = [log_joint(scan, field, match, pose) for match in every_assignment(scan, field)]
        # gated is what is less likely than e^-9 of what there is without an error
        np.testing.assert_allclose(value, np.logaddexp.reduce([*terms, log_wrong(scan, field)]), atol=0.01)


@each
def test_an_expansion_is_the_logarithm_of_each_assignment_s_density(scan: LandmarkScan, field: FieldMap) -> None:
    one = mixture(scan, field)
    near = one.expand(POSE[None], NARROW[None])
    matches = {match: log_joint(scan, field, match, POSE) for match in every_assignment(scan, field)}
    best = max(matches.values())
    found = [tuple(one.matches(int(i)).tolist()) for i in near.ids]
    assert len(set(found)) == len(found)
    for match, step, constant, gradient, information in zip(
        found, near.step, near.constant, near.gradient, near.information, strict=True
    ):
        at = constant + gradient @ step - 0.5 * step @ information @ step
        np.testing.assert_allclose(at, log_joint(scan, field, match, se2.retract(POSE, step)), atol=0.02)
    for match, value in matches.items():
        if value > best - 5.0 and max(match) >= 0:
            assert match in found


def test_a_true_pose_is_never_gated_out() -> None:
    # about once in ten thousand each; three of them, a hundred times
    random = np.random.default_rng(5)
    missed = 0
    for _ in range(100):
        pose = np.array([*random.uniform(-2, 2, 2), random.uniform(-3, 3)])
        which = random.permutation(len(POSITIONS))[:3]
        believed = se2.retract(pose, np.array([0.3, 0.3, 0.1]) * random.standard_normal(3))
        seen = scan_of(pose, POSITIONS[which], noise=random.standard_normal((3, 2)))
        one = mixture(seen, field_of())
        near = one.expand(believed[None], np.diag([0.3, 0.3, 0.1])[None] ** 2)
        missed += not any(np.array_equal(one.matches(int(i)), which) for i in near.ids)
    assert missed <= 1


def test_hypotheses_are_expanded_each_for_itself() -> None:
    scan, field = CASES["three"]
    poses = se2.retract(POSE, np.random.default_rng(2).normal(0, 0.05, (12, 3)))
    poses[5] += 40.0  # which sees nothing of this
    spread = np.tile(4 * NARROW, (len(poses), 1, 1))
    one = mixture(scan, field)
    together = one.expand(poses, spread)
    assert set(together.parent) == set(range(12)) - {5}
    for h in range(len(poses)):
        alone = one.expand(poses[h : h + 1], spread[h : h + 1])
        mine = together.parent == h
        order, other = np.argsort(together.ids[mine]), np.argsort(alone.ids)
        np.testing.assert_array_equal(together.ids[mine][order], alone.ids[other])
        np.testing.assert_allclose(together.evidence[mine][order], alone.evidence[other], atol=0.05)
        np.testing.assert_allclose(together.step[mine][order], alone.step[other], atol=2e-3)


@each
def test_the_evidence_is_the_integral_of_likelihood_times_belief(scan: LandmarkScan, field: FieldMap) -> None:
    one = mixture(scan, field)
    spread = np.diag([0.05, 0.05, 0.04]) ** 2
    draws = np.random.default_rng(3).multivariate_normal(np.zeros(3), spread, size=10_000)
    sampled = np.mean(np.exp(one.log_likelihood(se2.retract(POSE, draws)) - one.log_right))
    near = one.expand(POSE[None], spread[None])
    total = np.logaddexp.reduce(np.append(near.evidence, one.log_outlier)) - one.log_right
    np.testing.assert_allclose(np.exp(total), sampled, rtol=0.06)


@pytest.mark.parametrize("case", ["mounted", "surveyed", "labels", "clutter"])
def test_a_solution_s_weight_is_its_integral_over_poses(case: str) -> None:
    scan, field = CASES[case]
    one = mixture(scan, field)
    found = one.solutions()
    assert found.log_weights.tolist() == sorted(found.log_weights, reverse=True)
    draws = np.random.default_rng(4).standard_normal((500, 3))
    for pose, covariance, weight, solution in zip(
        found.poses[:3], found.covariances[:3], found.log_weights[:3], found.ids[:3], strict=True
    ):
        # importance sampling from an ellipse twice as wide
        root = 2.0 * np.linalg.cholesky(covariance)
        log_sampler = [log_normal(root @ d, root @ root.T) for d in draws]
        log_target = [
            log_joint(scan, field, one.matches(int(solution)).tolist(), se2.retract(pose, root @ d)) for d in draws
        ]
        ratio = np.exp(np.array(log_target) - log_sampler - weight)
        np.testing.assert_allclose(ratio.mean(), 1.0, atol=0.15)


def integral(one: ScanMixture, field: FieldMap) -> float:
    """Over positions on and about the field and all headings, without the outlier: a sum over a grid."""
    x_min, y_min, x_max, y_max = field.bounds
    xs, ys = np.arange(x_min - 1, x_max + 1, 0.08), np.arange(y_min - 1, y_max + 1, 0.08)
    headings = np.arange(-np.pi, np.pi, 2 * np.pi / 100)
    grid = np.stack(np.meshgrid(xs, ys, headings, indexing="ij"), axis=-1).reshape(-1, 3)
    every = np.exp(one.log_likelihood(grid)) - np.exp(one.log_outlier)
    return float(np.sum(every) * 0.08**2 * (headings[1] - headings[0]))


def coarse(scan: LandmarkScan, sigma_m: float, sigma_rad: float) -> LandmarkScan:
    """So that a coarse grid will do."""
    noise = np.tile(np.diag([sigma_m, sigma_rad]) ** 2, (len(scan.labels), 1, 1))
    return LandmarkScan(7, scan.labels, scan.range_bearing, noise)


def test_one_landmark_weighs_as_much_as_its_rings_and_fixes_no_pose() -> None:
    scan, field = CASES["one"]
    one = mixture(coarse(scan, 0.2, 0.1), field)
    assert not len(one.solutions().ids)
    np.testing.assert_allclose(np.exp(one.log_integral), integral(one, field), rtol=0.05)


@pytest.mark.parametrize(("apart_m", "whole"), [(2.5, True), (0.3, False)])
def test_two_landmarks_weigh_as_much_as_all_poses_from_which_they_are_seen(apart_m: float, whole: bool) -> None:
    # first-order volumes, of bananas where the two are close together: a factor of 1.5 is half a nat
    posts = field_of(np.array([[2.0, -1.0], [2.0, -1.0 + apart_m]]))
    field = replace(posts, lines=np.array([[[-1.0, -4.0], [5.0, 3.0]]]))  # where the robot can be
    one = mixture(coarse(scan_of(POSE, field.positions), 0.12, 0.06), field)
    assert bool(len(one.solutions().ids)) is whole
    ratio = np.exp(one.log_integral) / integral(one, field)
    assert 1 / 1.5 < ratio < (1.15 if whole else 1.5)


def test_solutions_are_those_of_trying_every_assignment_that_leaves_one_of_three_out() -> None:
    scan, field = CASES["three"]
    one = mixture(scan, field)
    found = [tuple(one.matches(int(i)).tolist()) for i in one.solutions().ids]
    poses = dict(zip(found, one.solutions().poses, strict=True))
    assert found[0] == (0, 1, 3)
    np.testing.assert_allclose(poses[(0, 1, 3)], POSE, atol=0.06)
    # brute force: least squares of every assignment, from the pose of every solution and from a ring of starts
    for match in every_assignment(scan, field):
        explained = [i for i, j in enumerate(match) if j >= 0]
        if len(explained) < 2:
            continue
        fixes = landmark_fix(
            field.positions[[match[i] for i in explained]],
            scan.range_bearing[explained],
            scan.covariance[explained],
        )
        if fixes and fixes[0].chi2 < 8.0 and fixes[0].nonlinearity < 0.3:
            assert match in found
            np.testing.assert_allclose(poses[match], fixes[0].pose, atol=0.01)


def test_a_chosen_solution_is_a_pose_or_its_landmarks() -> None:
    scan, field = CASES["surveyed"]
    one = mixture(scan, field)
    ids = {tuple(one.matches(int(i)).tolist()): int(i) for i in one.solutions().ids}
    (factor,) = one.chosen(ids[(0, 1, 3)])
    assert isinstance(factor, PoseFactor)
    row = one.solutions().ids.tolist().index(ids[(0, 1, 3)])
    np.testing.assert_allclose(factor.pose, one.solutions().poses[row], atol=1e-3)
    np.testing.assert_allclose(factor.covariance, one.solutions().covariances[row], rtol=0.1, atol=1e-5)
    single = mixture(*CASES["one"])
    near = single.expand(POSE[None], NARROW[None])
    (landmark,) = single.chosen(int(near.ids[0]))
    assert isinstance(landmark, LandmarkFactor)
    np.testing.assert_array_equal(landmark.landmark, POSITIONS[0])
    np.testing.assert_allclose(landmark.error(POSE), 0.0, atol=0.1)


def test_what_was_seen_just_before_is_chosen_with_a_wide_covariance_but_checked_by_a_narrow_one() -> None:
    off = np.array([[6.0, 0.0], [-6.0, 0.0], [6.0, 0.0]])
    for noise, is_pose in ((0.3 * off / 6.0, True), (off, False)):
        scan = scan_of(POSE, POSITIONS[[0, 1, 3]], noise=noise)
        one = mixture(labelled(scan, ["0", "1", "3"]), field_of(), wider=50.0)
        wide = one.expand(POSE[None], 400 * NARROW[None])
        best = int(wide.ids[np.argmax((np.array([one.matches(int(i)) for i in wide.ids]) >= 0).sum(axis=1))])
        assert (one.matches(best) >= 0).all()
        factors = one.chosen(best)
        assert isinstance(factors[0], PoseFactor) is is_pose
        if is_pose:
            news = mixture(labelled(scan, ["0", "1", "3"]), field_of())
            (fresh,) = news.chosen(int(news.solutions().ids[0]))
            np.testing.assert_allclose(factors[0].covariance, 50 * fresh.covariance, rtol=0.3)


def test_a_repeated_sight_tells_places_apart_no_more_than_it_is_news() -> None:
    scan, field = CASES["three"]
    there = se2.retract(POSE, np.array([0.08, 0.0, 0.0]))
    pair = np.stack([POSE, there])
    spread = np.tile(1e-6 * np.eye(3), (2, 1, 1))
    contrast = {}
    for wider in (1.0, 40.0):
        near = mixture(scan, field, wider).expand(pair, spread)
        best = [near.evidence[near.parent == h].max() for h in (0, 1)]
        contrast[wider] = best[0] - best[1]
    np.testing.assert_allclose(contrast[40.0], contrast[1.0] / 40.0, rtol=0.05, atol=0.01)


def test_that_there_are_more_to_choose_from_is_no_news_when_it_is_seen_again() -> None:
    """Two groups that look alike from two places, of three landmarks and of one: a scan of one of them."""
    trio = np.array([[2.0, 0.0], [2.02, 0.03], [2.02, -0.03]])
    field = field_of(np.vstack([trio, [[-2.0, 0.0]]]))
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.pi]])
    contrast = {}
    for wider in (1.0, 1000.0):
        one = mixture(scan_of(poses[0], trio[:1]), field, wider)
        near = one.expand(poses, np.tile(0.01 * NARROW, (2, 1, 1)))
        each = [np.logaddexp.reduce(near.evidence[near.parent == h]) for h in (0, 1)]
        contrast[wider] = each[0] - each[1]
    assert contrast[1.0] > 0.7
    assert abs(contrast[1000.0]) < 0.01


def test_the_landmarks_seen_are_those_of_the_likeliest_assignment() -> None:
    assert mixture(*CASES["three"]).landmarks_seen(POSE) == (0, 1, 3)
    assert mixture(*CASES["clutter"]).landmarks_seen(POSE) == (0, 1)
    assert mixture(*CASES["mounted"]).landmarks_seen(POSE) == (0, 1, 3)
    assert mixture(*CASES["three"]).landmarks_seen(POSE + [0.0, 0.0, 2.0]) == ()


def test_only_labels_break_the_map_s_symmetry() -> None:
    spl = load_field("spl")
    scan = scan_of(POSE, spl.positions[:2])
    alike = mixture(scan, spl)
    assert alike.symmetric
    twin = se2.compose(spl.symmetries[0], POSE)
    np.testing.assert_allclose(*alike.log_likelihood(np.stack([POSE, twin])))
    named = mixture(labelled(scan, [spl.labels[0], None]), spl)
    assert not named.symmetric
    here, there = named.log_likelihood(np.stack([POSE, twin]))
    assert here > there + 5
    assert len(alike.solutions().ids) >= 2
    centre = field_of(np.array([[0.0, 0.0], [2.0, 0.0], [-2.0, 0.0]]))
    assert mixture(labelled(scan_of(POSE, centre.positions[:1]), ["0"]), centre).symmetric


def test_a_robot_of_which_99_percent_are_sure_gets_its_factors() -> None:
    scan, field = CASES["three"]
    (factor,) = sure(mixture(scan, field), Belief(POSE, NARROW))
    np.testing.assert_allclose(factor.error(POSE), 0.0, atol=0.06)


def test_what_is_of_the_map_by_no_means_is_left_out() -> None:
    scan, field = CASES["three"]
    nowhere = labelled(scan, ["north", "south", "east"])
    assert scan_mixture(nowhere, field, DETECTION, np.ones((5, 2))) is None
    empty = LandmarkScan(7, (), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    assert scan_mixture(empty, field, DETECTION, np.ones((5, 2))) is None
    assert scan_mixture(scan, field_of(np.zeros((0, 2))), DETECTION, np.ones((0, 2))) is None
    some = mixture(labelled(scan, ["0", "south", None]), field)
    assert some.scan.labels == ("0", None)
    broken = scan.range_bearing.copy()
    broken[0], broken[1] = [np.nan, 0.1], [-1.0, 0.1]
    left = mixture(LandmarkScan(7, scan.labels, broken, scan.covariance), field)
    assert len(left.scan.labels) == 1
    with pytest.raises(ValueError, match="positive definite"):
        mixture(LandmarkScan(7, scan.labels, scan.range_bearing, 0.0 * scan.covariance), field)


def test_nonsense_gives_no_value_that_is_not_finite() -> None:
    random = np.random.default_rng(8)
    for _ in range(40):
        n, m = int(random.integers(1, 7)), int(random.integers(1, 9))
        field = field_of(np.round(random.uniform(-3, 3, (m, 2))), SURVEY * random.integers(0, 2))  # some coincide
        seen = np.column_stack([random.uniform(0.01, 5, n), np.round(random.uniform(-3, 3, n))])
        noise = np.tile(np.diag(random.uniform(1e-3, 0.5, 2) ** 2), (n, 1, 1))
        labels = [None if random.random() < 0.7 else str(random.integers(m)) for _ in range(n)]
        one = mixture(LandmarkScan(7, tuple(labels), seen, noise), field, random.choice([1.0, 30.0]))
        poses = np.column_stack([np.round(random.uniform(-3, 3, (9, 2))), random.uniform(-3, 3, 9)])
        spread = np.tile(np.diag(random.uniform(1e-3, 1.0, 3)) ** 2, (9, 1, 1))
        near, found = one.expand(poses, spread), one.solutions()
        for value in (near.constant, near.gradient, near.information, near.evidence, near.step, near.updated):
            assert np.isfinite(value).all()
        for value in (found.poses, found.covariances, found.log_weights, one.log_likelihood(poses)):
            assert np.isfinite(value).all()
        assert (np.linalg.eigvalsh(found.covariances) > 0).all()
        assert not np.isnan(one.log_integral)
        for solution in {*near.ids.tolist(), *found.ids.tolist()}:
            for factor in one.chosen(solution):
                assert np.isfinite(factor.error(poses)).all()
            taken = one.matches(solution)[one.matches(solution) >= 0]
            assert len(set(taken.tolist())) == len(taken) >= 1
