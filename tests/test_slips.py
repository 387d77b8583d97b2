"""Robots that move while nothing is seen, by more than their odometry says: they fall, are pushed, are carried."""

import math

import numpy as np
import pytest
from walks import ns

from estimators.config import Config
from estimators.smoother import Smoother
from fieldloc import pose as se2
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray
from fieldloc.regions import Region
from fieldloc.solution_mixture import SolutionMixture
from fieldloc.stacks import PoseStack

ANYWHERE = Region("anywhere", np.array([[-5.0, -4.0, 5.0, 4.0]]), np.array([[0.0, math.pi]]))
SIGMAS = np.array([0.03, 0.03, 0.03])
UNSEEN = slice(100, 160)
STEPS = 260
PUSHED = np.array([0.12, -0.08, 0.2])
CARRIED = np.array([2.0, -1.5, 2.0])
SEEDS = range(4)


def walked(seed: int, moved: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squared errors in standard deviations, and truth less estimate in the robot frame (n, 3), by tenths of a second.

    The robot goes and stands in turns. It is moved, of which its odometry says nothing, at any moment of six seconds in
    which it stands and sees nothing.
    """
    random = np.random.default_rng(seed)
    when = int(random.integers(UNSEEN.start + 1, UNSEEN.stop))
    smoother = Smoother(Config())
    smoother.start_in(ANYWHERE, 0)
    pose, truth = np.array([-1.0, 0.5, 0.3]), []
    for k in range(STEPS):
        goes = k % 40 < 20 and not UNSEEN.start - 10 <= k < UNSEEN.stop + 10
        velocity = np.array([0.2, 0.0, 0.3]) if goes else np.zeros(3)
        smoother.predict(Odometry(ns(0.1 * k), velocity))
        if k == when:
            pose = se2.compose(pose, moved)
        truth.append(pose)
        if k < UNSEEN.start or k >= UNSEEN.stop:
            seen = se2.retract(pose, SIGMAS * random.standard_normal(3))
            stack = PoseStack(seen[None], np.diag(SIGMAS**2)[None])
            log_wrong = math.log(0.05) - ANYWHERE.log_volume
            smoother.observe(
                SolutionMixture(ns(0.1 * k), ((stack, np.full(1, math.log(0.95))),), log_wrong, False, 80.0)
            )
        pose = se2.compose(pose, se2.exp(velocity * 0.1))
    trajectory = smoother.trajectory()
    off = se2.local(np.array([estimate.pose for estimate in trajectory]), np.array(truth))
    spread = np.array([estimate.robot_covariance for estimate in trajectory])
    return np.sum(off * np.linalg.solve(spread, off[..., None])[..., 0], axis=1), off


def test_who_was_pushed_is_where_it_is_seen_again_and_in_between_nobody_claims_to_know() -> None:
    squared, off = zip(*(walked(seed, PUSHED) for seed in SEEDS), strict=True)
    assert np.mean(squared) < 4.0  # 3 where covariances are right
    assert np.mean([each[UNSEEN] for each in squared]) < 6.0
    again = np.array([each[UNSEEN.stop : UNSEEN.stop + 10] for each in off])
    assert np.sqrt(np.mean(again[..., :2] ** 2)) < SIGMAS[0]


def test_who_was_carried_may_be_anywhere_on_the_way_while_nothing_is_seen() -> None:
    squared = [walked(seed, CARRIED)[0] for seed in SEEDS]
    assert np.mean(squared) < 4.0
    assert max(each[UNSEEN].max() for each in squared) < 16.0


@pytest.mark.parametrize("seed", SEEDS)
def test_who_only_stood_unseen_is_doubted_by_nobody(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    _, off = walked(seed, np.zeros(3))
    monkeypatch.setattr("estimators.resolve.with_slips", lambda log, story, answer, config, chosen: (log, answer))
    _, plain = walked(seed, np.zeros(3))
    np.testing.assert_array_equal(off, plain)


def test_who_holds_on_to_its_odometry_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the first test would say without the search for slips."""
    monkeypatch.setattr("estimators.resolve.with_slips", lambda log, story, answer, config, chosen: (log, answer))
    assert np.mean([walked(seed, PUSHED)[0] for seed in SEEDS]) > 6.0
