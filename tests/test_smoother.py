from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2
from walks import KNOWN_NOISE, PLAIN, feed, nees, ns, right_factors, scan, velocities, walk

from estimators.base import Estimate
from estimators.config import Calibration, Config, Graph, MotionNoise, Robust
from estimators.ekf import Ekf
from estimators.motion import CALIBRATION, OdometryCalibration
from estimators.smoother import Smoother
from fieldloc import pose as se2
from fieldloc.covariance import check_covariance
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, PoseFactor
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

P3 = np.diag([0.1, 0.1, 0.05]) ** 2
GAUSSIAN = Graph(cauchy=1e6)  # a kernel so wide that it does nothing
START = np.array([0.5, -0.5, 1.0])


def driven(
    smoother: Smoother, truth: FloatArray, commands: FloatArray, random: np.random.Generator, every: int = 5
) -> None:
    """Noisy whole poses every so many odometry messages at 10 Hz."""
    for k, command in enumerate(commands):
        smoother.predict(Odometry(ns(0.1 * k), command))
        if k % every == 0:
            seen = se2.retract(truth[k], np.sqrt(np.diag(P3)) * random.standard_normal(3))
            smoother.update(PoseFactor(ns(0.1 * k), seen, P3))


def test_without_a_start_there_is_no_trajectory() -> None:
    smoother = Smoother(Config())
    assert smoother.trajectory() == ()
    smoother.predict(Odometry(0, np.zeros(3)))
    smoother.update(HeadingFactor(ns(1), 0.3, np.eye(1)))
    assert smoother.trajectory() == ()
    assert smoother.solution is None


def test_without_turns_the_last_pose_is_the_filters() -> None:
    # linear: nothing that comes later changes the last pose, so filter and smoother agree
    motion = MotionNoise(0.05, 0.03, 0.0, 0.0, 0.01, 1e-3, log_scale_sigma=0.0)
    config = replace(PLAIN, motion=motion, robust=Robust(nis_per_dof=1e9), graph=GAUSSIAN)
    smoother, ekf = Smoother(config), Ekf(config)
    random = np.random.default_rng(0)
    sure = np.diag([0.1, 0.1, 1e-4]) ** 2
    for k in range(40):
        command = np.array([*random.uniform(-1, 1, 2), 0.0])
        fix = np.array([0.5 + 0.02 * k, 0.1 * random.standard_normal(), 0.7])
        for estimator in (smoother, ekf):
            estimator.predict(Odometry(ns(0.1 * k), command))
            if k % 3 == 0:
                estimator.update(PoseFactor(ns(0.1 * k), fix, sure))
    last, filtered = smoother.trajectory()[-1], ekf.estimate()
    assert filtered is not None
    assert last.stamp_ns == filtered.stamp_ns
    # the graph's floor of motion, 0.1 mm a node, is the difference
    np.testing.assert_allclose(last.pose, filtered.pose, atol=1e-4)
    np.testing.assert_allclose(last.covariance, filtered.covariance, rtol=1e-2, atol=1e-8)


def test_looking_back_is_better_and_surer_than_looking_ahead() -> None:
    random = np.random.default_rng(1)
    commands = velocities(300)
    truth = walk(START[None], commands, 0.1, random)[:, 0]
    smoother, online = Smoother(Config()), []
    for k, command in enumerate(commands):
        smoother.predict(Odometry(ns(0.1 * k), command))
        if k % 10 == 0:
            seen = se2.retract(truth[k], np.sqrt(np.diag(P3)) * random.standard_normal(3))
            smoother.update(PoseFactor(ns(0.1 * k), seen, P3))
        now = smoother.estimate()
        assert now is not None
        online.append(now)
    trajectory = smoother.trajectory()
    assert [estimate.stamp_ns for estimate in trajectory] == [estimate.stamp_ns for estimate in online]
    error = [
        np.sqrt(np.mean([np.sum((estimate.pose - pose)[:2] ** 2) for estimate, pose in zip(run, truth, strict=False)]))
        for run in (trajectory, online)
    ]
    assert error[0] < 0.8 * error[1]
    area = [np.mean([np.linalg.det(estimate.covariance) for estimate in run]) for run in (trajectory, online)]
    assert area[0] < area[1]


def test_the_trajectory_reaches_back_before_the_start() -> None:
    random = np.random.default_rng(2)
    commands = velocities(60)
    truth = walk(START[None], commands, 0.1, random, MotionNoise(0.01, 0.01, 0.01, 0.01))[:, 0]
    smoother = Smoother(Config())
    landmark = np.array([2.0, 1.0])
    for k, command in enumerate(commands):
        smoother.predict(Odometry(ns(0.1 * k), command))
        if k in (5, 15):  # nothing online, but not forgotten
            seen = se2.apply(se2.inverse(truth[k]), landmark)
            smoother.update(LandmarkFactor(ns(0.1 * k), landmark, seen, 0.03**2 * np.eye(2)))
        if k >= 40 and k % 5 == 0:
            smoother.update(PoseFactor(ns(0.1 * k), truth[k], P3))
    trajectory = smoother.trajectory()
    assert trajectory[0].stamp_ns == 0
    for estimate, pose in zip(trajectory, truth, strict=False):
        check_covariance(estimate.covariance, 3)
        assert nees(estimate, pose) < 16.3
        assert np.hypot(*(estimate.pose - pose)[:2]) < 0.25


def test_stamps_rise_and_covariances_are_in_field_axes() -> None:
    random = np.random.default_rng(3)
    smoother, turned = Smoother(Config()), Smoother(Config())
    by = np.array([1.0, 2.0, 2.0])
    commands = velocities(50)
    truth = walk(START[None], commands, 0.1, random)[:, 0]
    driven(smoother, truth, commands, np.random.default_rng(0))
    driven(turned, se2.compose(by, truth), commands, np.random.default_rng(0))
    here, there = smoother.trajectory(), turned.trajectory()
    assert all(one.stamp_ns < other.stamp_ns for one, other in pairwise(here))
    for one, other in zip(here, there, strict=True):
        np.testing.assert_allclose(other.pose[:2], se2.apply(by, one.pose[:2]), atol=1e-4)
        np.testing.assert_allclose(other.covariance, se2.rotate_covariance(one.covariance, by[2]), rtol=1e-2, atol=1e-5)
    first = here[0]
    in_robot = se2.rotate_covariance(first.covariance, -first.pose[2])
    assert smoother.solution is not None
    np.testing.assert_allclose(in_robot, smoother.solution.covariances[0], atol=1e-12)


def test_a_late_factor_counts_where_the_robot_is_by_then() -> None:
    smoother = Smoother(replace(Config(), graph=Graph(node_interval_s=10.0)))
    smoother.start(Estimate(0, np.zeros(3), P3))
    smoother.predict(Odometry(0, np.array([1.0, 0.0, 0.0])))
    smoother.advance(ns(1.0))
    smoother.update(PoseFactor(ns(0.4), np.array([1.0, 0.0, 0.0]), P3))  # stamped before what is known
    trajectory = smoother.trajectory()
    assert [estimate.stamp_ns for estimate in trajectory] == [0, ns(1.0)]
    np.testing.assert_allclose([estimate.pose for estimate in trajectory], [[0, 0, 0], [1, 0, 0]], atol=1e-3)


def test_what_is_told_at_the_start_is_believed_with_its_covariance() -> None:
    # the kernel at its middle does nothing: a factor alone is met exactly
    smoother = Smoother(Config())
    covariance = np.array([[0.04, 0.01, 0.002], [0.01, 0.02, -0.003], [0.002, -0.003, 0.01]])
    smoother.start(Estimate(ns(1.0), START, covariance))
    (estimate,) = smoother.trajectory()
    assert estimate.stamp_ns == ns(1.0)
    np.testing.assert_allclose(estimate.pose, START, atol=1e-6)
    np.testing.assert_allclose(estimate.covariance, covariance, rtol=1e-3, atol=1e-6)


def test_a_start_forgets_the_whole_past() -> None:
    random = np.random.default_rng(4)
    commands = velocities(30)
    truth = walk(START[None], commands, 0.1, random)[:, 0]
    smoother = Smoother(Config())
    driven(smoother, truth, commands, random)
    there = np.array([-5.0, 3.0, -2.0])
    smoother.start(Estimate(ns(2.0), there, P3))  # late: at 2.9 s by now
    smoother.advance(ns(3.5))
    trajectory = smoother.trajectory()
    assert trajectory[0].stamp_ns == ns(2.9)
    np.testing.assert_allclose(trajectory[0].pose, there, atol=1e-3)
    assert trajectory[-1].stamp_ns == ns(3.5)


@pytest.mark.parametrize("config", [Config(), PLAIN], ids=["calibrated", "plain"])
def test_a_robot_that_was_carried_is_on_the_right_way_before_and_after(config: Config) -> None:
    random = np.random.default_rng(5)
    commands = velocities(200)
    truth = walk(START[None], commands, 0.1, random)[:, 0]
    truth[100:] = se2.compose(np.array([3.0, -2.0, 1.5]), truth[100:])
    smoother = Smoother(config)
    driven(smoother, truth, commands, random)
    off = [np.hypot(*(estimate.pose - pose)[:2]) for estimate, pose in zip(smoother.trajectory(), truth, strict=False)]
    assert len(off) == 200
    # one sigma of a single pose is 0.14 m
    assert np.sqrt(np.mean(np.square(off))) < 0.1
    assert max(off) < 0.4


def test_a_single_wrong_pose_does_not_bend_the_way() -> None:
    random = np.random.default_rng(6)
    commands = velocities(100)
    truth = walk(START[None], commands, 0.1, random)[:, 0]
    smoother = Smoother(Config())
    for k, command in enumerate(commands):
        smoother.predict(Odometry(ns(0.1 * k), command))
        if k % 5 == 0:
            pose = truth[k] if k != 50 else se2.compose(truth[k], np.array([4.0, 0.0, 2.0]))
            smoother.update(PoseFactor(ns(0.1 * k), pose, P3))
    assert max(np.hypot(*(one.pose - pose)[:2]) for one, pose in zip(smoother.trajectory(), truth, strict=False)) < 0.2


def seen_walks(
    walks: int, steps: int, config: Config, calibrations: FloatArray, seed: int
) -> list[tuple[Smoother, FloatArray]]:
    """Smoothers of walks that see the field's posts, each with its truth (steps + 1, 3)."""
    random = np.random.default_rng(seed)
    sigma = np.array([0.2, 0.1, 0.1])
    commands = velocities(steps)
    starts = se2.retract(START, sigma * random.standard_normal((walks, 3)))
    truths = walk(starts, commands, 0.1, random, calibration=OdometryCalibration(*calibrations.T))
    out = []
    for truth in np.swapaxes(truths, 0, 1):
        smoother = Smoother(config)
        smoother.start(Estimate(0, START, se2.rotate_covariance(np.diag(sigma**2), START[2])))
        for k, command in enumerate(commands):
            smoother.predict(Odometry(ns(0.1 * k), command))
            if k % 8 == 5:
                feed(smoother, right_factors(scan(ns(0.1 * k), truth[k], random), truth[k]))
        out.append((smoother, truth))
    return out


@pytest.mark.parametrize(
    ("walks", "nodes", "calibration"),
    [
        pytest.param(30, (30,), Calibration(), id="few"),
        pytest.param(80, (0, 40, 99), PLAIN.calibration, id="plain", marks=pytest.mark.slow),
        pytest.param(80, (0, 40, 99), Calibration(), id="calibrated", marks=pytest.mark.slow),
    ],
)
def test_the_errors_of_many_walks_are_as_large_as_the_marginals_say(
    walks: int, nodes: tuple[int, ...], calibration: Calibration
) -> None:
    real = np.random.default_rng(9).normal(0.0, calibration.sigmas(), (walks, CALIBRATION))
    runs = seen_walks(
        walks,
        max(60, nodes[-1] + 1),
        Config(motion=KNOWN_NOISE, graph=GAUSSIAN, calibration=calibration, sensor=PLAIN.sensor),
        real,
        8,
    )
    answers = [(smoother.trajectory(), truth) for smoother, truth in runs]
    for node in nodes:
        total = sum(nees(trajectory[node], truth[node]) for trajectory, truth in answers)
        # one time per walk, so the walks are independent: chi-square, 3 degrees of freedom each, 99.9 % two-sided
        assert chi2.ppf(0.0005, 3 * walks) < total < chi2.ppf(0.9995, 3 * walks)


def test_the_robust_kernel_makes_covariances_wider_than_errors_and_never_narrower() -> None:
    # each good factor counts for less than it knows: on average for 1 / (1 + 3 / 2^2) or so of it
    walks = 20
    runs = seen_walks(walks, 60, Config(), np.zeros((walks, CALIBRATION)), 10)
    total = sum(nees(smoother.trajectory()[30], truth[30]) for smoother, truth in runs)
    assert 0.4 * 3 * walks < total < chi2.ppf(0.9995, 3 * walks)


def test_a_smoother_that_is_asked_twice_answers_the_same() -> None:
    random = np.random.default_rng(7)
    commands = velocities(30)
    smoother = Smoother(Config())
    driven(smoother, walk(START[None], commands, 0.1, random)[:, 0], commands, random)
    for one, other in zip(smoother.trajectory(), smoother.trajectory(), strict=True):
        np.testing.assert_array_equal(one.pose, other.pose)
        np.testing.assert_array_equal(one.covariance, other.covariance)


def test_factors_at_almost_the_same_moment_are_no_trouble_for_a_standing_robot() -> None:
    smoother = Smoother(Config())
    smoother.start(Estimate(0, np.zeros(3), P3))
    factors: list[Factor] = [
        PoseFactor(ns(0.001 * k) + j, np.zeros(3), P3) for k in range(30) for j in (0, 1, 100, 10_000)
    ]
    feed(smoother, [Odometry(0, np.zeros(3)), *factors])  # type: ignore[list-item]
    trajectory = smoother.trajectory()
    np.testing.assert_allclose(trajectory[-1].pose, 0.0, atol=1e-6)
    assert len(trajectory) == 120
