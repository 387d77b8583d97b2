import numpy as np
from walks import GENTLE, feed, ns, velocities, walk

from estimators.base import Estimate
from estimators.config import Config, MotionNoise
from estimators.dead_reckoning import DeadReckoning
from fieldloc import pose as se2
from fieldloc.factors import LandmarkFactor, PoseFactor
from fieldloc.measurements import Odometry

P3 = np.array([[0.04, 0.01, 0.002], [0.01, 0.02, -0.003], [0.002, -0.003, 0.01]])


def test_the_covariance_is_the_spread_of_many_walks_with_sharp_turns() -> None:
    random = np.random.default_rng(0)
    walks = 4000
    # noise so small that first order holds over the whole way
    noise = MotionNoise(0.01, 0.006, 0.005, 0.005, 0.0005, 0.0005)
    start_sigma = np.array([0.02, 0.01, 0.01])
    first = np.array([1.0, 2.0, 3.0])
    commands = velocities(60)
    truth = walk(se2.retract(first, start_sigma * random.standard_normal((walks, 3))), commands, 0.1, random, noise)
    estimator = DeadReckoning(Config(noise))
    estimator.start(Estimate(0, first, se2.rotate_covariance(np.diag(start_sigma**2), first[2])))
    feed(estimator, [Odometry(ns(0.1 * k), command) for k, command in enumerate(commands)])
    estimator.advance(ns(6.0))
    estimate = estimator.estimate()
    assert estimate is not None
    errors = truth[-1] - estimate.pose
    errors[:, 2] = se2.wrap(errors[:, 2])
    whitener = np.linalg.inv(np.linalg.cholesky(estimate.covariance))
    # standard errors: a mean 1/sqrt(4000) = 0.016, a variance sqrt(2/4000) = 0.022; five of these
    np.testing.assert_allclose(whitener @ errors.mean(axis=0), 0.0, atol=0.08)
    np.testing.assert_allclose(whitener @ np.cov(errors.T) @ whitener.T, np.eye(3), atol=0.11)


def test_the_innovations_of_many_walks_are_chi_square() -> None:
    # what a comparison shows of odometry alone: each factor's NIS, though none is taken in
    random = np.random.default_rng(1)
    walks, nis = 200, []
    commands = velocities(20)
    noise = np.diag([0.03, 0.03])
    landmark = np.array([3.0, 1.0])
    truth = walk(
        se2.retract(np.zeros(3), random.multivariate_normal(np.zeros(3), 0.01 * P3, walks)), commands, 0.1, random
    )
    for end in truth[-1]:
        estimator = DeadReckoning(Config(motion=GENTLE))
        estimator.update(PoseFactor(0, np.zeros(3), 0.01 * P3))
        feed(estimator, [Odometry(ns(0.1 * k), command) for k, command in enumerate(commands)])
        seen = se2.apply(se2.inverse(end), landmark) + random.multivariate_normal(np.zeros(2), noise**2)
        innovation = estimator.update(LandmarkFactor(ns(2.0), landmark, seen, noise**2))
        assert innovation is not None
        nis.append(innovation.nis)
    # mean 2, standard error sqrt(4 / 200) = 0.14; four of these
    assert abs(np.mean(nis) - 2.0) < 0.57


def test_the_first_pose_counts_at_its_own_stamp() -> None:
    estimator = DeadReckoning(Config())
    estimator.predict(Odometry(0, np.array([1.0, 0.0, 0.0])))
    estimator.update(PoseFactor(ns(0.5), np.zeros(3), P3))
    estimator.advance(ns(1.5))
    estimate = estimator.estimate()
    assert estimate is not None
    assert estimate.stamp_ns == ns(1.5)
    np.testing.assert_allclose(estimate.pose, [1.0, 0.0, 0.0], atol=1e-12)
