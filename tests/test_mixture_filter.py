"""The Gaussian sum against the exact answer, and what it owes beyond the contract suite."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from pose_sights import (
    FIELD,
    HALF_TURN,
    LOPSIDED,
    OWN_HALF,
    P3,
    SIGMAS,
    START,
    VOLUME,
    as_table,
    now,
    of_poses,
    sight,
    started,
    stroll,
)
from walks import PLAIN, Event, feed, ns, velocities

from estimators.base import Estimate
from estimators.config import Config, Mixture
from estimators.ekf import Ekf
from estimators.mixture import MixtureFilter, merge
from estimators.mixture.bank import EXTRA, gaussian
from estimators.mixture.sides import Sides
from fieldloc import pose as se2
from fieldloc.detection import Detection
from fieldloc.factors import HeadingFactor, LandmarkFactor, PoseFactor
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan, Odometry
from fieldloc.pose import FloatArray
from fieldloc.regions import Region
from fieldloc.scan_mixture import scan_mixture

EXACT = Mixture(max_hypotheses=5000, prune_below=1e-15, evidence_share=1.0, kidnaps_per_min=0.0)
LITERAL = replace(PLAIN, mixture=EXACT)


def log_normal(error: FloatArray, covariance: FloatArray) -> float:
    return float(-0.5 * (error @ np.linalg.solve(covariance, error) + np.linalg.slogdet(2 * np.pi * covariance)[1]))


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


def test_what_can_be_told_apart_is_not_merged() -> None:
    estimator = MixtureFilter(replace(PLAIN, mixture=EXACT))
    estimator.start_in(LOPSIDED, 0)
    poses = se2.retract(START, np.array([[0.0, 0.0, 0.0], [3.0 * SIGMAS[0], 0.0, 0.0]]))
    estimator.observe(of_poses(0, poses, np.log([0.6, 0.4]), -40.0))
    np.testing.assert_allclose([h.weight for h in now(estimator).hypotheses], [0.6, 0.4], atol=1e-9)


def test_the_unlikely_that_is_known_more_precisely_is_not_lost_in_the_likely() -> None:
    wide = gaussian(START, np.diag([0.1, 0.1, 0.05, *np.ones(EXTRA)]) ** 2, np.zeros(EXTRA), 1)
    there = se2.retract(START, np.array([0.2, 0.0, 0.15]))
    precise = gaussian(there, np.diag([0.02, 0.02, 0.02, *np.ones(EXTRA)]) ** 2, np.zeros(EXTRA), 1)
    bank = wide.joined(replace(precise, log_weights=np.log([[0.002]])))
    kept, _ = merge.merged(bank, Sides.of(np.zeros((0, 3))))
    assert len(kept) == 2


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


def test_only_scans_are_tempered_again() -> None:
    # of images and compass readings those who made them have seen to it
    places = np.array([[-2.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    post = Landmark("post", np.array([-1.0, 0.0]), 0.1, np.zeros((2, 2)))  # ahead of the first place only
    field = FieldMap("one post", np.zeros((0, 2, 2)), np.zeros((0, 3)), (post,))
    ahead = LandmarkScan(0, (None,), np.array([[1.0, 0.0]]), np.diag([0.5, 0.5])[None] ** 2)
    scan = scan_mixture(ahead, field, Detection(), np.ones((1, 2)))
    assert scan is not None
    for again, share in ((scan, 0.1), (of_poses(0, places, np.log([0.8, 0.1]), -20.0), 1.0)):
        gained = {}
        for evidence_share in (0.1, 1.0):
            estimator = MixtureFilter(replace(PLAIN, mixture=replace(EXACT, evidence_share=evidence_share)))
            estimator.start_in(LOPSIDED, 0)
            estimator.observe(of_poses(0, places, np.log([0.5, 0.5]), -20.0))
            odds = []
            for _ in range(2):
                estimator.observe(again)
                here = {hypothesis.pose[0] < 0.0: hypothesis.weight for hypothesis in now(estimator).hypotheses}
                odds.append(np.log(here[True] / here[False]))
            gained[evidence_share] = odds[1] - odds[0]
        assert gained[1.0] > 0.1
        assert gained[0.1] == pytest.approx(share * gained[1.0], rel=1e-6)


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


def test_a_pose_and_its_twin_are_found_as_one_is() -> None:
    estimator = MixtureFilter(LITERAL)
    estimator.start_in(FIELD, 0)
    both = np.stack([START, se2.compose(HALF_TURN[0], START)])
    estimator.observe(of_poses(0, both, np.log([0.8, 0.8]), np.log(0.2 / VOLUME), symmetric=True))
    assert now(estimator).lost == pytest.approx(0.2 / (0.8 + 0.8 + 0.2), abs=1e-9)
    assert now(estimator).mirrored == pytest.approx(0.5, abs=1e-9)


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


@pytest.mark.parametrize("where", [START, se2.compose(HALF_TURN[0], START)], ids=["here", "there"])
def test_one_labelled_sight_tells_the_side(where: FloatArray) -> None:
    estimator = MixtureFilter(Config())
    estimator.start_in(FIELD, 0)
    twin = se2.compose(HALF_TURN[0], START)
    for k in range(3):
        estimator.observe(of_poses(ns(0.1 * k), np.stack([START, twin]), np.log([0.5, 0.5]), -20.0, symmetric=True))
    assert now(estimator).mirrored == pytest.approx(0.5, abs=1e-9)
    estimator.observe(of_poses(ns(10.0), where[None], np.zeros(1), np.log(0.05 / VOLUME)))
    assert now(estimator).mirrored < 0.01
    np.testing.assert_allclose(now(estimator).hypotheses[0].pose, where, atol=0.01)
    assert estimator.events[-1].kind == "decision"


# -- when there is an estimate -----------------------------------------------------------------------------------------


def test_a_coins_toss_is_no_estimate_and_what_was_one_stays_one() -> None:
    estimator = MixtureFilter(LITERAL)
    estimator.start_in(LOPSIDED, 0)
    poses = se2.retract(START, np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.3]]))
    estimator.observe(of_poses(0, poses, np.log([0.6, 0.4]), -40.0))
    assert estimator.estimate() is None
    likeliest = estimator.likeliest()
    assert likeliest is not None
    np.testing.assert_array_equal(likeliest.pose, now(estimator).hypotheses[0].pose)
    estimator.observe(of_poses(0, poses, np.log([1e-3, 1.0]), -40.0))
    estimate = estimator.estimate()
    assert estimate is not None
    np.testing.assert_allclose(estimate.pose, poses[1], atol=1e-6)
    # doubt that comes later leaves it, and says itself
    estimator.observe(of_poses(0, poses, np.log([0.9, 0.01]), -40.0))
    assert now(estimator).hypotheses[0].weight < 0.99
    assert estimator.estimate() is not None
    estimator.start_in(LOPSIDED, 1)
    assert estimator.estimate() is None


def test_the_side_need_not_be_known_for_an_estimate() -> None:
    estimator = MixtureFilter(LITERAL, HALF_TURN)
    estimator.start_in(replace(OWN_HALF, symmetries=HALF_TURN), 0)
    both = np.stack([START, se2.compose(HALF_TURN[0], START)])
    estimator.observe(of_poses(0, both, np.log([0.5, 0.5]), -40.0))
    estimator.observe(of_poses(0, both, np.log([0.5, 0.5]), -40.0))
    assert estimator.estimate() is not None


def test_a_scan_that_shows_the_same_again_tells_little_of_being_lost() -> None:
    places = np.array([[2.0, 0.0], [2.0, 1.5], [-1.0, 2.0], [-2.0, -1.0]])
    landmarks = tuple(Landmark(str(i), place, 0.1, np.zeros((2, 2))) for i, place in enumerate(places))
    field = FieldMap("field", np.zeros((0, 2, 2)), np.zeros((0, 3)), landmarks)
    beside = LandmarkScan(0, (None,), np.array([[1.0, 1.2]]), np.diag([0.05, 0.02])[None] ** 2)
    lost = []
    for share in (1.0, 0.3):
        estimator = MixtureFilter(replace(PLAIN, mixture=Mixture(evidence_share=share)))
        estimator.start_in(Region("field", np.array([[-3.0, -3.0, 3.0, 3.0]]), np.array([[0.0, np.pi]])), 0)
        estimator.start(Estimate(0, np.zeros(3), np.diag([0.05, 0.05, 0.03]) ** 2))
        for stamp_ns in range(0, 800_000_000, 100_000_000):
            seen = scan_mixture(replace(beside, stamp_ns=stamp_ns), field, Detection(), np.ones((4, 2)))
            assert seen is not None
            estimator.observe(seen)
        lost.append(now(estimator).lost)
    assert lost[0] > 0.99
    assert lost[1] < 0.5  # eight sights count as three
