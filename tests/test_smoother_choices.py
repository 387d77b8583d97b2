"""How the smoother compares readings of a log: evidence, ways over tracks, cavities, copies; against enumeration."""

import math
from itertools import product

import numpy as np
import pytest
from walks import ns

from estimators.chain import Recorded
from estimators.config import Calibration, Compass, Config, Graph, MotionNoise
from estimators.copies import Moved, moved
from estimators.graph import solve
from estimators.joint import Settled, cavity, log_evidence, settle
from estimators.modes import ModeSequence
from estimators.motion import CALIBRATION, HeldVelocity
from estimators.resolve import resolve
from estimators.stretches import Story, put_down_ns, stories
from estimators.tracks import Tracks
from fieldloc import pose as se2
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.measurements import Odometry
from fieldloc.mixture import IntArray
from fieldloc.pose import FloatArray
from fieldloc.regions import Region
from fieldloc.solution_mixture import SolutionMixture
from fieldloc.stacks import PoseStack

PLAIN = Config(
    motion=MotionNoise(0.1, 0.1, 0.0, 0.0, 0.02, 1e-4),
    graph=Graph(cauchy=1e6),
    calibration=Calibration(*[0.0] * CALIBRATION),
    compass=Compass(),
)
SIGMA_M, SIGMA_RAD = 0.1, 1e-3
P3 = np.diag([SIGMA_M, SIGMA_M, SIGMA_RAD]) ** 2
LOG_OUTLIER = -8.0
REGION = Region("anywhere", np.array([[-5.0, -4.0, 5.0, 4.0]]), np.array([[0.0, math.pi]]))


def straight(choices: int, seed: int, apart_m: float = 0.3) -> Recorded:
    """A robot that walks ahead with its heading known, so that all is linear; two places each time, 0.3 m apart."""
    random = np.random.default_rng(seed)
    held, motions, mixtures = HeldVelocity(PLAIN.motion), [], []
    held.advance(0)
    x_m, y_m = -2.0, 0.5
    for k in range(choices):
        if k:
            held.hold(Odometry(ns(k - 1), np.array([0.5, 0.0, 0.0])))
            step = held.advance(ns(k))
            assert step is not None
            motions.append(step)
            x_m, y_m = x_m + 0.5 + 0.07 * random.standard_normal(), y_m + 0.07 * random.standard_normal()
        seen = np.array([x_m, y_m, 0.0]) + [*(SIGMA_M * random.standard_normal(2)), 0.0]
        other = seen + [apart_m * random.choice([-1, 1]), 0.5 * apart_m * random.standard_normal(), 0.0]
        stack = PoseStack(np.array([seen, other]), np.array([P3, P3]))
        weights = np.log([0.5, 0.3])
        mixtures.append((k, SolutionMixture(ns(k), ((stack, weights),), LOG_OUTLIER, True, 80.0)))
    return Recorded(tuple(ns(k) for k in range(choices)), tuple(motions), (), tuple(mixtures))


def textbook_log_evidence(recorded: Recorded, choices: tuple[int, ...]) -> float:
    """A Kalman filter of x and y from a flat prior."""
    total, mean, covariance = 0.0, None, np.zeros((2, 2))
    for (k, mixture), choice in zip(recorded.mixtures, choices, strict=True):
        if mean is not None:
            mean = mean + recorded.motions[k - 1].before_from_after[:2]
            covariance = covariance + recorded.motions[k - 1].covariance[:2, :2]
        if choice < 0:
            total += LOG_OUTLIER
            continue
        (factor,) = mixture.chosen(choice)
        assert isinstance(factor, PoseFactor)
        seen, noise = factor.pose[:2], factor.covariance[:2, :2]
        total += math.log(0.5 if choice == 0 else 0.3)
        if mean is None:
            mean, covariance = seen, noise
            continue
        expected, off = covariance + noise, seen - mean
        total -= 0.5 * float(off @ np.linalg.solve(expected, off) + np.linalg.slogdet(2 * np.pi * expected)[1])
        gain = covariance @ np.linalg.inv(expected)
        mean, covariance = mean + gain @ off, covariance - gain @ covariance
    return total


def settled_on(recorded: Recorded, choices: IntArray) -> Settled:
    guess = np.array([mixture.solutions().poses[0] for _, mixture in recorded.mixtures])
    chain = recorded.chain(choices, (), guess, lambda index, choice: recorded.mixtures[index][1].chosen(choice))
    return Settled(choices, (), chain, solve(chain, PLAIN), np.zeros(len(choices)), guess)


def test_the_evidence_of_every_reading_is_that_of_the_textbook() -> None:
    recorded = straight(5, 1)
    ours, theirs = [], []
    for choices in product((0, 1), repeat=5):
        settled = settled_on(recorded, np.array(choices))
        ours.append(log_evidence(recorded, settled, PLAIN, 0.0))
        theirs.append(textbook_log_evidence(recorded, choices))
    # what the headings say is the same in all: a constant
    np.testing.assert_allclose(np.array(ours) - ours[0], np.array(theirs) - theirs[0], atol=0.02)


def readings(recorded: Recorded, options: tuple[int, ...]) -> list[tuple[float, IntArray]]:
    """All of them, the likeliest first, with the log of their probability."""
    every = [
        (textbook_log_evidence(recorded, one), np.array(one)) for one in product(options, repeat=len(recorded.mixtures))
    ]
    total = np.logaddexp.reduce([worth for worth, _ in every])
    return sorted(((worth - total, one) for worth, one in every), key=lambda pair: -pair[0])


@pytest.mark.parametrize("seed", range(6))
def test_the_reading_of_a_log_is_the_likeliest_of_all(seed: int) -> None:
    recorded = straight(6, seed)
    exact = readings(recorded, (0, 1))
    sequences = [ModeSequence(worth, one, (0,), 0) for worth, one in exact[:8]]
    resolution = resolve(recorded, sequences, REGION, None, PLAIN)
    assert resolution is not None
    np.testing.assert_array_equal(resolution.choices, exact[0][1])
    by_choices = {tuple(one.tolist()): worth for worth, one in exact}
    known = np.array([by_choices[tuple(one.choices.tolist())] for one in resolution.candidates])
    # of the readings that were solved, the probabilities are those of the enumeration
    np.testing.assert_allclose(resolution.probabilities, np.exp(known - np.logaddexp.reduce(known)), atol=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_one_wrong_choice_is_put_right(seed: int) -> None:
    recorded = straight(6, seed, apart_m=1.0)
    best = readings(recorded, (0, 1, -1))[0][1]
    for index in range(6):
        for wrong in {0, 1, -1} - {int(best[index])}:
            choices = best.copy()
            choices[index] = wrong
            guess = settled_on(recorded, best).solution.poses
            story = Story(choices, np.zeros(6), (), guess, np.zeros(6, dtype=np.intp), 0.0)
            np.testing.assert_array_equal(settle(recorded, story, PLAIN).choices, best)


def test_the_cavity_is_what_is_known_without_the_factor() -> None:
    recorded = straight(4, 0)
    with_it, without = settled_on(recorded, np.array([0, 0, 0, 0])), settled_on(recorded, np.array([0, 0, -1, 0]))
    factors = recorded.mixtures[2][1].chosen(0)
    pose, covariance = cavity(factors, with_it.solution.poses[2], with_it.solution.covariances[2], 1e6)
    np.testing.assert_allclose(pose, without.solution.poses[2], atol=1e-4)
    np.testing.assert_allclose(covariance, without.solution.covariances[2], rtol=0.02, atol=1e-6)


def test_the_likeliest_ways_over_tracks_are_those_of_enumeration() -> None:
    random = np.random.default_rng(0)
    recorded = straight(6, 0)
    tracks = Tracks(
        3.0 * random.standard_normal((3, 6)),
        np.zeros((3, 6), dtype=np.intp),
        np.zeros((3, 6)),
        np.arange(3)[:, None, None] + np.zeros((3, 6, 3)),  # they never meet
        np.tile(np.eye(3), (3, 6, 1, 1)),
        np.tile(np.eye(3), (3, 1, 1)),
    )
    log_start, log_kidnap = random.standard_normal(3), -2.5
    worth: dict[int, float] = {}
    for way in product(range(3), repeat=6):
        changes = int(np.count_nonzero(np.diff(way)))
        value = log_start[way[0]] + tracks.log_evidence[way, np.arange(6)].sum() + changes * log_kidnap
        worth[changes] = max(worth.get(changes, -math.inf), float(value))
    told = stories(recorded, tracks, np.zeros((3, 3)), log_start, log_kidnap, 3)
    for count in (1, 2, 3):
        best = max(story.log_worth for story in told if len(story.breaks) == count)
        np.testing.assert_allclose(best, worth[count])
    np.testing.assert_allclose(max(story.log_worth for story in told if not story.breaks), worth[0])


def two_tracks(evidence: FloatArray, choices: IntArray, apart_m: float) -> Tracks:
    poses = np.zeros((2, 6, 3))
    poses[1, :, 0] = apart_m
    spread = np.tile(0.01 * np.eye(3), (2, 6, 1, 1))
    return Tracks(evidence, choices, np.zeros((2, 6)), poses, spread, spread[:, 0])


def test_a_track_that_meets_another_goes_on_as_it_without_a_break() -> None:
    recorded = straight(6, 0)
    evidence = np.array([[4.0, 4.0, 4.0, -9.0, -9.0, -9.0], [-9.0, -9.0, 4.0, 4.0, 4.0, 4.0]])
    choices = np.array([[0] * 6, [1] * 6])
    for apart_m, symmetry, breaks in ((0.1, 0.0, 0), (3.0, 0.0, 1), (0.1, 3.0, 1)):
        copies = np.array([[0.0, 0.0, 0.0], [0.0, symmetry, 0.0]])
        tracks = two_tracks(evidence, choices, apart_m)
        best = stories(recorded, tracks, copies, np.zeros(2), -12.0, 3)[0]
        assert len(best.breaks) == breaks
        assert best.choices.tolist() in ([0, 0, 0, 1, 1, 1], [0, 0, 1, 1, 1, 1])


def test_after_a_long_gap_the_robot_was_put_down_just_before_it_saw_again() -> None:
    recorded = straight(6, 0)
    fits = np.array([[0, 0, -1, -1, -1, -1], [-1, -1, -1, -1, 0, 0]])
    evidence = np.where(fits >= 0, 4.0, -9.0)
    best = stories(recorded, two_tracks(evidence, fits, apart_m=3.0), np.zeros((2, 3)), np.zeros(2), -12.0, 3)[0]
    assert best.breaks == (4,)  # seen at 1 s and at 4 s
    assert put_down_ns(ns(1), ns(4)) == ns(3.75)
    assert put_down_ns(ns(1), ns(1.4)) == ns(1.2)
    np.testing.assert_array_equal(best.choices, [0, 0, -1, -1, 0, 0])
    assert recorded.between(best.choices, 4) == (1, 4)
    assert recorded.anchored(best.choices, best.breaks)
    assert not recorded.anchored(best.choices, (2, 3))


FACTORS: list[Factor] = [
    PoseFactor(0, np.array([1.0, 2.0, 0.5]), P3),
    LandmarkFactor(0, np.array([3.0, 1.0]), np.array([1.0, 0.3]), P3[:2, :2]),
    HeadingFactor(0, 0.7, P3[:1, :1], by_compass=True, wider=2.0),
    LineFactor(0, 0.6, 0.3, 1.2, P3[:2, :2]),
]


@pytest.mark.parametrize("factor", FACTORS, ids=lambda factor: type(factor).__name__)
def test_a_factor_of_a_moved_field_has_the_same_error_for_a_robot_that_was_moved_with_it(factor: Factor) -> None:
    by = np.array([0.5, -1.0, 2.5])
    pose = np.array([0.9, 1.8, 0.4])
    there = moved(factor, by)
    np.testing.assert_allclose(there.error(se2.compose(by, pose)), factor.error(pose), atol=1e-12)
    np.testing.assert_allclose(there.jacobian(se2.compose(by, pose)), factor.jacobian(pose), atol=1e-12)


def test_a_mixture_of_a_moved_field_is_the_same_for_a_robot_that_was_moved_with_it() -> None:
    by = np.array([0.5, -1.0, 2.5])
    still = straight(1, 0).mixtures[0][1]
    there = Moved(still, by)
    poses = still.solutions().poses + [0.02, -0.01, 1e-4]
    covariances = np.tile(P3, (2, 1, 1))
    one, other = still.expand(poses, covariances), there.expand(se2.compose(by, poses), covariances)
    np.testing.assert_array_equal(one.ids, other.ids)
    np.testing.assert_allclose(one.evidence, other.evidence, atol=1e-8)
    np.testing.assert_allclose(one.step, other.step, atol=1e-9)
    np.testing.assert_allclose(there.log_likelihood(se2.compose(by, poses)), still.log_likelihood(poses), atol=1e-8)
    np.testing.assert_allclose(there.solutions().poses, se2.compose(by, still.solutions().poses), atol=1e-12)
    for solution in (0, 1):
        (factor,) = there.chosen(solution)
        np.testing.assert_allclose(factor.error(there.solutions().poses[solution]), 0.0, atol=1e-9)
