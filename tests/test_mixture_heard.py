"""Who is found on the field has not heard what the compass said just before; it speaks of him all the same."""

import numpy as np
import pytest
from pose_sights import FIELD, HALF_TURN, VOLUME, now, of_poses
from walks import ns

from estimators.base import Estimate
from estimators.config import Compass as Settings
from estimators.config import Config
from estimators.mixture import MixtureFilter
from estimators.mixture.heard import Heard
from fieldloc import pose as se2
from fieldloc.heading_mixture import HeadingMixture
from fieldloc.pose import FloatArray
from fieldloc.told_mixture import told_mixture

TRUTH = np.array([-3.6, -2.0, 1.6])
SIGMA_RAD = 0.25
NO = np.array(False)
ROOM = float(np.log(VOLUME / 2.0))


def heading(stamp_s: float, wider: float) -> HeadingMixture:
    return HeadingMixture(ns(stamp_s), TRUTH[2], SIGMA_RAD, wider, 80.0)


def told(pose: FloatArray) -> MixtureFilter:
    """A robot that was told wrongly, and has heard one compass reading."""
    estimator = MixtureFilter(Config())
    estimator.start_in(FIELD, 0)
    estimator.observe(told_mixture(0, pose, np.diag([0.1, 0.1, 0.05]) ** 2, 0.05, FIELD))
    estimator.observe(heading(0.05, 1.0))
    return estimator


def test_a_wrong_start_does_not_put_the_robot_on_the_other_side_against_the_compass() -> None:
    estimator = told(TRUTH + [0.2, -0.2, -0.17])
    for k in range(1, 30):
        estimator.observe(heading(0.1 * k, 100.0))
        both = np.concatenate([TRUTH[None], se2.compose(HALF_TURN, TRUTH)])
        estimator.observe(of_poses(ns(0.1 * k + 0.02), both, np.full(2, np.log(0.5)), np.log(0.05) - ROOM, True))
    found = now(estimator)
    np.testing.assert_allclose(found.hypotheses[0].pose, TRUTH, atol=0.05)
    assert found.mirrored < 0.02


def test_what_was_heard_says_which_way_the_found_robot_looks() -> None:
    heard = Heard(heading(1.0, 50.0)).turned(0.3)
    headings = TRUTH[2] + 0.3 + np.array([0.0, 0.2, np.pi])
    share = heard.log_share(headings, Settings(), ns(1.2), carried=NO)
    assert share[0] > share[1] > 0.0
    assert share[2] == pytest.approx(np.log(0.1), abs=0.01)  # disturbed, and pointing there by chance
    every = heard.log_share(np.linspace(-np.pi, np.pi, 720, endpoint=False), Settings(), ns(1.2), carried=NO)
    assert np.mean(np.exp(every)) == pytest.approx(1.0, abs=1e-6)


def test_who_was_carried_may_have_been_turned_since_the_compass_spoke() -> None:
    heard, headings = Heard(heading(1.0, 50.0)), np.linspace(-np.pi, np.pi, 720, endpoint=False)
    share, surely = (heard.log_share(headings, Settings(), ns(1.2), carried=one) for one in (~NO, NO))
    assert np.mean(np.exp(share)) == pytest.approx(1.0, abs=1e-6)
    assert np.exp(share.min()) == pytest.approx(0.5 * (1.0 + np.exp(surely.min())))


def test_the_first_reading_after_a_robot_was_carried_counts_as_one() -> None:
    estimator = MixtureFilter(Config())
    estimator.start(Estimate(0, TRUTH, np.diag([0.1, 0.1, 0.05]) ** 2))
    estimator.observe(heading(0.05, 1.0))
    elsewhere = np.array([2.0, 1.0, TRUTH[2] - np.pi])  # it was turned by half a turn while it was carried
    both = np.concatenate([elsewhere[None], se2.compose(HALF_TURN, elsewhere)])
    estimator.observe(heading(0.95, 100.0))
    for k in range(4):
        stamp_ns = ns(1.0 + 0.05 * k)
        estimator.observe(of_poses(stamp_ns, both, np.full(2, np.log(0.5)), np.log(0.05) - ROOM, True))
    assert now(estimator).mirrored < 0.2  # by what it said before
    turned = HeadingMixture(ns(1.25), float(se2.wrap(elsewhere[2])), SIGMA_RAD, 100.0, 80.0)
    estimator.observe(turned)
    found = now(estimator)
    np.testing.assert_allclose(found.hypotheses[0].pose, elsewhere, atol=0.05)
    assert found.mirrored < 0.5


@pytest.mark.parametrize("heard", [Heard(), Heard(heading(1.0, 50.0))])
def test_what_was_never_said_or_long_ago_says_nothing(heard: Heard) -> None:
    np.testing.assert_array_equal(heard.log_share(np.array([0.0, 1.0]), Settings(), ns(2.5), carried=~NO), [0.0, 0.0])
