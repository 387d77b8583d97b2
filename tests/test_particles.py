from dataclasses import replace

import filterpy.monte_carlo.resampling as filterpy_resampling
import numpy as np
import pytest
from scipy.stats import chi2
from walks import PLAIN, TAKEN_AT_ITS_WORD, feed, nees, ns, right_factors, scan, velocities, walk

from estimators.base import Estimate
from estimators.config import Config, MotionNoise, Particles, Robust
from estimators.particles import ParticleFilter
from estimators.particles.resampling import systematic
from fieldloc import pose as se2
from fieldloc.factors import HeadingFactor, LandmarkFactor, PoseFactor
from fieldloc.measurements import Odometry

SMALL = np.diag([0.1, 0.1, 0.05]) ** 2


def estimate_of(cloud: ParticleFilter) -> Estimate:
    estimate = cloud.estimate()
    assert estimate is not None
    return estimate


def test_without_turns_it_agrees_with_the_exact_answer_up_to_sampling() -> None:
    heading, count, runs = 0.7, 1000, 40
    motion = MotionNoise(0.2, 0.1, 0.0, 0.0, 0.001, 1e-6, log_scale_sigma=0.0)
    turn = se2.rotation(heading)
    start = np.diag([0.3**2, 0.1**2, 1e-12])
    fix_covariance = np.diag([0.02, 0.005])
    random = np.random.default_rng(0)
    off, spread = [], []
    for seed in range(runs):
        config = replace(PLAIN, motion=motion, robust=Robust(nis_per_dof=1e9))
        config = replace(config, particles=Particles(count, outlier_share=0.0, seed=seed))
        cloud = ParticleFilter(config)
        cloud.start(Estimate(0, np.array([1.0, 2.0, heading]), start))
        x, p = np.array([1.0, 2.0]), start[:2, :2]
        truth = random.multivariate_normal(x, p)
        for k in range(12):
            command = random.uniform(-1, 1, 2)
            along, across = 0.2**2 * np.abs(command) + 0.1**2 * np.abs(command[::-1]) + 0.001**2
            q = turn @ np.diag([along, across]) @ turn.T
            truth = truth + turn @ command + random.multivariate_normal(np.zeros(2), q)
            z = truth + random.multivariate_normal(np.zeros(2), turn @ fix_covariance @ turn.T)
            x, p = x + turn @ command, p + q
            gain = p @ np.linalg.inv(p + turn @ fix_covariance @ turn.T)
            x, p = x + gain @ (z - x), (np.eye(2) - gain) @ p
            cloud.predict(Odometry(ns(k), np.array([*command, 0.0])))
            fix = np.zeros((3, 3))
            fix[:2, :2], fix[2, 2] = fix_covariance, 0.1
            cloud.update(PoseFactor(ns(k + 1), np.array([*z, heading]), fix))
        whitener = np.linalg.inv(np.linalg.cholesky(p))
        off.append(whitener @ (estimate_of(cloud).pose[:2] - x))
        spread.append(whitener @ estimate_of(cloud).covariance[:2, :2] @ whitener.T)
    # each factor leaves 50 to 500 particles alive: a mean is off by 0.14 to 0.05 sigma, a variance by 20 % to 6 %
    rms = np.sqrt(np.mean(np.square(off)))
    assert rms < 0.25
    # over 40 runs these get smaller by sqrt(40); four of these
    np.testing.assert_allclose(np.mean(off, axis=0), 0.0, atol=4 * rms / np.sqrt(runs))
    np.testing.assert_allclose(np.mean(spread, axis=0), np.eye(2), atol=4 * 0.15 / np.sqrt(runs))


def test_a_single_landmark_bends_the_cloud_around_it() -> None:
    # the exact posterior by numerical integration: what no Gaussian filter gets right
    noise = np.diag([0.1, 0.1]) ** 2
    landmark, seen = np.array([2.0, 0.0]), np.array([2.0, 0.0])
    vague = np.diag([1.0, 1.0, 0.4]) ** 2
    factor = LandmarkFactor(0, landmark, seen, noise)
    means, covariances = [], []
    for seed in range(10):
        cloud = ParticleFilter(Config(particles=Particles(4000, outlier_share=0.0, seed=seed)))
        cloud.update(PoseFactor(0, np.zeros(3), vague))
        cloud.update(factor)
        means.append(estimate_of(cloud).pose)
        covariances.append(estimate_of(cloud).covariance)
    axes = [np.linspace(-2, 2, 81), np.linspace(-2.5, 2.5, 81), np.linspace(-1.6, 1.6, 81)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    log_density = -0.5 * np.sum(factor.error(grid) ** 2, axis=-1) / 0.01
    log_density -= 0.5 * np.sum(se2.local(np.zeros(3), grid) ** 2 / np.diag(vague), axis=-1)
    density = np.exp(log_density)
    density /= density.sum()
    mean = density @ grid
    covariance = (grid - mean).T @ ((grid - mean) * density[:, None])
    sigma = np.sqrt(np.diag(covariance))
    # the factor comes in four parts, each leaves some 200 particles alive: 10 % each, over ten runs 6 %; two of these
    np.testing.assert_allclose(np.mean(means, axis=0) / sigma, mean / sigma, atol=0.12)
    scaled = np.mean(covariances, axis=0) / np.outer(sigma, sigma)
    np.testing.assert_allclose(scaled, covariance / np.outer(sigma, sigma), atol=0.12)


@pytest.mark.parametrize("sharpness", [3.0, 10.0, 100.0, 1000.0])
def test_however_sharp_a_factor_is_it_gets_its_share(sharpness: float) -> None:
    vague = np.diag([1.0, 1.0, 0.5]) ** 2
    sharp = vague / sharpness**2
    off, spread = [], []
    for seed in range(20):
        random = np.random.default_rng(seed)
        truth = random.multivariate_normal(np.zeros(3), 0.5 * vague)
        cloud = ParticleFilter(Config(particles=Particles(1000, seed=seed)))
        cloud.update(PoseFactor(0, np.zeros(3), vague))
        cloud.update(PoseFactor(0, truth, sharp))
        estimate = estimate_of(cloud)
        off.append(se2.local(truth, estimate.pose) / np.sqrt(np.diag(sharp)))
        spread.append(se2.rotate_covariance(estimate.covariance, -estimate.pose[2]))
    gain = sharpness**2 / (1.0 + sharpness**2)
    # a hundred particles alive: 0.1 sigma each, and the part of the prior that is left
    assert np.sqrt(np.mean(np.square(off))) < 0.35 + 1.5 / sharpness
    scale = np.sqrt(np.diag(sharp) * gain)
    np.testing.assert_allclose(np.mean(spread, axis=0) / np.outer(scale, scale), np.eye(3), atol=0.25)


def test_a_robot_that_stands_still_keeps_a_living_cloud() -> None:
    still = MotionNoise(idle_m_per_sqrt_s=0.0, idle_rad_per_sqrt_s=0.0)
    cloud = ParticleFilter(Config(still, particles=Particles(1000), calibration=TAKEN_AT_ITS_WORD))
    cloud.update(PoseFactor(0, np.zeros(3), SMALL))
    random = np.random.default_rng(0)
    for k in range(50):
        cloud.predict(Odometry(ns(0.1 * k), np.zeros(3)))
        seen = random.multivariate_normal(np.zeros(3), SMALL)
        cloud.update(PoseFactor(ns(0.1 * k), seen, SMALL))
    estimate = estimate_of(cloud)
    # 51 poses: the exact answer has a 51st of the variance; a fifth of it is what resampling may cost
    np.testing.assert_allclose(np.diag(estimate.covariance) / np.diag(SMALL) * 51, 1.0, atol=0.4)
    assert cloud._cloud is not None
    assert len(np.unique(cloud._cloud.poses[:, 0])) > 500


def test_a_heading_beside_the_half_turn_keeps_its_spread() -> None:
    cloud = ParticleFilter(Config())
    cloud.update(PoseFactor(0, np.array([0.0, 0.0, np.pi]), SMALL))
    cloud.update(HeadingFactor(0, -np.pi + 0.05, np.array([[0.05**2]])))
    estimate = estimate_of(cloud)
    assert abs(se2.wrap(estimate.pose[2] - np.pi - 0.025)) < 0.01
    assert estimate.covariance[2, 2] == pytest.approx(0.05**2 / 2, rel=0.2)


def test_it_leaves_the_global_random_numbers_alone_and_does_not_depend_on_them() -> None:
    ends, states = [], []
    for seed in (1, 2):
        np.random.seed(seed)  # noqa: NPY002
        cloud = ParticleFilter(Config())
        cloud.update(PoseFactor(0, np.zeros(3), SMALL))
        for _ in range(5):
            cloud.update(PoseFactor(0, np.array([0.1, 0.0, 0.0]), SMALL / 9))
        ends.append(estimate_of(cloud).pose)
        states.append(np.random.random())  # noqa: NPY002
    np.testing.assert_array_equal(*ends)
    np.random.seed(1)  # noqa: NPY002
    assert states[0] == np.random.random()  # noqa: NPY002


def test_the_seed_of_the_configuration_matters() -> None:
    ends = []
    for seed in (1, 2):
        cloud = ParticleFilter(Config(particles=Particles(seed=seed)))
        cloud.update(PoseFactor(0, np.zeros(3), SMALL))
        ends.append(estimate_of(cloud).pose)
    assert not np.array_equal(*ends)


def test_resampling_is_the_textbooks() -> None:
    random = np.random.default_rng(3)
    for _ in range(20):
        weights = random.dirichlet(np.full(200, 0.3))
        seed = int(random.integers(1 << 30))
        np.random.seed(seed)  # noqa: NPY002
        start = np.random.random()  # noqa: NPY002
        np.random.seed(seed)  # noqa: NPY002
        expected = filterpy_resampling.systematic_resample(weights)

        class Fixed:
            def random(self) -> float:
                return start  # noqa: B023

        np.testing.assert_array_equal(systematic(weights, 200, Fixed()), expected)  # type: ignore[arg-type]


@pytest.mark.parametrize("at_s", [pytest.param(10.0, marks=pytest.mark.slow), 5.5])
def test_the_errors_of_many_walks_are_as_large_as_the_filter_says(at_s: float) -> None:
    walks, steps = 80, round(10 * at_s)
    random = np.random.default_rng(7)
    start_sigma = np.array([0.2, 0.1, 0.1])
    first = np.array([0.5, -0.5, 1.0])
    truth = walk(se2.retract(first, start_sigma * random.standard_normal((walks, 3))), velocities(steps), 0.1, random)
    total = 0.0
    for i in range(walks):
        cloud = ParticleFilter(replace(PLAIN, particles=Particles(seed=i)))
        cloud.start(Estimate(0, first, se2.rotate_covariance(np.diag(start_sigma**2), first[2])))
        for k, command in enumerate(velocities(steps)):
            cloud.predict(Odometry(ns(0.1 * k), command))
            if k % 8 == 5:
                feed(cloud, right_factors(scan(ns(0.1 * k), truth[k, i], random), truth[k, i]))
        cloud.advance(ns(0.1 * steps))
        total += nees(estimate_of(cloud), truth[-1, i])
    # one time per walk, so the walks are independent: chi-square, 3 * 80 degrees of freedom, 99.9 % two-sided
    assert chi2.ppf(0.0005, 3 * walks) < total < chi2.ppf(0.9995, 3 * walks)
