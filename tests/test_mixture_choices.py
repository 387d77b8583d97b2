"""What the Gaussian sum remembers and says: choices, numbers, stamps; and what it knows of the compass."""

from dataclasses import replace

import numpy as np
import pytest
from pose_sights import (
    FIELD,
    LOPSIDED,
    P3,
    START,
    as_table,
    now,
    of_poses,
    sight,
    started,
    stroll,
)
from scipy.linalg import block_diag
from walks import PLAIN, ns, velocities

from estimators.base import Estimate
from estimators.config import Compass, Config
from estimators.mixture import MixtureFilter
from estimators.mixture.bank import gaussian
from estimators.motion import CALIBRATION, STANDSTILL
from estimators.views import EXTRA, OFFSET
from fieldloc import pose as se2
from fieldloc.factors import HeadingFactor
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray


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


def test_a_compass_is_believed_as_far_as_its_offset_is_known() -> None:
    estimator = started(replace(PLAIN, compass=Compass(offset_sigma_rad=0.2)))
    estimator.update(HeadingFactor(0, START[2] + 0.3, np.array([[0.01]]), by_compass=True))
    gain = P3[2, 2] / (P3[2, 2] + 0.2**2 + 0.01)
    assert now(estimator).hypotheses[0].pose[2] == pytest.approx(START[2] + gain * 0.3, abs=1e-9)
    assert now(estimator).hypotheses[0].covariance[2, 2] == pytest.approx((1.0 - gain) * P3[2, 2], abs=1e-9)


def test_what_was_learnt_of_the_compass_is_forgotten_again() -> None:
    left, gain = Compass(offset_sigma_rad=0.2, offset_s=20.0).wander(1000.0)
    known = block_diag(P3, np.zeros((EXTRA - 1, EXTRA - 1)), 0.01**2)
    bank = gaussian(START, known, np.full(EXTRA, 0.1), copies=1).moved(
        STANDSTILL, np.full(CALIBRATION, 0.1), left, gain
    )
    np.testing.assert_allclose(bank.extra[0], [0.1] * (EXTRA - 1) + [0.0], atol=1e-9)
    assert bank.covariances[0, OFFSET, OFFSET] == pytest.approx(0.2**2)
    np.testing.assert_allclose(bank.poses[0], START)


def test_the_likeliest_child_keeps_the_number() -> None:
    estimator = started()
    before = now(estimator).hypotheses[0].track
    poses = se2.retract(START, np.array([[-0.4, 0.0, 0.0], [0.4, 0.0, 0.0]]))
    estimator.observe(of_poses(1, poses, np.log([0.1, 0.9]), -40.0))
    first, other = now(estimator).hypotheses
    assert first.track == before != other.track
    assert first.pose[0] > START[0] > other.pose[0]


def test_the_compass_offset_is_learnt() -> None:
    estimator = MixtureFilter(replace(PLAIN, compass=Compass(offset_sigma_rad=0.2)))
    estimator.start(Estimate(0, START, np.diag([0.1, 0.1, 1e-5]) ** 2))
    factor = HeadingFactor(0, START[2] + 0.3, np.array([[0.01]]), by_compass=True)
    met = [estimator.update(factor) for _ in range(2)]
    left = [float(one.residual[0]) for one in met if one is not None]
    # of 0.3 rad the offset takes its share of the variance
    np.testing.assert_allclose(left, [-0.3, -0.3 * 0.01 / (0.2**2 + 0.01)], atol=1e-6)
