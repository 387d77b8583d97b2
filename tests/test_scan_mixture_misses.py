"""What a scan says by what it does not show: nothing before it is known what the sensor covers, then a little."""

from itertools import product

import numpy as np
import pytest

from fieldloc import pose as se2
from fieldloc.detection import Detection
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation
from fieldloc.scan_coverage import Coverage, Misses, Sightings
from fieldloc.scan_mixture import ScanMixture, scan_mixture
from fieldloc.scan_wrong import Sector

DETECTION = Detection(clutter=0.03, nothing_right=0.1, landmark=0.4)
SIGMA = np.array([0.05, 0.03])
POSITIONS = np.array([[2.0, 1.0], [2.0, -0.8], [-1.5, 2.0], [0.5, -3.0], [3.5, 0.2]])
POSE = np.array([0.3, -0.2, 0.1])
NARROW = np.diag([0.02, 0.02, 0.02]) ** 2
NOTHING = np.zeros((0, 2))


def field_of(positions: FloatArray = POSITIONS) -> FieldMap:
    marks = tuple(Landmark(str(i), position, 0.1, np.zeros((2, 2))) for i, position in enumerate(positions))
    return FieldMap("test", np.zeros((0, 2, 2)), np.zeros((0, 3)), marks)


def polar(pose: FloatArray, points: FloatArray) -> FloatArray:
    at = se2.apply(se2.inverse(pose), points)
    return np.stack([np.hypot(at[:, 0], at[:, 1]), np.arctan2(at[:, 1], at[:, 0])], axis=-1)


def scan_of(pose: FloatArray, which: FloatArray, stamp_ns: int = 7, mount: FloatArray | None = None) -> LandmarkScan:
    mount = np.zeros(3) if mount is None else mount
    seen = polar(se2.compose(pose, mount), which)
    covariance = np.tile(np.diag(SIGMA**2), (len(which), 1, 1))
    return LandmarkScan(stamp_ns, (None,) * len(which), seen, covariance, mount)


def coverage_of(field: FieldMap, half_rad: float = 1.0, far_m: float = 5.0) -> Coverage:
    """After many sights of things all over a sector."""
    random = np.random.default_rng(0)
    sightings = Sightings(field, DETECTION.landmark)
    sightings.see(np.column_stack([random.uniform(0.5, far_m, 500), random.uniform(-half_rad, half_rad, 500)]))
    assert sightings.coverage is not None
    return sightings.coverage


def mixture(scan: LandmarkScan, field: FieldMap, power: float = 1.0) -> ScanMixture:
    misses = Misses(coverage_of(field), power, scan.range_bearing)
    out = scan_mixture(scan, field, DETECTION, np.ones((len(field.landmarks), 2)), misses)
    assert out is not None
    return out


def log_normal(error: FloatArray) -> float:
    return float(np.sum(-0.5 * (error / SIGMA) ** 2 - np.log(SIGMA) - 0.5 * np.log(2 * np.pi)))


def terms(scan: LandmarkScan, field: FieldMap, misses: Misses, pose: FloatArray) -> dict[tuple[int, ...], float]:
    """log p(scan, assignment | pose) of all assignments that explain something, from the words of the module."""
    (x_min, y_min, x_max, y_max), m = field.bounds, len(field.landmarks)
    anywhere = 1.0 / (2 * np.pi * np.hypot(x_max - x_min, y_max - y_min))
    sensor = se2.compose(pose, scan.robot_from_sensor)
    missed = misses.log_missed(sensor[None])[0]
    expected = polar(sensor, field.positions)
    out = {}
    for match in product(range(-1, m), repeat=len(scan.labels)):
        taken = [j for j in match if j >= 0]
        if not taken or len(set(taken)) < len(taken):
            continue
        value = np.log(1 - DETECTION.nothing_right) + sum(missed[j] for j in range(m) if j not in taken)
        for seen, j in zip(scan.range_bearing, match, strict=True):
            if j < 0:
                value += np.log(DETECTION.clutter * anywhere)
            else:
                value += np.log((1 - DETECTION.clutter) / m) + log_normal(seen - expected[j])
        out[match] = float(value)
    return out


MOUNTED = scan_of(POSE, POSITIONS[[0]], mount=np.array([0.1, -0.1, 0.2]))
SCANS = {"one": scan_of(POSE, POSITIONS[[0]]), "two": scan_of(POSE, POSITIONS[[0, 4]]), "mounted": MOUNTED}
each = pytest.mark.parametrize("scan", SCANS.values(), ids=SCANS.keys())


@each
@pytest.mark.parametrize("power", [1.0, 0.2])
def test_the_likelihood_is_the_sum_over_all_assignments_of_what_is_seen_and_what_is_not(
    scan: LandmarkScan, power: float
) -> None:
    field = field_of()
    one = mixture(scan, field, power)
    assert one.misses is not None
    for pose in se2.retract(POSE, np.random.default_rng(1).normal(0, 0.1, (10, 3))):
        every = [*terms(scan, field, one.misses, pose).values(), one.log_outlier]
        np.testing.assert_allclose(one.log_likelihood(pose), np.logaddexp.reduce(every), atol=0.01)


@each
def test_an_expansion_s_evidence_has_what_is_not_seen(scan: LandmarkScan) -> None:
    field = field_of()
    one = mixture(scan, field)
    assert one.misses is not None
    certain = np.tile(1e-8 * np.eye(3), (1, 1, 1))
    near = one.expand(POSE[None], certain)
    every = terms(scan, field, one.misses, POSE)
    assert len(near.ids)
    for solution, evidence in zip(near.ids, near.evidence, strict=True):
        np.testing.assert_allclose(evidence, every[tuple(one.matches(int(solution)).tolist())], atol=0.02)


def test_a_solution_weighs_less_by_the_landmarks_that_it_should_have_shown() -> None:
    field, scan = field_of(), scan_of(POSE, POSITIONS[[0, 4]])
    one = mixture(scan, field)
    plain = scan_mixture(scan, field, DETECTION, np.ones((5, 2)))
    assert one.misses is not None
    assert plain is not None
    weight, before = (
        {tuple(m.matches(int(i))): w for i, w in zip(s.ids, s.log_weights, strict=True)}
        for m, s in ((one, one.solutions()), (plain, plain.solutions()))
    )
    # landmark 1 stands beside the two seen
    np.testing.assert_allclose(weight[0, 4] - before[0, 4], np.log(1 - DETECTION.landmark), atol=0.02)
    assert one.solutions().log_weights.tolist() == sorted(one.solutions().log_weights, reverse=True)
    np.testing.assert_array_less(one.log_integral, plain.log_integral)


def test_a_visible_landmark_that_is_not_seen_makes_a_pose_less_likely() -> None:
    log_missed = coverage_of(field_of()).log_missed(POSE[None], None, NOTHING)[0]
    np.testing.assert_allclose(log_missed[[0, 1]], np.log(1 - DETECTION.landmark))
    assert log_missed[0] < log_missed[4] < 0.0  # at the far end
    np.testing.assert_array_equal(log_missed[[2, 3]], 0.0)  # behind, beside


def test_a_landmark_behind_another_or_behind_what_was_seen_need_not_be_seen() -> None:
    field = field_of(np.vstack([POSITIONS, POSE[:2] + 1.5 * (POSITIONS[1] - POSE[:2])]))
    coverage = coverage_of(field)
    log_missed = coverage.log_missed(POSE[None], None, NOTHING)[0]
    assert log_missed[1] < -0.4
    assert log_missed[5] == 0.0
    nearer = polar(POSE, POSITIONS[[1]]) * [0.5, 1.0]
    assert coverage.log_missed(POSE[None], None, nearer)[0, 1] == 0.0
    farther = polar(POSE, POSITIONS[[1]]) * [1.5, 1.0]
    np.testing.assert_array_equal(coverage.log_missed(POSE[None], None, farther)[0], log_missed)


def test_what_is_at_the_border_or_for_all_one_knows_of_the_pose_says_less() -> None:
    coverage = coverage_of(field_of(np.array([[2.0, 0.0]])))
    turned = np.column_stack([np.zeros((60, 2)), np.linspace(0.0, 1.2, 60)])
    faded = coverage.log_missed(turned, None, NOTHING)[:, 0]
    assert (np.diff(faded) >= 0.0).all()
    assert np.diff(faded).max() < 0.1
    assert faded[0] < -0.4
    assert faded[-1] == 0.0
    unsure = [coverage.log_missed(turned[:1], np.diag([s, s, s])[None] ** 2, NOTHING)[0, 0] for s in (0.05, 0.5, 2.0)]
    assert unsure[0] < unsure[1] <= unsure[2] == 0.0


def test_bearings_about_the_back_are_one_sector() -> None:
    random = np.random.default_rng(3)
    sightings = Sightings(field_of(np.array([[-2.0, 0.0], [2.0, 0.0]])), 0.4)
    behind = se2.wrap(np.pi + random.uniform(-0.5, 0.5, 300))
    sightings.see(np.column_stack([random.uniform(1.0, 4.0, 300), behind]))
    assert sightings.coverage is not None
    log_missed = sightings.coverage.log_missed(np.zeros((1, 3)), None, NOTHING)[0]
    assert log_missed[0] < -0.4
    assert log_missed[1] == 0.0


def test_wrong_scans_are_charged_what_a_robot_anywhere_would_miss() -> None:
    field, scan = field_of(), scan_of(POSE, POSITIONS[[0]])
    one, plain = mixture(scan, field), scan_mixture(scan, field, DETECTION, np.ones((5, 2)))
    assert one.misses is not None
    assert plain is not None
    assert np.log(1 - DETECTION.landmark) < one.misses.log_anywhere < -0.05
    np.testing.assert_allclose(one.log_outlier - plain.log_outlier, one.misses.log_anywhere)
    far = np.array([60.0, 0.0, 0.0])
    np.testing.assert_allclose(one.log_likelihood(far), one.log_outlier)


def test_the_builder_says_nothing_before_it_knows_what_is_covered_and_little_of_the_same_again() -> None:
    field = field_of()
    builder = MixtureBuilder(field, detection=DETECTION, correlation=ErrorCorrelation(hidden_s=0.5))
    random = np.random.default_rng(6)
    powers = []
    for k in range(30):
        pose = np.append(random.uniform(-1, 1, 2), random.uniform(-3, 3))
        built = builder.build(scan_of(pose, POSITIONS[:4], stamp_ns=k * 100_000_000))
        assert isinstance(built, ScanMixture)
        powers.append(0.0 if built.misses is None else built.misses.power)
    assert not any(powers[:13])  # fifty landmarks are enough
    np.testing.assert_allclose(powers[13:], np.tanh(0.1 / 0.5 / 2))
    later = builder.build(scan_of(POSE, POSITIONS[:1], stamp_ns=60_000_000_000))
    assert isinstance(later, ScanMixture)
    assert later.misses is not None
    np.testing.assert_allclose(later.misses.power, 1.0)


def test_a_sensor_that_always_turns_is_not_known_to_cover_anything() -> None:
    builder = MixtureBuilder(field_of(), detection=DETECTION)
    for k in range(60):
        built = builder.build(scan_of(POSE, POSITIONS, stamp_ns=k, mount=np.array([0.0, 0.0, 0.1 * k])))
        assert isinstance(built, ScanMixture)
        assert built.misses is None


# -- what is wrong looks as all does that the sensor sees --------------------------------------------------------------


def sector_of(count: int = 500) -> Sector:
    random = np.random.default_rng(0)
    return Sector.of(np.column_stack([random.uniform(0.5, 5.0, count), random.uniform(-1.0, 1.0, count)]))


@pytest.mark.parametrize("count", [1, 3, 10, 40])
def test_after_few_sights_the_next_is_outside_at_most_as_often_as_is_said(count: int) -> None:
    random = np.random.default_rng(1)
    outside = []
    for _ in range(400):
        seen = np.column_stack([random.uniform(0.5, 5.0, count + 1), random.uniform(-1.0, 1.0, count + 1)])
        sector = Sector.of(seen[:-1])
        outside.append(sector.log_density(seen[-1:], -50.0)[0] < -40.0)
    # 0.025 is a standard deviation of a share of 400; who is out on two sides counts once
    assert 0.5 * sector.beyond - 0.08 < np.mean(outside) < sector.beyond + 0.08


def test_what_is_wrong_has_a_density_and_is_looked_for_where_the_sensor_sees_things() -> None:
    sector = sector_of()
    range_m, bearing = np.meshgrid(np.arange(0.005, 8.0, 0.01), np.arange(-np.pi + 0.005, np.pi, 0.01))
    grid = np.column_stack([range_m.ravel(), bearing.ravel()])
    density = np.exp(sector.log_density(grid, float(-np.log(2 * np.pi * 8.0))))
    assert density.sum() * 0.01**2 == pytest.approx(1.0, abs=0.02)  # the sector's borders cut cells of the grid
    inside, beside, beyond = sector.log_density(np.array([[2.0, 0.5], [2.0, 1.5], [6.0, 0.5]]), -4.0)
    assert beside == beyond < inside - 3.0
    # all of a sector of 2 rad up to 5 m, but for its outermost hundredths
    assert inside == pytest.approx(np.log(0.97 / 10.0 + 0.03 * np.exp(-4.0)), abs=0.1)


def test_a_scan_is_as_likely_clutter_as_its_sensor_shows_things_there() -> None:
    field, scan = field_of(), scan_of(POSE, POSITIONS[:2])
    sector = sector_of()
    out = scan_mixture(scan, field, DETECTION, np.ones((5, 2)), sector=sector)
    assert out is not None
    x_min, y_min, x_max, y_max = field.bounds
    anywhere = float(-np.log(2 * np.pi * np.hypot(x_max - x_min, y_max - y_min)))
    of_all = sector.log_density(scan.range_bearing, anywhere).sum()
    all_clutter = (1 - DETECTION.nothing_right) * DETECTION.clutter**2
    assert out.log_outlier == pytest.approx(of_all + np.log(DETECTION.nothing_right + all_clutter))


def test_where_a_quarter_of_the_scans_are_wrong_so_may_be_the_next() -> None:
    """And where none is, still as many as was thought before."""
    field = field_of()
    nowhere = np.array([[4.0, 2.9]])
    right = []
    for every in (4, 10**9):
        builder = MixtureBuilder(field, detection=DETECTION, correlation=ErrorCorrelation(0.0, 0.0, 0.0, 0.0, 0.0))
        for k in range(200):
            scan = scan_of(POSE, nowhere if k % every == 3 else POSITIONS[:2], k * 10**9)
            seen = builder.build(scan)
            assert seen is not None
            builder.remember(scan, seen, POSE)
        last = builder.build(scan_of(POSE, POSITIONS[:2], 200 * 10**9))
        assert isinstance(last, ScanMixture)
        right.append(float(np.exp(last.log_right - last.model.log_clutter.sum())))
    wrong = (0.1 * 20 + 50) / (20 + 200)
    np.testing.assert_allclose(right, [1.0 - wrong, 0.9], atol=1e-9)
