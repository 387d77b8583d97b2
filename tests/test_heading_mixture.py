"""Compass readings as mixtures: against integrals on a grid, and what lasting disturbances may do."""

import math

import numpy as np
import pytest

from fieldloc import pose as se2
from fieldloc.factors import HeadingFactor
from fieldloc.field import load_field
from fieldloc.heading_mixture import HeadingMixture, heading_mixture
from fieldloc.measurements import Compass
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation
from fieldloc.resolution import Belief, sure

DEGREE = math.radians(1.0)
SIGMA = 15 * DEGREE
P3 = np.array([[0.04, 0.01, 0.02], [0.01, 0.02, -0.003], [0.02, -0.003, 0.05]])
GRID = np.linspace(-np.pi, np.pi, 72_001)
SECOND = 1_000_000_000


def reading(off_rad: float = 0.0, wider: float = 1.0, sigma_rad: float = SIGMA) -> HeadingMixture:
    return HeadingMixture(5, off_rad, sigma_rad, wider, area_m2=54.0)


def headings(values: FloatArray) -> FloatArray:
    return np.stack([np.full_like(values, 0.3), np.full_like(values, -0.1), values], axis=-1)


def log_density(off_rad: FloatArray, sigma_rad: float = SIGMA) -> FloatArray:
    """The textbook: nine in ten normal, one in ten anything."""
    normal = np.exp(-0.5 * (off_rad / sigma_rad) ** 2) / (math.sqrt(math.tau) * sigma_rad)
    return np.asarray(np.log(0.9 * normal + 0.1 / math.tau))


def test_a_reading_that_is_all_news_has_the_density_of_noise_and_disturbances() -> None:
    mixture = reading(0.4)
    np.testing.assert_allclose(mixture.log_likelihood(headings(GRID)), log_density(se2.wrap(GRID - 0.4)), atol=1e-12)
    # over all headings it is a density of the reading too, but for what of the normal one is beyond a half turn
    total = np.exp(mixture.log_likelihood(headings(GRID))).sum() * (GRID[1] - GRID[0])
    assert mixture.log_integral == pytest.approx(math.log(54.0 * total), abs=1e-4)


def test_who_may_be_anywhere_is_told_by_forty_repeated_readings_what_one_tells() -> None:
    per_pose = reading(wider=40.0).log_integral - math.log(54.0 * math.tau)
    assert 40.0 * per_pose == pytest.approx(math.log(1.0 / math.tau))


@pytest.mark.parametrize("wider", [2.0, 10.0, 40.0, 1000.0])
def test_of_readings_that_repeat_each_other_so_many_know_as_much_as_one(wider: float) -> None:
    together = wider * reading(wider=wider).log_likelihood(headings(GRID))
    alone = log_density(GRID)
    # as sure in the middle, in what it says of the two sides, and of headings nearby
    assert together.max() == pytest.approx(alone.max(), abs=1e-9)
    assert together.max() - together.min() == pytest.approx(
        alone.max() - alone.min(), abs=1e-5
    )  # the bump ends not quite
    middle = np.abs(GRID) < 3 * DEGREE
    np.testing.assert_allclose(together[middle], alone[middle], atol=0.001)
    # elsewhere a bump of normal shape for its logarithm, no more than a sigma's worth away
    assert np.abs(together - alone).max() < 0.25 * (alone.max() - alone.min())


@pytest.mark.parametrize("wider", [1.0, 5.0, 40.0])
@pytest.mark.parametrize("off", [0.0, 0.3, -0.7, 1.5, 3.0])
def test_the_evidence_is_the_integral_over_where_the_robot_may_be(off: float, wider: float) -> None:
    mixture, pose = reading(off, wider), np.array([0.3, -0.1, 0.0])
    d = np.linspace(-2.5, 2.5, 20_001)
    prior = np.exp(-0.5 * d**2 / P3[2, 2]) / math.sqrt(math.tau * P3[2, 2]) * (d[1] - d[0])
    weights = prior * np.exp(mixture.log_likelihood(headings(d)))
    near = mixture.expand(pose[None], P3[None])
    np.testing.assert_array_equal(near.parent, [0])
    # the grid wraps where the closed form takes the nearest turn alone
    assert near.evidence[0] == pytest.approx(math.log(weights.sum()), abs=1e-4)
    mean = float(weights @ d / weights.sum())
    variance = float(weights @ d**2 / weights.sum()) - mean**2
    assert near.step[0, 2] == pytest.approx(mean, abs=1e-3)
    assert near.updated[0, 2, 2] == pytest.approx(min(variance, P3[2, 2]), abs=1e-3)
    # position moves along with the heading as far as it hangs together with it
    assert near.step[0, 0] == pytest.approx(near.step[0, 2] * P3[0, 2] / P3[2, 2])


def test_where_the_heading_is_known_the_quadratic_is_that_of_the_density() -> None:
    mixture, h = reading(0.2), 1e-4
    known = np.zeros((3, 3))
    near = mixture.expand(headings(np.array([0.0])), known[None])
    at = mixture.log_likelihood(headings(np.array([-h, 0.0, h])))
    assert near.constant[0] == pytest.approx(at[1])
    assert near.gradient[0, 2] == pytest.approx((at[2] - at[0]) / (2 * h), rel=1e-5)
    assert near.information[0, 2, 2] == pytest.approx(-(at[2] - 2 * at[1] + at[0]) / h**2, rel=1e-4)
    assert np.count_nonzero(near.information) == np.count_nonzero(near.gradient) == 1


def test_every_pose_has_one_solution_and_it_is_a_compass() -> None:
    mixture = reading(0.2, wider=40.0)
    near = mixture.expand(headings(np.linspace(-3.0, 3.0, 7)), np.broadcast_to(P3, (7, 3, 3)))
    np.testing.assert_array_equal(near.parent, np.arange(7))
    np.testing.assert_array_equal(near.ids, np.zeros(7))
    assert np.linalg.eigvalsh(near.updated).min() > 0.0
    assert (near.updated[:, 2, 2] <= P3[2, 2] + 1e-12).all()
    assert len(mixture.solutions().poses) == 0
    assert (mixture.symmetric, mixture.by_compass) == (False, True)
    (factor,) = mixture.chosen(0)
    assert isinstance(factor, HeadingFactor)
    assert (factor.by_compass, factor.wider, factor.stamp_ns, factor.heading_rad) == (True, 40.0, 5, 0.2)
    assert factor.covariance[0, 0] == pytest.approx(40.0 * SIGMA**2)
    with pytest.raises(IndexError):
        mixture.chosen(1)


def test_an_estimator_of_one_place_gets_every_reading() -> None:
    assert len(sure(reading(3.0), Belief(np.zeros(3), P3))) == 1
    assert sure(reading(3.0), None) == ()


@pytest.mark.parametrize("off_deg", [0.0, 15.0, 40.0, 60.0, 75.0])
def test_a_disturbance_short_of_a_right_angle_never_speaks_for_the_other_side(off_deg: float) -> None:
    for wider in (1.0, 40.0):
        own, other = reading(off_deg * DEGREE, wider).log_likelihood(headings(np.array([0.0, np.pi])))
        assert own >= other - 1e-6


def test_ten_seconds_of_nonsense_say_less_than_four_readings() -> None:
    builder, pose = MixtureBuilder(load_field("kidsize"), correlation=ErrorCorrelation(compass_s=2.0)), np.zeros(3)
    said = 0.0
    for k in range(100):
        reading = Compass(k * SECOND // 10, np.pi, SIGMA)
        mixture = builder.build(reading)
        assert mixture is not None
        own, other = mixture.log_likelihood(headings(np.array([0.0, np.pi])))
        said += float(other - own)
        builder.remember(reading, mixture, pose)
    one = float(np.ptp(log_density(np.array([0.0, np.pi]))))
    # the first, and ten seconds of errors that are alike over two: 100 / ((1 + rho) / (1 - rho)) at 0.1 s
    assert said == pytest.approx(one * (1.0 + 99 / 40.0), rel=0.01)


def test_a_reading_that_nobody_could_use_is_not_old_news() -> None:
    builder = MixtureBuilder(load_field("kidsize"))
    for pose in (None, None, np.zeros(3)):
        reading = Compass(0, 0.0, SIGMA)
        mixture = builder.build(reading)
        assert isinstance(mixture, HeadingMixture)
        assert mixture.wider == 1.0
        builder.remember(reading, mixture, pose)
    again = builder.build(Compass(SECOND, 0.0, SIGMA))
    assert isinstance(again, HeadingMixture)
    assert again.wider > 2.0


def test_a_constant_bias_bends_a_heading_that_is_seen_otherwise_by_less_than_a_degree() -> None:
    """60 degrees for ten seconds at 10 Hz, one image a second that knows the heading to two degrees."""
    heading, variance = 0.0, (2 * DEGREE) ** 2
    worst = 0.0
    for k in range(100):
        variance += (0.5 * DEGREE) ** 2
        cov = np.diag([0.01, 0.01, variance])
        near = reading(60 * DEGREE, 40.0).expand(np.array([[0.0, 0.0, heading]]), cov[None])
        heading, variance = heading + float(near.step[0, 2]), float(near.updated[0, 2, 2])
        if k % 10 == 9:
            gain = variance / (variance + (2 * DEGREE) ** 2)
            heading, variance = heading - gain * heading, variance * (1.0 - gain)
        worst = max(worst, abs(heading))
    assert worst < 1.0 * DEGREE


@pytest.mark.parametrize(("sigma_rad", "wider"), [(0.0, 1.0), (-1.0, 1.0), (np.nan, 1.0), (0.1, 0.5), (0.1, np.inf)])
def test_a_compass_without_noise_is_refused(sigma_rad: float, wider: float) -> None:
    with pytest.raises(ValueError, match="a compass needs a sigma above 0"):
        heading_mixture(Compass(0, 0.0, sigma_rad), wider)
