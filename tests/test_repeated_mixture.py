"""An image that shows much the same as the last one, to robots that saw that one and to those that may be anywhere."""

from collections.abc import Iterator

import numpy as np
import pytest

from fieldloc.field import load_field
from fieldloc.measurements import ImageFeatures
from fieldloc.mixture import MixtureFactor
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.regions import anywhere
from fieldloc.repeated_mixture import RepeatedMixture
from logs.simulate import load_scenario
from logs.simulate.game import play
from logs.simulate.topics import messages

FIELD = load_field("kidsize")
LOG_VOLUME = anywhere(FIELD).log_volume


def images() -> Iterator[tuple[MixtureFactor, RepeatedMixture]]:
    """Each as the first, and as one that comes a fifteenth of a second after another."""
    scenario = load_scenario("quiet")
    alone, again = (MixtureBuilder(FIELD, scenario.vision.camera) for _ in range(2))
    game = play(scenario, FIELD, 5)
    for message in messages(game):
        if isinstance(message.record, ImageFeatures):
            one, other = alone.build(message.record), again.build(message.record)
            if one is not None and other is not None:
                again.remember(other, np.zeros(3))
                if isinstance(other, RepeatedMixture):
                    yield one, other
        if message.log_time_ns > 5 * 10**9:
            return


IMAGES = list(images())


def test_there_are_enough_to_test_with() -> None:
    assert len(IMAGES) > 40
    assert sum(len(one.solutions().ids) > 0 for one, _ in IMAGES) > 10


def test_who_may_be_anywhere_is_found_as_by_the_first_one() -> None:
    for one, again in IMAGES:
        first, then = one.solutions(), again.solutions()
        np.testing.assert_array_equal(then.poses, first.poses)
        np.testing.assert_array_equal(then.covariances, first.covariances)
        np.testing.assert_array_equal(then.ids, first.ids)
        # the shares of the solutions among themselves are the first one's, all of them together are less news
        np.testing.assert_allclose(
            np.ptp(then.log_weights - first.log_weights) if len(first.ids) else 0.0, 0.0, atol=1e-9
        )
        per_pose = again.log_integral - LOG_VOLUME
        assert per_pose == pytest.approx((one.log_integral - LOG_VOLUME) / again.wider)


def test_ids_mean_the_same_for_who_saw_the_last_one() -> None:
    checked = 0
    for _, again in IMAGES:
        found = again.solutions()
        for row in range(min(len(found.ids), 5)):
            (factor,) = again.chosen(int(found.ids[row]))
            np.testing.assert_allclose(factor.error(found.poses[row]), 0.0, atol=1e-9)
            np.testing.assert_allclose(factor.covariance, again.wider * found.covariances[row], rtol=1e-9)
            checked += 1
    assert checked > 20


def test_it_speaks_for_the_lost_as_loudly_as_against_the_misplaced() -> None:
    """An image that fits nowhere but where the robot is: many in a row have to find it as soon as one in full would
    after as many independent ones."""
    for one, again in IMAGES:
        in_full = one.log_integral - LOG_VOLUME - one.log_outlier
        assert again.log_integral - LOG_VOLUME - again.log_outlier == pytest.approx(in_full / again.wider)


def test_where_it_is_known_to_be_it_is_the_wider_one() -> None:
    poses = np.array([[1.0, 2.0, 0.5], [-3.0, 0.0, 3.0]])
    covariances = np.tile(np.diag([0.1, 0.1, 0.05]) ** 2, (2, 1, 1))
    for _, again in IMAGES[:10]:
        np.testing.assert_array_equal(again.log_likelihood(poses), again.again.log_likelihood(poses))
        np.testing.assert_array_equal(
            again.expand(poses, covariances).evidence, again.again.expand(poses, covariances).evidence
        )
        assert (again.symmetric, again.by_compass, again.stamp_ns) == (True, False, again.again.stamp_ns)
