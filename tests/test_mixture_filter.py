"""The Gaussian sum against the exact answer, and what it owes beyond the contract suite."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from pose_sights import FIELD, HALF_TURN, LOPSIDED, OWN_HALF, SIGMAS, VOLUME, of_poses, sight, stroll
from walks import PLAIN, Event, feed, ns, velocities

from estimators.base import Ambiguity, Estimate
from estimators.config import Compass, Config, Mixture
from estimators.ekf import Ekf
from estimators.mixture import MixtureFilter, merge
from fieldloc import pose as se2
from fieldloc.factors import HeadingFactor, LandmarkFactor, PoseFactor
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

P3 = np.diag([0.2, 0.2, 0.05]) ** 2
START = np.array([1.0, -0.5, 0.3])
EXACT = Mixture(max_hypotheses=5000, prune_below=1e-15, evidence_share=1.0, kidnaps_per_min=0.0)
LITERAL = replace(PLAIN, mixture=EXACT)


def log_normal(error: FloatArray, covariance: FloatArray) -> float:
    return float(-0.5 * (error @ np.linalg.solve(covariance, error) + np.linalg.slogdet(2 * np.pi * covariance)[1]))


def now(estimator: MixtureFilter) -> Ambiguity:
    ambiguity = estimator.ambiguity()
    assert ambiguity is not None
    return ambiguity


def started(config: Config = PLAIN, remember: bool = False, stamp_ns: int = 0) -> MixtureFilter:
    estimator = MixtureFilter(config, remember=remember)
    estimator.start(Estimate(stamp_ns, START, se2.rotate_covariance(P3, START[2])))
    return estimator


def as_table(ambiguity: Ambiguity) -> FloatArray:
    """(n, 4) weight and pose, in an order that depends on nothing else."""
    table = np.array([[h.weight, *h.pose] for h in ambiguity.hypotheses])
    return table[np.lexsort(np.round(table.T, 5))]


# -- against the exact answer ------------------------------------------------------------------------------------------


def test_the_weights_are_those_of_all_ways_to_read_it(monkeypatch: pytest.MonkeyPatch) -> None:
    # three sights of two solutions each, so 27 sequences; no doubt of the heading, so all is linear
    monkeypatch.setattr(merge, "_ALIKE", -1.0)
    random = np.random.default_rng(4)
    R = np.diag(SIGMAS**2)
    sure = np.diag([0.2, 0.2, 1e-5]) ** 2
    estimator = MixtureFilter(LITERAL, remember=True)
    estimator.start(Estimate(0, START, se2.rotate_covariance(sure, START[2])))
    seen, outlier = [], np.log(0.02)
    for _ in range(3):
        poses = se2.retract(START, random.standard_normal((2, 3)) * [0.2, 0.2, 0.0])
        seen.append(poses)
        estimator.observe(of_poses(0, poses, np.log([0.6, 0.4]), outlier))
    exact = {}
    for choices in product([-1, 0, 1], repeat=3):
        mean, covariance, log_weight = np.zeros(3), sure, 0.0
        for poses, choice in zip(seen, choices, strict=True):
            if choice < 0:
                log_weight += outlier
                continue
            innovation = se2.local(START, poses[choice]) - mean
            expected = covariance + R
            log_weight += np.log([0.6, 0.4][choice]) + log_normal(innovation, expected)
            gain = covariance @ np.linalg.inv(expected)
            mean, covariance = mean + gain @ innovation, covariance - gain @ covariance
        exact[choices] = log_weight
    whole = np.logaddexp.reduce(list(exact.values()))
    found = {tuple(one.choices.tolist()): one.log_weight for one in estimator.sequences(100)}
    for choices, log_weight in exact.items():
        if log_weight - whole > np.log(1e-4):
            assert found[choices] == pytest.approx(log_weight - whole, abs=1e-6)
    assert list(found.values()) == sorted(found.values(), reverse=True)


def test_merging_keeps_the_mean_and_the_covariance_of_all() -> None:
    random = np.random.default_rng(1)
    poses = se2.retract(START, random.standard_normal((4, 3)) * [0.05, 0.05, 0.02])
    weights = np.array([0.4, 0.3, 0.2, 0.1])
    estimator = MixtureFilter(replace(PLAIN, mixture=EXACT))
    estimator.start_in(LOPSIDED, 0)
    estimator.observe(of_poses(0, poses, np.log(weights), -40.0))
    merged = estimator.estimate()
    assert len(now(estimator).hypotheses) == 1
    assert merged is not None
    mean = weights @ poses
    around = poses - mean
    covariances = se2.rotate_covariance(np.diag(SIGMAS**2), poses[:, 2])
    covariance = np.einsum("k,kij->ij", weights, covariances + around[:, :, None] * around[:, None, :])
    np.testing.assert_allclose(merged.pose, mean, atol=1e-3)  # of 0.1 m, turned by 0.02 rad
    np.testing.assert_allclose(merged.covariance, covariance, atol=5e-4)


def test_one_hypothesis_is_an_extended_kalman_filter() -> None:
    random = np.random.default_rng(0)
    events: list[Event] = [PoseFactor(0, START, P3)]
    pose = START
    for k, velocity in enumerate(velocities(60)):
        events.append(Odometry(ns(0.1 * k), velocity))
        noise = SIGMAS * random.standard_normal(3)
        match k % 5:
            case 1:
                events.append(PoseFactor(ns(0.1 * k), se2.retract(pose, noise), np.diag(SIGMAS**2)))
            case 2:
                landmark = np.array([2.0, 3.0])
                at = se2.apply(se2.inverse(pose), landmark) + noise[:2]
                events.append(LandmarkFactor(ns(0.1 * k), landmark, at, np.diag(SIGMAS[:2] ** 2)))
            case 3:
                compass = pose[2] + 0.2 + noise[2]
                events.append(HeadingFactor(ns(0.1 * k), float(compass), np.array([[0.01]])))
        pose = se2.compose(pose, se2.exp(0.1 * velocity))
    for one, other in zip(feed(MixtureFilter(Config()), events), feed(Ekf(Config()), events), strict=True):
        np.testing.assert_allclose(one.pose, other.pose, atol=1e-9)
        np.testing.assert_allclose(one.covariance, other.covariance, atol=1e-9)


def test_a_sight_of_one_pose_is_a_factor_of_that_pose() -> None:
    one, other = started(LITERAL), Ekf(LITERAL)
    other.start(Estimate(0, START, se2.rotate_covariance(P3, START[2])))
    at = se2.retract(START, np.array([0.02, -0.02, 0.01]))
    one.observe(of_poses(5, at[None], np.zeros(1), -60.0))
    other.update(PoseFactor(5, at, np.diag(SIGMAS**2)))
    mine, theirs = one.estimate(), other.estimate()
    assert mine is not None
    assert theirs is not None
    np.testing.assert_allclose(mine.pose, theirs.pose, atol=1e-5)  # linearised at one and the same place
    np.testing.assert_allclose(mine.covariance, theirs.covariance, rtol=1e-2, atol=1e-6)


def test_the_order_of_solutions_does_not_matter() -> None:
    tables = []
    for turn in (1, -1):
        random = np.random.default_rng(8)
        estimator = MixtureFilter(Config())
        estimator.start_in(LOPSIDED, 0)
        for k in range(6):
            one = sight(ns(0.2 * k), START, random, decoys=3, symmetric=False)
            stack, weights = one.stacks[0]
            estimator.observe(of_poses(one.stamp_ns, stack.poses[::turn], weights[::turn], one.log_outlier))  # type: ignore[attr-defined]
        tables.append(as_table(now(estimator)))
    np.testing.assert_allclose(tables[0], tables[1], atol=1e-9)


def test_folded_is_the_same_as_unfolded() -> None:
    # the same sights, once said to be alike on both sides, once looked up on each side
    tables = []
    for symmetric in (True, False):
        random = np.random.default_rng(3)
        estimator = MixtureFilter(PLAIN)
        estimator.start_in(OWN_HALF, 0)
        for k in range(5):
            one = sight(ns(0.2 * k), np.array([-2.0, 1.0, 0.4]), random, decoys=1)
            estimator.observe(replace(one, symmetric=symmetric))
        ambiguity = now(estimator)
        tables.append(np.array([[h.weight, *h.pose] for h in ambiguity.hypotheses if h.weight > 1e-3]))
        assert ambiguity.mirrored == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(tables[0], tables[1], atol=1e-4)


# -- lost and found ----------------------------------------------------------------------------------------------------


def test_the_lost_are_found_as_bayes_says() -> None:
    estimator = MixtureFilter(LITERAL)
    estimator.start_in(LOPSIDED, 0)
    assert estimator.ambiguity() is None
    estimator.observe(of_poses(0, START[None], np.log([0.8]), np.log(0.2 / VOLUME) + 1.0))
    # found: 0.8 times the density 1 / volume; not found: the outlier's density
    assert now(estimator).lost == pytest.approx(0.2 * np.e / (0.8 + 0.2 * np.e), abs=1e-9)
    np.testing.assert_allclose(now(estimator).hypotheses[0].pose, START)


def test_the_robot_may_have_been_carried_the_longer_nothing_is_seen() -> None:
    estimator = started(Config(mixture=Mixture(kidnaps_per_min=0.5)))
    for minutes in (0.0, 1.0, 3.0):
        estimator.advance(ns(60.0 * minutes))
        assert now(estimator).lost == pytest.approx(1.0 - np.exp(-0.5 * minutes), abs=1e-9)
        assert sum(h.weight for h in now(estimator).hypotheses) + now(estimator).lost == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(12))
def test_a_robot_that_was_carried_is_found_within_two_seconds(seed: int) -> None:
    estimator, seen = stroll(seed, 12.0, carried_at_s=6.0, config=Config())
    for one in seen:
        if 3.0 <= one.stamp_s < 6.0 or one.stamp_s >= 8.0:
            error = min((one.error(), one.error(other_side=True)), key=lambda e: float(np.linalg.norm(e)))
            assert np.hypot(*error[:2]) < 0.3
            assert abs(error[2]) < np.radians(15)
    assert [event.kind for event in estimator.events].count("recovery") == 1


def test_a_start_in_a_half_knows_the_side() -> None:
    for seed in range(4):
        _, seen = stroll(seed, 5.0, region=OWN_HALF, config=Config())
        assert np.linalg.norm(seen[-1].error()) < 0.5
        assert seen[-1].ambiguity.mirrored < 0.1  # it may have begun beside the halfway line


def test_a_start_that_was_told_forgets_the_region() -> None:
    estimator = MixtureFilter(Config())
    estimator.start_in(FIELD, 0)
    estimator.start(Estimate(0, START, P3))
    assert [h.weight for h in now(estimator).hypotheses] == [1.0]
    assert (now(estimator).lost, now(estimator).mirrored) == (0.0, 0.0)


# -- sides -------------------------------------------------------------------------------------------------------------


def test_no_side_is_favoured_without_evidence_and_none_is_lost() -> None:
    _, seen = stroll(5, 40.0, config=Config())
    for one in seen:
        assert one.ambiguity.mirrored == pytest.approx(0.5, abs=1e-9)
        twin = se2.compose(HALF_TURN[0], one.estimate.pose)
        assert any(np.linalg.norm(h.pose[:2] - twin[:2]) < 1e-6 for h in one.ambiguity.hypotheses)
    # and the estimate does not jump between the two
    sides = {float(np.linalg.norm(one.error())) < 1.0 for one in seen if one.stamp_s > 5.0}
    assert len(sides) == 1


def test_one_labelled_sight_tells_the_side() -> None:
    estimator = MixtureFilter(Config())
    estimator.start_in(FIELD, 0)
    twin = se2.compose(HALF_TURN[0], START)
    for k in range(3):
        estimator.observe(of_poses(ns(0.1 * k), np.stack([START, twin]), np.log([0.5, 0.5]), -20.0, symmetric=True))
    assert now(estimator).mirrored == pytest.approx(0.5, abs=1e-9)
    estimator.observe(of_poses(ns(10.0), START[None], np.zeros(1), np.log(0.05 / VOLUME)))
    assert now(estimator).mirrored < 0.01
    np.testing.assert_allclose(now(estimator).hypotheses[0].pose, START, atol=0.01)
    assert estimator.events[-1].kind == "decision"


# -- stamps, choices, words --------------------------------------------------------------------------------------------


def play(shift_ns: int) -> tuple[FloatArray, MixtureFilter]:
    random = np.random.default_rng(2)
    estimator = MixtureFilter(Config(), remember=True)
    estimator.start_in(FIELD, shift_ns)
    pose = START
    for k, velocity in enumerate(velocities(40)):
        estimator.predict(Odometry(ns(0.1 * k) + shift_ns, velocity))
        if k % 4 == 0:
            estimator.observe(sight(ns(0.1 * k) + shift_ns, pose, random, decoys=1, wrong=0.0))
        pose = se2.compose(pose, se2.exp(0.1 * velocity))
    return as_table(now(estimator)), estimator


def test_stamps_may_be_negative() -> None:
    np.testing.assert_allclose(play(0)[0], play(-ns(1e5))[0], atol=1e-9)


def test_what_comes_late_or_twice_is_taken_at_once() -> None:
    estimator = started()
    estimator.advance(ns(2))
    for stamp_s in (1.0, 1.0, 2.0):
        estimator.observe(of_poses(ns(stamp_s), START[None], np.zeros(1), -20.0))
        assert now(estimator).stamp_ns == ns(2)
    np.testing.assert_allclose(now(estimator).hypotheses[0].pose, START, atol=1e-6)


def test_the_choices_that_were_right_are_remembered() -> None:
    random = np.random.default_rng(2)
    estimator = MixtureFilter(Config(), remember=True)
    estimator.start_in(LOPSIDED, 0)
    right = []
    for k in range(30):
        truth = START if k < 15 else np.array([-3.0, 2.0, -2.0])  # carried in between
        one = sight(ns(0.3 * k), truth, random, decoys=2, symmetric=False)
        near = np.linalg.norm(one.stacks[0][0].poses[:, :2] - truth[:2], axis=1)  # type: ignore[attr-defined]
        right.append(int(near.argmin()) if near.min() < 0.5 else -1)
        estimator.observe(one)
    best = estimator.sequences(1)[0]
    assert best.choices.tolist() == right
    assert best.births == (
        right.index(next(r for r in right if r >= 0)),
        15 + next(i for i, r in enumerate(right[15:]) if r >= 0),
    )
    assert best.log_weight > np.log(0.9)
    with pytest.raises(ValueError, match="remember"):
        started().sequences(1)


def test_both_sides_are_remembered() -> None:
    _, estimator = play(0)
    one, other = estimator.sequences(2)
    assert {one.copy, other.copy} == {0, 1}
    np.testing.assert_array_equal(one.choices, other.choices)
    assert one.log_weight == pytest.approx(np.log(0.5), abs=0.01)


def test_a_hypothesis_keeps_its_number_and_no_two_have_the_same() -> None:
    _, seen = stroll(9, 20.0, config=Config())
    tracks = [one.ambiguity.hypotheses[0].track for one in seen if one.stamp_s > 5.0]
    assert len(set(tracks)) == 1
    for one in seen:
        numbers = [h.track for h in one.ambiguity.hypotheses]
        assert len(set(numbers)) == len(numbers)
        assert -1 not in numbers


def test_the_compass_offset_settings_are_used() -> None:
    compass = HeadingFactor(0, START[2] + 0.3, np.array([[0.01]]), by_compass=True)
    turned = []
    for sigma in (1e-6, 0.5):
        estimator = started(replace(PLAIN, compass=Compass(offset_sigma_rad=sigma)))
        estimator.update(compass)
        turned.append(abs(now(estimator).hypotheses[0].pose[2] - START[2]))
    assert turned[1] < 0.1 * turned[0]
