from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2
from walks import FIELD, POSITIONS, ns, scan

from fieldloc import factor_builder
from fieldloc import pose as se2
from fieldloc.association import Belief
from fieldloc.factor_builder import FactorBuilder
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, PoseFactor
from fieldloc.field import FieldMap, Landmark
from fieldloc.fixes.landmarks import landmark_fix
from fieldloc.measurements import Compass, InitialPose, LandmarkScan
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation, inflation

POSE = np.array([0.5, -1.0, 2.5])
MOUNT = np.array([0.2, -0.1, 0.7])
SURE = Belief(POSE, np.diag([0.05, 0.05, 0.03]) ** 2)

poses = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-7, 7)).map(np.array)


def rows(whole: LandmarkScan, chosen: list[int], labels: list[str | None] | None = None) -> LandmarkScan:
    """A part of a scan, with other labels if given."""
    kept = tuple(whole.labels[i] for i in chosen) if labels is None else tuple(labels)
    return LandmarkScan(
        whole.stamp_ns, kept, whole.range_bearing[chosen], whole.covariance[chosen], whole.robot_from_sensor
    )


def everything(pose: FloatArray = POSE, noisy: bool = True, mount: FloatArray | None = None) -> LandmarkScan:
    """All six posts from a pose."""
    return scan(3, pose, np.random.default_rng(5), max_range_m=99.0, noisy=noisy, mount=mount)


def assert_same(one: Factor, other: Factor) -> None:
    assert type(one) is type(other)
    assert one.stamp_ns == other.stamp_ns
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-9)
    at = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(one.error(at), other.error(at), atol=1e-9)


@pytest.mark.parametrize("count", [2, 3, 6])
def test_two_or_more_known_landmarks_give_their_fix_as_one_factor(count: int) -> None:
    made = rows(everything(mount=MOUNT), list(range(count)))
    (factor,) = FactorBuilder(FIELD).build(made, None)
    (fix,) = landmark_fix(
        POSITIONS[:count], made.range_bearing, made.covariance, np.zeros((count, 2, 2)), robot_from_sensor=MOUNT
    )
    assert isinstance(factor, PoseFactor)
    assert_same(factor, PoseFactor.from_fix(3, fix))


@settings(deadline=None, max_examples=25)
@given(pose=poses, mounted=st.booleans())
def test_the_factors_are_zero_where_the_scan_was_made(pose: FloatArray, mounted: bool) -> None:
    whole = everything(pose, noisy=False, mount=MOUNT if mounted else np.zeros(3))
    for chosen in ([0], [0, 1], [1, 2, 4, 5]):
        for factor in FactorBuilder(FIELD).build(rows(whole, chosen), None):
            np.testing.assert_allclose(factor.error(pose), 0.0, atol=1e-6)


def test_one_landmark_gives_the_observation_itself() -> None:
    made = rows(everything(mount=MOUNT), [2])
    (factor,) = FactorBuilder(FIELD).build(made, None)
    assert isinstance(factor, LandmarkFactor)
    r, bearing = made.range_bearing[0]
    np.testing.assert_allclose(factor.landmark, POSITIONS[2])
    np.testing.assert_allclose(
        factor.seen, se2.apply(MOUNT, r * np.array([np.cos(bearing), np.sin(bearing)])), atol=1e-12
    )
    along = se2.rotation(bearing + MOUNT[2])
    variances = np.diag([0.05**2, (r * 0.03) ** 2])
    np.testing.assert_allclose(factor.covariance, along @ variances @ along.T, atol=1e-12)


def test_the_survey_of_a_single_landmark_counts_with_its_largest_variance() -> None:
    survey = np.array([[0.05, 0.02], [0.02, 0.02]])
    field = FieldMap("one", np.zeros((0, 2, 2)), np.zeros((0, 3)), (Landmark("0", POSITIONS[0], 0.1, survey),))
    made = rows(everything(), [0])
    (exact,) = FactorBuilder(FIELD).build(made, None)
    (surveyed,) = FactorBuilder(field).build(made, None)
    # eigenvalues of the survey: 0.035 +- 0.025
    np.testing.assert_allclose(surveyed.covariance, exact.covariance + 0.06 * np.eye(2), atol=1e-12)


@pytest.mark.parametrize("wrong", range(4))
def test_a_wrongly_labelled_landmark_among_others_is_left_out(wrong: int) -> None:
    whole = everything()
    labels: list[str | None] = list(whole.labels[:4])
    labels[wrong] = "5" if wrong % 2 else "4"
    (factor,) = FactorBuilder(FIELD).build(rows(whole, [0, 1, 2, 3], labels), None)
    right = [i for i in range(4) if i != wrong]
    (expected,) = FactorBuilder(FIELD).build(rows(whole, right), None)
    assert_same(factor, expected)


def test_two_landmarks_that_contradict_each_other_stay_single() -> None:
    factors = FactorBuilder(FIELD).build(rows(everything(), [0, 1], ["0", "2"]), None)
    assert [type(factor) for factor in factors] == [LandmarkFactor, LandmarkFactor]


def test_a_good_scan_fails_the_check_once_in_ten_thousand() -> None:
    limits = [chi2.isf(1e-4, 2 * n - 3) for n in range(2, 10)]
    np.testing.assert_allclose(factor_builder._CHI2_LIMITS, limits, atol=0.01)


def test_two_landmarks_that_leave_a_banana_stay_single() -> None:
    # half a metre apart at 3 m with 5 cm of noise each: the position swings with the heading, so the Gaussian is none
    near = FieldMap(
        "pair",
        np.zeros((0, 2, 2)),
        np.zeros((0, 3)),
        tuple(Landmark(str(i), np.array([3.0, y]), 0.02, np.zeros((2, 2))) for i, y in enumerate((-0.25, 0.25))),
    )
    seen = np.array([[3.01, -0.083], [3.01, 0.083]])
    made = LandmarkScan(3, ("0", "1"), seen, np.tile(np.diag([0.05, 0.03]) ** 2, (2, 1, 1)))
    (fix,) = landmark_fix(near.positions, seen, made.covariance)
    assert fix.nonlinearity > 0.5
    factors = FactorBuilder(near).build(made, None)
    assert [type(factor) for factor in factors] == [LandmarkFactor, LandmarkFactor]


def test_a_label_that_is_not_on_the_map_is_counted_and_left_out() -> None:
    builder = FactorBuilder(FIELD)
    assert builder.warnings() == ()
    whole = everything()
    (factor,) = builder.build(rows(whole, [0, 1, 2], ["0", "1", "tree"]), None)
    (expected,) = FactorBuilder(FIELD).build(rows(whole, [0, 1]), None)
    assert_same(factor, expected)
    assert builder.build(rows(whole, [2], ["lamp"]), None) == ()
    assert builder.build(rows(whole, [2], ["tree"]), None) == ()
    (warning,) = builder.warnings()
    assert warning == "3 observations left out: landmark lamp, tree is not on the map six posts"


def test_unlabelled_landmarks_get_their_labels_from_a_belief() -> None:
    whole = everything()
    (named,) = FactorBuilder(FIELD).build(rows(whole, [0, 1, 2]), None)
    (found,) = FactorBuilder(FIELD).build(rows(whole, [0, 1, 2], [None, None, None]), SURE)
    assert_same(found, named)
    (mixed,) = FactorBuilder(FIELD).build(rows(whole, [0, 1, 2], ["0", None, None]), SURE)
    assert_same(mixed, named)


def test_few_unlabelled_landmarks_say_nothing_without_a_belief() -> None:
    builder = FactorBuilder(FIELD)
    assert builder.build(rows(everything(), [0, 1], [None, None]), None) == ()
    assert builder.warnings() == ()


def test_an_empty_scan_gives_no_factors() -> None:
    nothing = LandmarkScan(3, (), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    for belief in (None, SURE):
        assert FactorBuilder(FIELD).build(nothing, belief) == ()


def test_a_compass_gives_its_heading() -> None:
    (factor,) = FactorBuilder(FIELD).build(Compass(4, -3.0, 0.2), None)
    assert_same(factor, HeadingFactor(4, -3.0, np.array([[0.04]])))


@settings(deadline=None, max_examples=25)
@given(pose=poses)
def test_an_initial_pose_keeps_its_covariance_in_field_axes(pose: FloatArray) -> None:
    covariance = np.array([[0.09, 0.01, 0.002], [0.01, 0.04, -0.003], [0.002, -0.003, 0.01]])
    (factor,) = FactorBuilder(FIELD).build(InitialPose(4, pose, covariance), None)
    assert isinstance(factor, PoseFactor)
    np.testing.assert_array_equal(factor.pose, pose)
    np.testing.assert_allclose(se2.rotate_covariance(factor.covariance, pose[2]), covariance, atol=1e-12)


def test_what_alike_errors_leave_of_the_news_is_as_much_as_their_mean_says() -> None:
    # errors that decay with exp(-t / 2 s), seen every 0.5 s: the mean of many is as uncertain as n / inflation of them
    rho, count = np.exp(-0.5 / 2.0), 4000
    random = np.random.default_rng(0)
    errors = random.standard_normal(2000)
    total = np.zeros(2000)
    for _ in range(count):
        total += errors
        errors = rho * errors + np.sqrt(1.0 - rho**2) * random.standard_normal(2000)
    wider = float(inflation(np.array(0.5), 2.0))
    # standard error of a sampled variance: sqrt(2 / 2000) = 3 %; four of these
    assert np.var(total / count) * count == pytest.approx(wider, rel=0.13)


def test_a_landmark_seen_again_a_moment_later_is_little_news() -> None:
    correlation = ErrorCorrelation(range_s=2.0, bearing_s=0.5)
    builder = FactorBuilder(FIELD, correlation=correlation)
    first = LandmarkScan(0, ("0",), np.array([[2.0, 0.0]]), np.diag([0.1, 0.02])[None] ** 2)
    again = replace(first, stamp_ns=ns(0.5))
    other = replace(first, labels=("1",), stamp_ns=ns(0.6))
    later = replace(first, stamp_ns=ns(60.0))
    # straight ahead: range along x, bearing across, 2 m away
    plain = np.array([0.1**2, (2.0 * 0.02) ** 2])
    wider = [float(inflation(np.array(0.5), tau)) for tau in (2.0, 0.5)]
    for scan_, expected in ((first, plain), (again, plain * wider), (other, plain), (later, plain)):
        (factor,) = builder.build(scan_, None)
        np.testing.assert_allclose(factor.covariance, np.diag(expected), rtol=1e-6, atol=1e-12)
    (at_once,) = builder.build(later, None)
    assert np.isfinite(at_once.covariance).all()
    assert at_once.covariance[0, 0] > 100 * plain[0]


def test_with_no_correlation_all_is_news() -> None:
    builder = FactorBuilder(FIELD, correlation=ErrorCorrelation(0.0, 0.0, 0.0))
    (first,) = builder.build(everything(), None)
    (again,) = builder.build(everything(), None)
    assert_same(first, again)
