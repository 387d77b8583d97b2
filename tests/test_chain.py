from itertools import pairwise

import numpy as np
import pytest
from walks import ns, velocities

from estimators.chain import Chain, ChainRecorder
from estimators.config import MotionNoise
from estimators.motion import CALIBRATION, HeldVelocity, Increment
from fieldloc import pose as se2
from fieldloc.factors import HeadingFactor
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

STEP = np.array([0.1, 0.02, 0.3])


def step() -> Increment:
    return Increment(STEP, np.diag([1e-4, 2e-4, 3e-4]), np.ones((3, CALIBRATION)))


def heading(stamp_s: float) -> HeadingFactor:
    return HeadingFactor(ns(stamp_s), 0.0, np.eye(1))


def recorded(interval_s: float, known_from: int, steps: int = 10, at: FloatArray | None = None) -> ChainRecorder:
    """Steps of 0.1 s; from the step `known_from` on the filter knows its pose, dead-reckoned from `at`."""
    recorder = ChainRecorder(interval_s)
    pose = np.array([1.0, 2.0, 3.0]) if at is None else at
    recorder.advance(0, None, pose if known_from == 0 else None)
    for k in range(1, steps + 1):
        pose = se2.compose(pose, STEP)
        recorder.advance(ns(0.1 * k), step(), pose if k >= known_from else None)
    return recorder


def chain_of(recorder: ChainRecorder) -> Chain:
    chain = recorder.chain()
    assert chain is not None
    return chain


def test_there_is_no_chain_while_no_pose_is_known() -> None:
    assert ChainRecorder(0.1).chain() is None
    recorder = recorded(0.1, known_from=99)
    recorder.add(heading(1.0), ns(1.0), None)
    assert recorder.chain() is None


@pytest.mark.parametrize(("interval_s", "nodes"), [(0.0, 11), (0.1, 11), (0.25, 4), (0.3, 4), (99.0, 1)])
def test_there_is_a_node_at_least_every_interval(interval_s: float, nodes: int) -> None:
    chain = chain_of(recorded(interval_s, 0))
    assert len(chain.stamps_ns) == len(chain.guess) == nodes
    assert len(chain.motions) == nodes - 1
    assert chain.stamps_ns[0] == 0
    assert all(later - earlier >= interval_s * 1e9 for earlier, later in pairwise(chain.stamps_ns))


def test_the_motion_between_two_nodes_is_all_the_motion_between_them() -> None:
    held = HeldVelocity(MotionNoise())
    recorder = ChainRecorder(0.55)
    steps = []
    for k, command in enumerate(velocities(40)):
        if (moved := held.advance(ns(0.1 * k))) is not None:
            steps.append(moved)
        recorder.advance(ns(0.1 * k), moved, np.zeros(3))
        held.hold(Odometry(ns(0.1 * k), command))
    chain = chain_of(recorder)
    for k, motion in enumerate(chain.motions):
        expected, *others = steps[6 * k : 6 * k + 6]
        for other in others:
            expected = expected.then(other)
        np.testing.assert_array_equal(motion.before_from_after, expected.before_from_after)
        np.testing.assert_array_equal(motion.covariance, expected.covariance)
        np.testing.assert_array_equal(motion.by_calibration, expected.by_calibration)


def test_a_factor_has_a_node_at_its_own_stamp_and_shares_it_with_others() -> None:
    recorder = recorded(99.0, 0, steps=3)
    for factor in (heading(0.3), heading(0.3)):
        recorder.add(factor, ns(0.3), np.array([7.0, 8.0, 0.9]))
    recorder.advance(ns(0.4), step(), np.zeros(3))
    recorder.add(heading(0.4), ns(0.4), np.zeros(3))
    chain = chain_of(recorder)
    assert chain.stamps_ns == (0, ns(0.3), ns(0.4))
    assert [node for node, _ in chain.factors] == [1, 1, 2]
    assert [factor.stamp_ns for _, factor in chain.factors] == [ns(0.3), ns(0.3), ns(0.4)]
    expected = step().then(step()).then(step())
    np.testing.assert_allclose(chain.motions[0].before_from_after, expected.before_from_after, atol=1e-12)
    np.testing.assert_allclose(chain.motions[1].before_from_after, STEP, atol=1e-12)


def test_the_guess_is_what_the_filter_thinks_after_a_factor() -> None:
    recorder = recorded(0.1, 0, steps=3)
    recorder.add(heading(0.3), ns(0.3), np.array([7.0, 8.0, 0.9]))
    chain = chain_of(recorder)
    assert chain.factors[0][0] == 3
    np.testing.assert_array_equal(chain.guess[3], [7.0, 8.0, 0.9])


def test_a_factor_can_be_the_first_thing_of_all() -> None:
    recorder = ChainRecorder(0.1)
    recorder.add(heading(0.0), 0, np.array([1.0, 2.0, 3.0]))
    chain = chain_of(recorder)
    assert chain.stamps_ns == (0,)
    assert chain.motions == ()
    np.testing.assert_array_equal(chain.guess, [[1.0, 2.0, 3.0]])


def test_before_the_first_known_pose_the_guess_goes_back_along_the_motion() -> None:
    late, early = chain_of(recorded(0.1, known_from=6)), chain_of(recorded(0.1, known_from=0))
    np.testing.assert_allclose(late.guess[:, :2], early.guess[:, :2], atol=1e-12)
    np.testing.assert_allclose(se2.wrap(late.guess[:, 2] - early.guess[:, 2]), 0.0, atol=1e-12)


def test_where_a_later_pose_is_not_known_the_guess_goes_on_along_the_motion() -> None:
    recorder = recorded(0.1, 0, steps=2)
    recorder.advance(ns(0.3), step(), None)
    chain, known = chain_of(recorder), chain_of(recorded(0.1, 0, steps=3))
    np.testing.assert_allclose(chain.guess, known.guess, atol=1e-12)


def test_a_robot_that_was_carried_may_have_come_from_anywhere() -> None:
    there = np.array([-5.0, 4.0, 1.0])
    recorder = recorded(0.1, 0, steps=6)
    pose = chain_of(recorder).guess[-1]
    for k in range(7, 11):  # it is elsewhere from 0.7 s, found at 1.0 s
        pose = there if k == 10 else se2.compose(pose, STEP)
        recorder.advance(ns(0.1 * k), step(), pose)
    straight = chain_of(recorder)
    chain = recorder.chain([(ns(0.7), ns(1.0))])
    assert chain is not None
    for k, (motion, before) in enumerate(zip(chain.motions, straight.motions, strict=True)):
        np.testing.assert_array_equal(motion.before_from_after, before.before_from_after)
        assert np.array_equal(motion.covariance, before.covariance) == (k != 6)
    assert np.diag(chain.motions[6].covariance).min() >= 10.0**2
    np.testing.assert_array_equal(chain.guess[:7], straight.guess[:7])
    back = there
    for k in range(10, 6, -1):
        np.testing.assert_allclose(chain.guess[k], back, atol=1e-12)
        back = se2.compose(back, se2.inverse(STEP))


def test_a_robot_found_elsewhere_from_the_first_node_on_needs_no_cut() -> None:
    recorder = recorded(0.1, 0, steps=4)
    chain = recorder.chain([(0, ns(0.2))])
    assert chain is not None
    for motion in chain.motions:
        np.testing.assert_array_equal(motion.covariance, step().covariance)
