"""An image that shows much the same as the last one, to robots that saw that one and to those that may be anywhere."""

from collections.abc import Iterator

import numpy as np
import pytest

from fieldloc.field import load_field
from fieldloc.measurements import ImageFeatures, InitialPose
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
                again.remember(message.record, other, np.zeros(3))
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
        in_full, then = (
            np.logaddexp(mixture.log_outlier, mixture.log_integral - LOG_VOLUME) - mixture.log_outlier
            for mixture in (one, again)
        )
        assert then == pytest.approx(in_full / again.wider)


def test_to_a_robot_at_a_known_place_it_is_the_power_of_the_whole_image() -> None:
    """However many solutions lead there."""
    point = np.diag([1e-4, 1e-4, 1e-4]) ** 2
    checked = 0
    for one, again in IMAGES:
        for pose in one.solutions().poses[:3]:
            near = again.expand(pose[None], point[None])
            whole = np.logaddexp.reduce([*near.evidence, *near.log_blind(again, 1)])
            assert whole == pytest.approx(float(one.log_likelihood(pose)) / again.wider, abs=0.02)
            assert again.log_likelihood(pose) == pytest.approx(one.log_likelihood(pose) / again.wider)
            checked += len(near.ids) > 1
    assert checked > 20


def test_who_is_where_nothing_fits_loses_no_more_than_a_share_of_an_image() -> None:
    for one, again in IMAGES:
        if not len(found := one.solutions().poses):
            continue
        poses = np.stack([found[0], [40.0, 0.0, 0.0]])
        near = again.expand(poses, np.tile(np.diag([0.01, 0.01, 0.01]) ** 2, (2, 1, 1)))
        here = np.logaddexp.reduce([*near.evidence[near.parent == 0], near.log_blind(again, 2)[0]])
        there = near.log_blind(again, 2)[1]
        in_full = one.log_likelihood(found[0]) - one.log_outlier
        assert 0.0 < here - there < 1.001 * in_full / again.wider


def test_what_is_derived_of_an_expansion_keeps_what_nothing_being_right_is_worth() -> None:
    again = next(again for one, again in IMAGES if len(one.solutions().ids) > 1)
    poses = again.solutions().poses[:2]
    near = again.expand(poses, np.tile(np.diag([0.1, 0.1, 0.05]) ** 2, (2, 1, 1)))
    turned = near.of(np.eye(3), np.eye(3), np.tile(np.eye(3), (2, 1, 1)))
    for other in (near.take(np.arange(1)), near.likelier(1.0, near.ids), turned):
        np.testing.assert_array_equal(other.log_blind(again, 2), near.log_blind(again, 2))


def test_a_told_pose_makes_no_image_old_news() -> None:
    scenario = load_scenario("quiet")
    builder = MixtureBuilder(FIELD, scenario.vision.camera)
    records = (message.record for message in messages(play(scenario, FIELD, 5)))
    image = next(record for record in records if isinstance(record, ImageFeatures) and builder.build(record))
    told = InitialPose(image.stamp_ns - 10**7, np.zeros(3), np.diag([0.1, 0.1, 0.1]) ** 2)
    mixture = builder.build(told)
    assert mixture is not None
    builder.remember(told, mixture, np.zeros(3))
    assert not isinstance(builder.build(image), RepeatedMixture)
