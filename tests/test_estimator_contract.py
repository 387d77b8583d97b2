"""What every estimator owes to whoever feeds it; estimators/base.py says it in words."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pytest
from walks import PLAIN, SIGMA_BEARING_RAD, SIGMA_RANGE_M, Event, KnownFactor, feed, ns, transformed, velocities

from estimators.base import Estimate, Estimator
from estimators.config import Config
from estimators.registry import ALL
from fieldloc import pose as se2
from fieldloc.covariance import check_covariance
from fieldloc.factors import HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

Make = Callable[[Config], Estimator]

P3 = np.array([[0.04, 0.01, 0.002], [0.01, 0.02, -0.003], [0.002, -0.003, 0.01]])
P2 = np.diag([0.02, 0.03])
START = np.array([1.0, -2.0, 2.0])
FIELD_P3 = se2.rotate_covariance(P3, START[2])
NO_POSE: list[KnownFactor] = [
    LandmarkFactor(ns(1), np.array([2.0, 0.0]), np.array([1.0, 1.0]), P2),
    HeadingFactor(ns(1), 1.0, P2[:1, :1]),
    LineFactor(ns(1), 1.0, 0.0, 0.5, P2),
]

DEFAULT = Config()

# what others published promises less: those are held to what was published, in test_particles_published
HELD = {name: make for name, make in ALL.items() if not name.endswith("-style")}
CORRECTING = {name: make for name, make in HELD.items() if name != "dead-reckoning"}

every = pytest.mark.parametrize("make", HELD.values(), ids=HELD.keys())
correcting = pytest.mark.parametrize("make", CORRECTING.values(), ids=CORRECTING.keys())


def started(
    make: Make,
    pose: FloatArray = START,
    covariance: FloatArray = P3,
    stamp_s: float = 1.0,
    config: Config = DEFAULT,
) -> Estimator:
    estimator = make(config)
    estimator.update(PoseFactor(ns(stamp_s), pose, covariance))
    return estimator


def now(estimator: Estimator) -> Estimate:
    estimate = estimator.estimate()
    assert estimate is not None
    return estimate


def assert_same(one: Estimate, other: Estimate, atol: float = 0.0) -> None:
    assert one.stamp_ns == other.stamp_ns
    np.testing.assert_allclose(one.pose, other.pose, rtol=0, atol=atol)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=0, atol=atol)


def assert_about(make: Make, estimate: Estimate, pose: FloatArray, covariance: FloatArray) -> None:
    """Equal; a cloud of particles, up to its sampling error."""
    error = estimate.pose - pose
    error[2] = se2.wrap(error[2])
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))
    sampled = make is ALL["particles"]
    # 1000 particles: the mean is off by 1/sqrt(1000) = 0.03 sigma, a variance by sqrt(2/1000) = 4.5 %; five of these
    np.testing.assert_allclose(whitener @ error, 0.0, atol=0.16 if sampled else 1e-9)
    np.testing.assert_allclose(whitener @ estimate.covariance @ whitener.T, np.eye(3), atol=0.22 if sampled else 1e-9)


def drive(seconds: float, seed: int = 0) -> list[Event]:
    """A walk at 10 Hz from START with all kinds of factors, true but for their noise, some between two odometries."""
    random = np.random.default_rng(seed)
    landmark = np.array([2.0, -1.0])
    noise = np.diag([SIGMA_RANGE_M, SIGMA_BEARING_RAD]) ** 2
    pose = START
    events: list[Event] = [PoseFactor(ns(1.0), se2.retract(pose, np.array([0.1, 0.05, -0.05])), P3)]
    for k, velocity in enumerate(velocities(round(10 * seconds))):
        stamp_s = 1.0 + 0.1 * k
        events.append(Odometry(ns(stamp_s), velocity))
        middle = se2.compose(pose, se2.exp(velocity * 0.04))
        u, v, w = random.standard_normal(3)
        match k % 9:
            case 2:
                seen = se2.apply(se2.inverse(middle), landmark) + [SIGMA_RANGE_M * u, SIGMA_BEARING_RAD * v]
                events.append(LandmarkFactor(ns(stamp_s + 0.04), landmark, seen, noise))
            case 4:
                events.append(HeadingFactor(ns(stamp_s + 0.04), float(middle[2] + 0.1 * u), np.array([[0.01]])))
            case 6:
                heading, offset = middle[2] + 0.05 * u, np.cos(0.4) * middle[0] + np.sin(0.4) * middle[1] + 0.1 * v
                events.append(
                    LineFactor(ns(stamp_s + 0.04), float(heading), 0.4, float(offset), np.diag([0.0025, 0.01]))
                )
            case 8:
                off = np.array([0.1 * u, 0.1 * v, 0.05 * w])
                events.append(PoseFactor(ns(stamp_s + 0.04), se2.retract(middle, off), np.diag([0.1, 0.1, 0.05]) ** 2))
        pose = se2.compose(pose, se2.exp(velocity * 0.1))
    return events


@every
def test_nothing_is_known_before_a_start(make: Make) -> None:
    estimator = make(Config())
    assert estimator.estimate() is None
    estimator.predict(Odometry(ns(0), np.array([1.0, 0.0, 0.0])))
    assert estimator.estimate() is None
    estimator.advance(ns(0.5))
    assert estimator.estimate() is None
    for factor in NO_POSE:
        assert estimator.update(factor) is None
        assert estimator.estimate() is None


@every
def test_the_first_whole_pose_starts_the_estimate(make: Make) -> None:
    estimator = make(Config())
    for factor in NO_POSE:
        estimator.update(factor)
    assert estimator.update(PoseFactor(ns(2), START, P3)) is None
    assert now(estimator).stamp_ns == ns(2)
    assert_about(make, now(estimator), START, FIELD_P3)


@every
def test_start_believes_what_it_is_told(make: Make) -> None:
    estimator = make(Config())
    estimator.start(Estimate(ns(3), START, FIELD_P3))
    assert now(estimator).stamp_ns == ns(3)
    assert_about(make, now(estimator), START, FIELD_P3)


@every
def test_start_forgets_everything_before(make: Make) -> None:
    estimator = make(Config())
    feed(estimator, drive(3.0))
    stamp_ns = now(estimator).stamp_ns
    elsewhere = np.array([-3.0, 4.0, -1.0])
    covariance = se2.rotate_covariance(P3, -1.0)
    estimator.start(Estimate(stamp_ns, elsewhere, covariance))
    assert_about(make, now(estimator), elsewhere, covariance)


@every
def test_start_keeps_no_doubts_of_the_past(make: Make) -> None:
    # three poses elsewhere, one short of a restart; after the start, a fourth is the first
    elsewhere = se2.compose(START, np.array([3.0, 0.0, 0.0]))
    estimator = started(make)
    for k in range(Config().robust.restart_after - 1):
        estimator.update(PoseFactor(ns(1.1 + 0.1 * k), elsewhere, P3))
    stamp_ns = now(estimator).stamp_ns
    estimator.start(Estimate(stamp_ns, START, FIELD_P3))
    estimator.update(PoseFactor(stamp_ns, elsewhere, P3))
    assert np.linalg.norm(now(estimator).pose[:2] - START[:2]) < 1.0


@every
@pytest.mark.parametrize("velocity", [[1.0, 0.0, 0.0], [0.3, -0.2, 2.5], [0.0, 0.0, -3.0]])
def test_motion_is_the_exact_motion_of_a_plane(make: Make, velocity: Sequence[float]) -> None:
    estimator = started(make)
    estimator.predict(Odometry(ns(1), np.array(velocity)))
    before = now(estimator)
    estimator.advance(ns(1.7))
    expected = se2.compose(before.pose, se2.exp(np.array(velocity) * 0.7))
    np.testing.assert_allclose(now(estimator).pose, expected, atol=1e-9)
    assert now(estimator).stamp_ns == ns(1.7)
    # the next message ends this velocity and starts another
    estimator.predict(Odometry(ns(1.9), np.array([0.0, 0.5, 0.0])))
    estimator.advance(ns(2.1))
    expected = se2.compose(expected, se2.exp(np.array(velocity) * 0.2))
    expected = se2.compose(expected, np.array([0.0, 0.1, 0.0]))
    np.testing.assert_allclose(now(estimator).pose, expected, atol=1e-9)


@every
def test_motion_makes_less_certain_and_turns_the_covariance_along(make: Make) -> None:
    estimator = started(make, covariance=np.diag([0.3, 0.01, 0.02]) ** 2, config=PLAIN)
    estimator.predict(Odometry(ns(1), np.array([0.0, 0.0, 1.0])))
    before = now(estimator)
    estimator.advance(ns(1.5))
    after = now(estimator)
    # turning on the spot moves no uncertainty of the position: the field axes stay
    np.testing.assert_allclose(after.covariance[:2, :2], before.covariance[:2, :2], atol=0.002**2)
    assert after.covariance[2, 2] > before.covariance[2, 2]
    # half a metre ahead carries the heading's error sideways
    estimator.predict(Odometry(ns(1.5), np.array([1.0, 0.0, 0.0])))
    estimator.advance(ns(2.0))
    ahead = se2.rotation(after.pose[2]) @ [0.5, 0.0]
    step = np.eye(3)
    step[:2, 2] = [-ahead[1], ahead[0]]
    carried = step @ after.covariance @ step.T
    growth = np.linalg.eigvalsh(now(estimator).covariance - carried)
    assert growth.min() > 0.0
    assert growth.max() < 0.05**2


@every
def test_what_comes_with_an_old_stamp_moves_nothing_back(make: Make) -> None:
    estimator = started(make, stamp_s=5.0)
    estimator.predict(Odometry(ns(5), np.array([1.0, 0.0, 0.0])))
    estimator.advance(ns(6))
    before = now(estimator)
    estimator.advance(ns(4))
    assert_same(now(estimator), before)
    estimator.predict(Odometry(ns(4.5), np.array([-9.0, 0.0, 0.0])))
    assert_same(now(estimator), before)
    estimator.advance(ns(6.5))  # the older velocity was not used
    np.testing.assert_allclose(now(estimator).pose, se2.compose(before.pose, np.array([0.5, 0.0, 0.0])), atol=1e-9)
    estimator.update(HeadingFactor(ns(3), 2.0, P2[:1, :1]))
    assert now(estimator).stamp_ns == ns(6.5)
    estimator.start(Estimate(ns(2), START, FIELD_P3))
    assert now(estimator).stamp_ns == ns(6.5)


@every
def test_odometry_that_comes_twice_counts_once(make: Make) -> None:
    events = drive(3.0)
    twice = [event for event in events for _ in range(2 if isinstance(event, Odometry) else 1)]
    assert_same(feed(make(Config()), twice)[-1], feed(make(Config()), events)[-1])


@every
def test_asking_changes_nothing(make: Make) -> None:
    asked, quiet = make(Config()), make(Config())
    for event in drive(3.0):
        for estimator in (asked, quiet):
            if isinstance(event, Odometry):
                estimator.predict(event)
            else:
                estimator.update(event)
        asked.estimate()
        asked.advance(event.stamp_ns)
    assert_same(now(asked), now(quiet))


@every
def test_advancing_in_parts_is_advancing(make: Make) -> None:
    ends = []
    for parts in (1, 10):
        estimator = started(make)
        estimator.predict(Odometry(ns(1), np.array([0.5, 0.1, 0.5])))
        for k in range(parts):
            estimator.advance(ns(1.0 + 0.8 * (k + 1) / parts))
        ends.append(now(estimator))
    assert_same(*ends, atol=1e-6)


@correcting
@pytest.mark.parametrize("kind", range(4))
def test_a_factor_draws_the_estimate_to_itself_and_makes_it_surer(make: Make, kind: int) -> None:
    estimator = started(make)
    before = now(estimator)
    off = se2.retract(before.pose, np.array([0.1, -0.1, 0.1]))
    seen = se2.apply(se2.inverse(off), np.array([2.0, 0.0]))
    offset_m = float(np.cos(0.4) * off[0] + np.sin(0.4) * off[1])
    factor: KnownFactor = [
        PoseFactor(ns(1), off, P3),
        LandmarkFactor(ns(1), np.array([2.0, 0.0]), seen, P2),
        HeadingFactor(ns(1), float(off[2]), P2[:1, :1]),
        LineFactor(ns(1), float(off[2]), 0.4, offset_m, P2),
    ][kind]
    estimator.update(factor)
    after = now(estimator)

    def distance(pose: FloatArray) -> float:
        error = factor.error(pose)
        return float(error @ np.linalg.solve(factor.covariance, error))

    assert distance(after.pose) < 0.9 * distance(before.pose)
    assert np.linalg.det(after.covariance) < 0.9 * np.linalg.det(before.covariance)


def test_no_factor_moves_dead_reckoning() -> None:
    make = ALL["dead-reckoning"]
    estimator = started(make)
    before = now(estimator)
    for factor in [*NO_POSE, PoseFactor(ns(1), se2.compose(START, START), P3)]:
        innovation = estimator.update(factor)
        assert innovation is not None
        assert innovation.weight == 0.0
        assert_same(now(estimator), before)


@every
def test_the_innovation_is_how_the_factor_met_the_prediction(make: Make) -> None:
    for factor in [*NO_POSE, PoseFactor(ns(1), se2.retract(START, np.array([0.3, 0.1, -0.2])), P3)]:
        estimator = started(make)
        predicted = now(estimator)
        innovation = estimator.update(factor)
        assert innovation is not None
        assert innovation.stamp_ns == factor.stamp_ns
        np.testing.assert_allclose(innovation.residual, factor.error(predicted.pose), atol=1e-9)
        jacobian = factor.jacobian(predicted.pose)
        robot = se2.rotate_covariance(predicted.covariance, -predicted.pose[2])
        expected = jacobian @ robot @ jacobian.T + factor.covariance
        np.testing.assert_allclose(innovation.covariance, expected, atol=1e-9)
        nis = innovation.residual @ np.linalg.solve(expected, innovation.residual)
        assert innovation.nis == pytest.approx(nis)
        assert 0.0 <= innovation.weight <= 1.0


@correcting
def test_a_factor_counts_less_the_more_it_disagrees(make: Make) -> None:
    weights = []
    for off_m in (0.0, 0.5, 2.0, 8.0):
        innovation = started(make).update(PoseFactor(ns(1), se2.compose(START, np.array([off_m, 0.0, 0.0])), P3))
        assert innovation is not None
        weights.append(innovation.weight)
    assert weights[0] > 0.95
    assert all(later <= earlier for earlier, later in pairwise(weights))
    assert weights[-1] < 0.1


@every
def test_estimates_stay_finite_certain_and_in_order(make: Make) -> None:
    events = drive(8.0)
    estimates = feed(make(Config()), [*events, *events[-9:], *drive(2.0)])  # at the end everything comes again
    assert len(estimates) > 80
    for before, after in pairwise(estimates):
        assert before.stamp_ns <= after.stamp_ns
    for estimate in estimates:
        assert np.all(np.isfinite(estimate.pose))
        assert abs(estimate.pose[2]) <= np.pi
        check_covariance(estimate.covariance, 3)


@every
def test_the_same_input_gives_the_same_output(make: Make) -> None:
    first, second = feed(make(Config()), drive(4.0)), feed(make(Config()), drive(4.0))
    for one, other in zip(first, second, strict=True):
        assert_same(one, other)


@every
@pytest.mark.parametrize("by", [[0.0, 0.0, np.pi], [3.0, -7.0, 1.3], [0.0, 0.0, -np.pi / 2]])
def test_moving_the_whole_world_moves_the_estimates_along(make: Make, by: Sequence[float]) -> None:
    move = np.array(by)
    here = feed(make(Config()), drive(5.0))
    there = feed(make(Config()), [transformed(event, move) for event in drive(5.0)])
    for one, other in zip(here, there, strict=True):
        expected = se2.compose(move, one.pose)
        np.testing.assert_allclose(other.pose[:2], expected[:2], atol=1e-6)
        assert abs(se2.wrap(other.pose[2] - expected[2])) < 1e-6
        np.testing.assert_allclose(other.covariance, se2.rotate_covariance(one.covariance, move[2]), atol=1e-6)


@every
def test_the_estimate_follows_the_truth(make: Make) -> None:
    events = drive(20.0)
    pose = START
    for velocity in velocities(200)[:-1]:
        pose = se2.compose(pose, se2.exp(velocity * 0.1))
    estimate = feed(make(Config()), events)[-1]
    error = estimate.pose - pose
    error[2] = se2.wrap(error[2])
    assert error @ np.linalg.solve(estimate.covariance, error) < 16.3  # once in a thousand by chance
    if make is not ALL["dead-reckoning"]:
        assert np.abs(error).max() < 0.2


@every
def test_a_heading_beside_the_half_turn_is_no_trap(make: Make) -> None:
    estimator = started(make, np.array([0.0, 0.0, 3.1]), np.diag([0.1, 0.1, 0.1]) ** 2)
    innovation = estimator.update(PoseFactor(ns(1), np.array([0.0, 0.0, -3.1]), np.diag([0.1, 0.1, 0.1]) ** 2))
    assert innovation is not None
    assert innovation.nis < 1.0
    heading = now(estimator).pose[2]
    assert np.cos(heading) < -0.99
    assert now(estimator).covariance[2, 2] < 0.011
    for factor in (
        HeadingFactor(ns(1), -3.1, P2[:1, :1]),
        HeadingFactor(ns(1), 3.1 - 2 * np.pi, P2[:1, :1]),
        LineFactor(ns(1), -3.1, 0.0, 0.0, P2),
    ):
        innovation = estimator.update(factor)
        assert innovation is not None
        assert innovation.nis < 1.0
        assert np.cos(now(estimator).pose[2]) < -0.99
    estimator.predict(Odometry(ns(1), np.array([0.0, 0.0, 1.0])))
    estimator.advance(ns(1.5))
    assert abs(se2.wrap(now(estimator).pose[2] - np.pi - 0.5)) < 0.1


@every
def test_silent_odometry_stops_the_robot_and_lets_the_doubt_grow(make: Make) -> None:
    estimator = started(make)
    estimator.predict(Odometry(ns(1), np.array([1.0, 0.0, 0.0])))
    before = now(estimator)
    hold_s = Config().motion.max_hold_s
    estimator.advance(ns(1.0 + hold_s))
    held = now(estimator)
    np.testing.assert_allclose(held.pose, se2.compose(before.pose, np.array([hold_s, 0.0, 0.0])), atol=1e-9)
    estimator.advance(ns(11.0 + hold_s))
    silent = now(estimator)
    np.testing.assert_allclose(silent.pose, held.pose, atol=1e-9)
    growth = silent.covariance - held.covariance
    np.testing.assert_allclose(growth, np.diag([0.3**2, 0.3**2, 0.5**2]) * 10, atol=1e-6)


@correcting
def test_one_wrong_factor_does_not_wreck_the_estimate(make: Make) -> None:
    events = drive(6.0)
    middle = len(events) // 2
    stamp_ns = events[middle].stamp_ns
    straight = feed(make(Config()), events)
    wrong: list[KnownFactor] = [
        PoseFactor(stamp_ns, np.array([-3.0, 4.0, -1.0]), P3),
        LandmarkFactor(stamp_ns, np.array([-4.0, -4.0]), np.array([1.0, 0.0]), P2),
        HeadingFactor(stamp_ns, float(straight[middle].pose[2]) + 2.5, P2[:1, :1]),
        LineFactor(stamp_ns, float(straight[middle].pose[2]), 0.0, 9.0, P2),
    ]
    for factor in wrong:
        estimates = feed(make(Config()), [*events[:middle], factor, *events[middle:]])
        for one, other in zip(straight[middle:], estimates[middle + 1 :], strict=True):
            error = other.pose - one.pose
            error[2] = se2.wrap(error[2])
            # never off by more than three of its own sigmas, and 6 m away is not 60 cm away
            assert error @ np.linalg.solve(one.covariance, error) < 9.0
            assert np.linalg.norm(error[:2]) < 0.6


@correcting
def test_no_number_of_landmarks_is_ignored_for_good(make: Make) -> None:
    # the estimate is far too sure of a wrong pose; landmarks alone cannot restart it, but they wear the error down
    wrong = se2.compose(START, np.array([1.0, 0.5, 0.6]))
    estimator = started(make, wrong, np.diag([0.1, 0.1, 0.05]) ** 2, stamp_s=0.0, config=PLAIN)
    random = np.random.default_rng(2)
    noise = np.diag([SIGMA_RANGE_M, SIGMA_BEARING_RAD]) ** 2
    pose = START
    for k, velocity in enumerate(velocities(300)):
        estimator.predict(Odometry(ns(0.1 * k), velocity))
        if k % 2:
            landmark = np.array([[2.0, -1.0], [-2.0, 0.0], [1.0, -5.0]])[k % 3]
            seen = se2.apply(se2.inverse(pose), landmark) + random.multivariate_normal(np.zeros(2), noise)
            estimator.update(LandmarkFactor(ns(0.1 * k), landmark, seen, noise))
        pose = se2.compose(pose, se2.exp(0.1 * velocity))
    estimator.advance(ns(30.0))
    assert np.hypot(*(now(estimator).pose - pose)[:2]) < 0.2
    assert abs(se2.wrap(now(estimator).pose[2] - pose[2])) < 0.1


@correcting
def test_a_robot_that_was_carried_is_found_again(make: Make) -> None:
    estimator = make(Config())
    feed(estimator, drive(5.0))
    assert np.linalg.norm(now(estimator).pose[:2] - START[:2]) < 3.0
    random = np.random.default_rng(1)
    pose, stamp_s = np.array([-6.0, 5.0, -2.0]), 6.0
    for k in range(Config().robust.restart_after):
        stamp_s = 6.0 + 0.5 * k
        estimator.predict(Odometry(ns(stamp_s), np.array([0.5, 0.0, 0.8])))
        seen = se2.retract(pose, np.array([0.1, 0.1, 0.05]) * random.standard_normal(3))
        estimator.update(PoseFactor(ns(stamp_s), seen, np.diag([0.1, 0.1, 0.05]) ** 2))
        if k < Config().robust.restart_after - 1:
            assert np.linalg.norm(now(estimator).pose[:2] - pose[:2]) > 3.0  # not at the first doubt
        else:
            assert np.linalg.norm(now(estimator).pose[:2] - pose[:2]) < 0.4
            assert abs(se2.wrap(now(estimator).pose[2] - pose[2])) < 0.2
        pose = se2.compose(pose, se2.exp(np.array([0.5, 0.0, 0.8]) * 0.5))


@correcting
def test_a_precise_factor_after_a_vague_start_leaves_an_honest_estimate(make: Make) -> None:
    vague, precise = np.diag([1.0, 1.0, 0.5]) ** 2, np.diag([0.01, 0.01, 0.005]) ** 2
    for seed in range(3):
        truth = se2.retract(START, np.array([1.0, 1.0, 0.5]) * np.random.default_rng(seed).uniform(-1, 1, 3))
        estimator = started(make, covariance=vague)
        estimator.update(PoseFactor(ns(1), truth, precise))
        estimate = now(estimator)
        check_covariance(estimate.covariance, 3)
        error = estimate.pose - truth
        error[2] = se2.wrap(error[2])
        assert error @ np.linalg.solve(estimate.covariance, error) < 16.3
        assert np.linalg.norm(error[:2]) < 0.05
