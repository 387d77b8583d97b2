"""Particles over several places at once: their weights, the side of the field, kidnappings, how many there are."""

import numpy as np
import pytest
from walks import ns

from estimators.base import Ambiguity, Ambiguous, MixtureEstimator
from estimators.config import Config, MotionNoise, Particles
from estimators.particles import ParticleFilter
from estimators.particles.cloud import Cloud, moments, regroup
from estimators.particles.resampling import by_cluster, kld_size, shares
from estimators.particles.sides import Copies
from fieldloc import pose as se2
from fieldloc.field import load_field
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray
from fieldloc.regions import anywhere, region
from fieldloc.solution_mixture import SolutionMixture
from fieldloc.stacks import FactorStack, HeadingStack, LandmarkStack, PoseStack

SHARP = np.diag([0.05, 0.05, 0.03]) ** 2
KIDSIZE = load_field("kidsize")
TWIN = np.array([0.0, 0.0, np.pi])
HERE, THERE = np.array([-2.0, 1.0, 0.5]), np.array([1.0, -2.0, 2.5])


def mixture(
    stamp_s: float, stack: FactorStack, weights: FloatArray, symmetric: bool = False, outlier: float = 1e-6
) -> SolutionMixture:
    return SolutionMixture(ns(stamp_s), ((stack, np.log(weights)),), float(np.log(outlier)), symmetric, 50.0)


def whole(
    stamp_s: float, *poses: FloatArray, weights: FloatArray | None = None, symmetric: bool = False
) -> SolutionMixture:
    weights = np.full(len(poses), 1.0 / len(poses)) if weights is None else weights
    return mixture(stamp_s, PoseStack(np.array(poses), np.tile(SHARP, (len(poses), 1, 1))), weights, symmetric)


def said(cloud: ParticleFilter) -> Ambiguity:
    out = cloud.ambiguity()
    assert out is not None
    assert sum(one.weight for one in out.hypotheses) + out.lost == pytest.approx(1.0)
    return out


def begun(*poses: FloatArray, weights: FloatArray | None = None, seed: int = 1, count: int = 500) -> ParticleFilter:
    """Somewhere on a map without symmetries, after a first observation."""
    cloud = ParticleFilter(Config(particles=Particles(count, seed=seed)))
    cloud.start_in(region("anywhere", load_field("kidsize-2014")), 0)
    cloud._elsewhere.copies = Copies(np.zeros((0, 3)))
    cloud.observe(whole(0.0, *poses, weights=weights))
    return cloud


def test_it_is_what_a_run_asks_for() -> None:
    cloud = ParticleFilter(Config())
    assert isinstance(cloud, MixtureEstimator)
    assert isinstance(cloud, Ambiguous)
    assert cloud.ambiguity() is None


@pytest.mark.parametrize("bins", [2, 10, 100, 1000])
def test_as_many_particles_as_the_chi_square_asks_for(bins: int) -> None:
    # Fox's bound is the Wilson-Hilferty approximation of chi-square's quantile over twice the error
    from scipy.stats import chi2, norm

    quantile = float(norm.ppf(0.99))
    assert kld_size(bins, 0.05, quantile) == pytest.approx(chi2.ppf(0.99, bins - 1) / 0.1, rel=0.03, abs=1.0)
    assert kld_size(1, 0.05, quantile) == 1


def test_a_wide_cloud_has_more_particles_than_a_narrow_one() -> None:
    sizes = []
    for sigma in (0.02, 0.3):
        cloud = ParticleFilter(Config())
        spread = np.diag([sigma, sigma, sigma]) ** 2
        for k in range(3):
            stack = PoseStack(HERE[None], spread[None])
            if k == 0:
                cloud.start_in(anywhere(KIDSIZE), 0)
            cloud.observe(mixture(0.0, stack, np.ones(1)))
        assert cloud._cloud is not None
        sizes.append(len(cloud._cloud))
    assert sizes[0] == Particles().count
    assert sizes[1] > 2 * sizes[0]


def test_resampling_keeps_the_mass_of_every_cluster() -> None:
    random = np.random.default_rng(0)
    labels = random.integers(0, 3, 600).astype(np.intp)
    weights = random.dirichlet(np.full(600, 0.1))
    masses = np.bincount(labels, weights).astype(np.float64)
    rows, after = by_cluster(weights, labels, masses, shares(masses, 400), random)
    np.testing.assert_allclose(np.bincount(labels[rows], after), masses, atol=1e-12)
    # a cluster of next to no weight has some particles all the same, one of none has none
    assert shares(np.array([0.999, 0.001, 0.0]), 400).tolist() == [400, 30, 0]


def test_two_places_keep_their_odds_as_long_as_nothing_tells_them_apart() -> None:
    cloud = begun(HERE, THERE, weights=np.array([0.7, 0.3]))
    for k in range(1, 100):
        cloud.predict(Odometry(ns(0.1 * k), np.array([0.3, 0.0, 0.2])))
        cloud.observe(mixture(0.1 * k, HeadingStack(np.zeros(1), np.array([[[1e8]]])), np.ones(1)))
    first, second = said(cloud).hypotheses
    assert first.weight == pytest.approx(0.7, abs=0.03)
    assert second.weight == pytest.approx(0.3, abs=0.03)


def test_weights_are_what_bayes_makes_of_them() -> None:
    # the truth is HERE: each sight says so by the ratio of its weights
    for seed in range(3):
        cloud = begun(HERE, THERE, seed=seed)
        for _ in range(3):
            cloud.observe(whole(0.0, HERE, THERE, weights=np.array([0.6, 0.4])))
        odds = (0.6 / 0.4) ** 3
        # four sights of 500 particles: evidences to about 5 % each
        assert said(cloud).hypotheses[0].weight == pytest.approx(odds / (1.0 + odds), abs=0.05)


def test_a_twin_has_half_of_the_weight_and_keeps_it() -> None:
    cloud = ParticleFilter(Config())
    cloud.start_in(anywhere(KIDSIZE), 0)
    pose = HERE
    for k in range(60):
        cloud.observe(whole(0.1 * k, pose, se2.compose(TWIN, pose), symmetric=True))
        assert said(cloud).mirrored == pytest.approx(0.5, abs=1e-3)
        cloud.predict(Odometry(ns(0.1 * k), np.array([0.5, 0.0, 0.3])))
        pose = se2.compose(pose, se2.exp(np.array([0.05, 0.0, 0.03])))
    assert len(said(cloud).hypotheses) == 2
    # which side, tells the first reading that is about the side, for good
    cloud.observe(mixture(6.0, HeadingStack(pose[2:], np.array([[[0.3**2]]])), np.ones(1), outlier=1e-3))
    cloud.observe(whole(6.0, pose, se2.compose(TWIN, pose), symmetric=True))
    assert said(cloud).mirrored < 0.02
    estimate = cloud.estimate()
    assert estimate is not None
    assert np.hypot(*(estimate.pose - pose)[:2]) < 0.1


def test_the_half_that_it_starts_in_tells_the_side() -> None:
    cloud = ParticleFilter(Config())
    cloud.start_in(region("own-half", KIDSIZE), 0)
    cloud.observe(whole(0.0, se2.compose(TWIN, HERE), HERE, symmetric=True))
    estimate = cloud.estimate()
    assert estimate is not None
    np.testing.assert_allclose(estimate.pose, HERE, atol=0.02)
    assert said(cloud).mirrored < 1e-6


@pytest.mark.parametrize("seed", range(5))
def test_a_robot_that_was_carried_is_found_within_three_sights(seed: int) -> None:
    cloud = begun(HERE, seed=seed)
    for k in range(1, 20):
        cloud.observe(whole(0.1 * k, HERE))
    random = np.random.default_rng(seed)
    for k in range(20, 23):
        seen = se2.retract(THERE, np.sqrt(np.diag(SHARP)) * random.standard_normal(3))
        cloud.observe(whole(0.1 * k, seen))
    estimate = cloud.estimate()
    assert estimate is not None
    assert np.hypot(*(estimate.pose - THERE)[:2]) < 0.15
    assert any(event.kind in ("recovery", "decision", "split") for event in cloud.events[1:])


def test_one_wrong_sight_carries_nobody_away() -> None:
    cloud = begun(HERE)
    for k in range(1, 20):
        cloud.observe(whole(0.1 * k, THERE if k == 10 else HERE))
    estimate = cloud.estimate()
    assert estimate is not None
    assert np.hypot(*(estimate.pose - HERE)[:2]) < 0.05


def test_a_sharp_sight_of_a_vague_cloud_is_taken_in_exactly() -> None:
    # Kalman's answer; the cloud is fifty times wider than the sight
    still = MotionNoise(idle_m_per_sqrt_s=0.0, idle_rad_per_sqrt_s=0.0)
    vague, sharp = np.diag([0.5, 0.5, 0.2]) ** 2, np.diag([0.01, 0.01, 0.005]) ** 2
    for seed in range(5):
        cloud = ParticleFilter(Config(still, particles=Particles(500, seed=seed)))
        cloud.start_in(anywhere(KIDSIZE), 0)
        cloud.observe(mixture(0.0, PoseStack(HERE[None], vague[None]), np.ones(1)))
        seen = se2.retract(HERE, np.array([0.4, -0.3, 0.1]))
        cloud.observe(mixture(0.0, PoseStack(seen[None], sharp[None]), np.ones(1)))
        estimate = cloud.estimate()
        assert estimate is not None
        # 500 particles, nearly all alive: a mean to 0.05 sigma, five of these
        assert np.abs(se2.local(seen, estimate.pose) / np.sqrt(np.diag(sharp))).max() < 0.25
        spread = se2.rotate_covariance(estimate.covariance, -estimate.pose[2])
        np.testing.assert_allclose(np.diag(spread) / np.diag(sharp), 1.0, atol=0.35)


def test_a_cloud_splits_on_what_it_cannot_tell_apart() -> None:
    # two posts in reach of a vague cloud: exact odds and places from the grid-free algebra of the mixture itself
    cloud = begun(HERE)
    cloud._cloud = None
    cloud.observe(mixture(0.0, PoseStack(HERE[None], np.diag([1.0, 1.0, 0.02])[None] ** 2), np.ones(1)))
    marks = np.array([[1.0, 1.0], [1.0, 3.0]])
    seen = se2.apply(se2.inverse(HERE), np.array([1.0, 2.0]))
    stack = LandmarkStack(marks, np.tile(seen, (2, 1)), np.tile(np.diag([0.05, 0.05]) ** 2, (2, 1, 1)))
    cloud.observe(mixture(0.0, stack, np.array([0.5, 0.5])))
    found = said(cloud).hypotheses
    assert len(found) == 2
    np.testing.assert_allclose(sorted(one.pose[1] for one in found), [HERE[1] - 1.0, HERE[1] + 1.0], atol=0.1)
    assert found[0].weight == pytest.approx(0.5, abs=0.1)


def test_tails_belong_to_their_cluster_and_far_places_do_not() -> None:
    random = np.random.default_rng(0)
    poses = np.concatenate([random.normal(0.0, [0.3, 0.3, 0.1], (300, 3)), random.normal(4.0, 0.05, (20, 3))])
    count = len(poses)
    cloud = Cloud(
        poses, np.zeros(count), np.full(count, 1 / count), np.ones((count, 1)), np.zeros(count, dtype=np.intp)
    )
    labels, _, _ = regroup(cloud)
    found = moments(cloud, labels, int(labels.max()) + 1)
    np.testing.assert_allclose(sorted(found.masses), [20 / 320, 300 / 320], atol=0.01)


def test_the_same_seed_gives_the_same_answer() -> None:
    ends = []
    for seed in (1, 1, 2):
        cloud = begun(HERE, THERE, seed=seed)
        cloud.predict(Odometry(ns(0.0), np.array([0.3, 0.0, 0.2])))
        cloud.observe(whole(0.5, HERE))
        estimate = cloud.estimate()
        assert estimate is not None
        ends.append(estimate.pose)
    np.testing.assert_array_equal(ends[0], ends[1])
    assert not np.array_equal(ends[0], ends[2])
