"""Landmarks that stand beside their places on the map, in the covariances of a whole log's poses."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.bounds import KNOWN, range_bearing, walk
from estimators import resolve
from estimators.chain import Chain, Recorded
from estimators.chosen import Chosen
from estimators.config import Config, Sensor, Survey
from estimators.copies import Moved
from estimators.copies import moved as moved_factor
from estimators.smoother import Smoother
from estimators.solution import Solution
from estimators.surveyed_errors import with_survey
from estimators.surveyed_map import with_survey_sigma
from fieldloc import pose as se2
from fieldloc.measurements import LandmarkScan, Measurement, Odometry
from fieldloc.mixture import IntArray
from fieldloc.mixture_builder import MixtureBuilder
from fieldloc.pose import FloatArray
from fieldloc.repetition import ErrorCorrelation, inflation
from logs.recording import Recording
from logs.replay import replay

SIGMA_M = 0.08
EXACT = replace(KNOWN, survey=Survey(0.0))
EYES = replace(EXACT, sensor=Sensor())
MOUNT = np.array([0.2, -0.1, 0.4])
NOWHERE = np.diag([3.0, 3.0, 3.0]) ** 2


def solved(recording: Recording, config: Config) -> Solution:
    return both(recording, config)[1]


def both(recording: Recording, config: Config) -> tuple[Solution, Solution]:
    """Without and with what the survey adds."""
    smoother = Smoother(config)
    replay(recording, smoother, None, config)
    assert smoother.resolution is not None
    return smoother.resolution.candidates[0].solution, smoother.resolution.solution


def moved(recording: Recording, by: FloatArray) -> Recording:
    """On a map that has its landmarks elsewhere."""
    pairs = zip(recording.field.landmarks, by, strict=True)
    marks = tuple(replace(mark, position=mark.position + off) for mark, off in pairs)
    return replace(recording, field=replace(recording.field, landmarks=marks))


def known_to(recording: Recording, covariance: FloatArray, landmark: int) -> Recording:
    """On a map that says so of one landmark."""
    marks = list(recording.field.landmarks)
    marks[landmark] = replace(marks[landmark], covariance=covariance)
    return replace(recording, field=replace(recording.field, landmarks=tuple(marks)))


def thinned(recording: Recording, mount: FloatArray) -> Recording:
    """Every second scan sees one landmark only; by a sensor that is mounted there."""
    out = list[Measurement]()
    for k, one in enumerate(recording.measurements):
        if isinstance(one, LandmarkScan):
            seen = one.range_bearing[:, :1] * np.column_stack(
                [np.cos(one.range_bearing[:, 1]), np.sin(one.range_bearing[:, 1])]
            )
            there = se2.apply(se2.inverse(mount), seen)
            polar = np.column_stack([np.hypot(*there.T), np.arctan2(there[:, 1], there[:, 0])])
            rows = slice(k // 3 % 6, k // 3 % 6 + 1) if k % 2 else slice(None)
            one = LandmarkScan(one.stamp_ns, one.labels[rows], polar[rows], one.covariance[rows], mount)
        out.append(one)
    return replace(recording, measurements=tuple(out))


def squares(solution: Solution, truth: FloatArray) -> float:
    """NEES over 3, now and then."""
    error = se2.local(solution.poses, truth)[::20]
    return float(
        np.mean(np.sum(error * np.linalg.solve(solution.covariances[::20], error[..., None])[..., 0], axis=1)) / 3
    )


def test_errors_are_as_large_as_is_said_where_the_map_is_wrong_and_says_nothing_or_says_so() -> None:
    found = []
    for seed in range(10):
        one = walk(seed, 8.0)
        wrong = moved(one.recording, SIGMA_M * np.random.default_rng(1000 + seed).standard_normal((6, 2)))
        stated = replace(wrong, field=with_survey_sigma(wrong.field, SIGMA_M))
        unsaid = both(wrong, replace(EXACT, survey=Survey(SIGMA_M)))
        found.append([squares(each, one.poses) for each in (*unsaid, *both(stated, EXACT))])
    taken_as_exact, unsaid, as_noise, said = np.mean(found, axis=0)
    # the errors of one log's poses are mostly the same: about 3 numbers of each of 10, whose mean is off by 0.26
    assert min(taken_as_exact, as_noise) > 2.0
    assert 0.4 < unsaid < 1.6
    assert 0.4 < said < 1.6


@pytest.mark.parametrize(("config", "mount"), [(EXACT, np.zeros(3)), (EYES, MOUNT)], ids=["plain", "eyes"])
def test_the_answer_changes_with_a_landmark_as_is_reckoned_with(config: Config, mount: FloatArray) -> None:
    log = thinned(walk(3, 8.0).recording, mount)
    off_m, sigma_m = 5e-3, 1e-3  # so little that no scan is read in another way for it
    plain = solved(log, config)
    for landmark, axis in ((0, 0), (4, 1)):
        by, covariance = np.zeros((6, 2)), np.zeros((2, 2))
        by[landmark, axis], covariance[axis, axis] = off_m, sigma_m**2
        there = solved(moved(log, by), config)
        change = se2.local(plain.poses, there.poses) / off_m
        known, doubted = both(known_to(log, covariance, landmark), config)
        np.testing.assert_array_equal(doubted.poses, known.poses)
        np.testing.assert_allclose(doubted.poses, plain.poses, atol=1e-5)
        grown = (doubted.covariances - known.covariances) / sigma_m**2
        np.testing.assert_allclose(grown, change[:, :, None] * change[:, None, :], atol=4e-3)
        assert np.abs(change).max() > 0.1
        common = np.array([*there.calibration, *there.sensor]) - np.array([*plain.calibration, *plain.sensor])
        grown = (doubted.global_covariance - known.global_covariance) / sigma_m**2
        np.testing.assert_allclose(grown, np.outer(common, common) / off_m**2, atol=4e-3)


def test_a_map_that_is_off_as_a_whole_moves_all_poses_by_as_much() -> None:
    log = thinned(walk(4, 6.0).recording, MOUNT)
    sigma_m = 0.02
    known, doubted = both(log, replace(EYES, survey=Survey(sigma_m)))
    grown = se2.rotate_covariance(doubted.covariances - known.covariances, doubted.poses[:, 2])
    # the mean of six that are independent is the least that any weighted mean of them can vary by
    assert np.linalg.eigvalsh(grown[:, :2, :2]).min() > 0.99 * sigma_m**2 / 6
    assert (np.diagonal(doubted.global_covariance) >= np.diagonal(known.global_covariance)).all()


@pytest.mark.parametrize("config", [EYES, replace(Config(), survey=Survey(SIGMA_M))], ids=["known", "shipped"])
def test_both_engines_say_the_same(config: Config) -> None:
    log = moved(thinned(walk(5, 6.0).recording, MOUNT), SIGMA_M * np.random.default_rng(5).standard_normal((6, 2)))
    stated = replace(log, field=with_survey_sigma(log.field, SIGMA_M)) if config is EYES else log
    one, other = (
        solved(stated, replace(config, graph=replace(config.graph, engine=engine))) for engine in ("chain", "gtsam")
    )
    np.testing.assert_allclose(other.poses, one.poses, atol=1e-4)
    sigmas = np.sqrt(np.diagonal(one.covariances, axis1=1, axis2=2))
    scale = sigmas[:, :, None] * sigmas[:, None, :]
    np.testing.assert_allclose(other.covariances / scale, one.covariances / scale, atol=0.01)


def test_where_each_scan_stands_alone_a_wrong_map_counts_once_however_it_is_said() -> None:
    log = walk(6, 3.0).recording
    odometry = [replace(one, covariance=NOWHERE) for one in log.measurements if isinstance(one, Odometry)]
    scans = [one for one in log.measurements if isinstance(one, LandmarkScan)]
    measurements = sorted([*odometry, *scans], key=lambda one: (one.stamp_ns, isinstance(one, LandmarkScan)))
    lost = replace(log, measurements=tuple(measurements))
    stated = replace(lost, field=with_survey_sigma(log.field, SIGMA_M))
    as_noise, said = both(stated, EXACT)
    _, unsaid = both(lost, replace(EXACT, survey=Survey(SIGMA_M)))
    for other, tolerance in ((as_noise, 0.1), (unsaid, 0.3)):
        ratio = np.trace(said.covariances, axis1=1, axis2=2) / np.trace(other.covariances, axis1=1, axis2=2)
        np.testing.assert_allclose(ratio, 1.0, atol=tolerance)


def test_on_a_field_that_is_moved_it_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[tuple[Recorded, IntArray, Chain, Solution, Config]] = []

    def listened(
        recorded: Recorded, choices: IntArray, chosen: Chosen, chain: Chain, solution: Solution, config: Config
    ) -> Solution:
        heard.append((recorded, choices, chain, solution, config))
        return with_survey(recorded, choices, chosen, chain, solution, config)

    monkeypatch.setattr(resolve, "with_survey", listened)
    log = thinned(walk(7, 4.0).recording, MOUNT)
    for landmark in range(6):
        log = known_to(log, np.diag([SIGMA_M, 0.0]) ** 2, landmark)
    here = solved(log, EYES)
    recorded, choices, chain, solution, config = heard[0]
    by = np.array([0.5, -2.0, 1.2])
    recorded = replace(recorded, mixtures=tuple((node, Moved(mixture, by)) for node, mixture in recorded.mixtures))
    factors = tuple((node, moved_factor(factor, by)) for node, factor in chain.factors)
    chain = replace(chain, factors=factors, guess=se2.compose(by, chain.guess))
    solution = replace(solution, poses=se2.compose(by, solution.poses))
    there = with_survey(recorded, choices, Chosen(), chain, solution, config)
    assert (here.covariances - solution.covariances)[:, 0, 0].max() > 0.1 * SIGMA_M**2
    np.testing.assert_allclose(there.covariances, here.covariances, rtol=1e-6, atol=1e-9)


def test_a_map_that_is_exact_adds_nothing() -> None:
    log = walk(8, 3.0).recording
    known, same = both(log, EXACT)
    np.testing.assert_array_equal(same.covariances, known.covariances)
    measured = replace(log, field=with_survey_sigma(log.field, 1e-4))  # by cameras on the ceiling
    known, same = both(measured, replace(EXACT, survey=Survey(0.5)))
    np.testing.assert_array_equal(same.covariances, known.covariances)


def test_for_eyes_that_are_next_to_perfect_what_is_left_is_the_map() -> None:
    one_walk, sigma_m = walk(10, 4.0), 0.02
    measurements = list[Measurement]()
    for one in one_walk.recording.measurements:
        if isinstance(one, LandmarkScan):
            pose = one_walk.poses[np.searchsorted(one_walk.stamps_ns, one.stamp_ns)]
            one = replace(one, range_bearing=range_bearing(pose), covariance=1e-4 * one.covariance)
        elif isinstance(one, Odometry):
            one = replace(one, covariance=NOWHERE)
        measurements.append(one)
    wrong = moved(one_walk.recording, sigma_m * np.random.default_rng(10).standard_normal((6, 2)))
    wrong = replace(wrong, field=with_survey_sigma(wrong.field, sigma_m), measurements=tuple(measurements))
    said = solved(wrong, replace(EXACT, correlation=ErrorCorrelation()))
    scans = slice(0, None, 2)
    widths = np.linalg.eigvalsh(said.covariances[scans, :2, :2])
    # the mean of six is the best that can be had
    assert widths.min() > 0.99 * sigma_m**2 / 6
    assert widths.max() < 0.5 * sigma_m**2
    error = se2.local(said.poses, one_walk.poses)[scans]
    squares_of_all = np.sum(error * np.linalg.solve(said.covariances[scans], error[..., None])[..., 0], axis=1)
    assert squares_of_all.max() < 16.3  # chi-square of 3, once in a thousand


@pytest.mark.parametrize("landmarks", [6, 1], ids=["as a pose", "one by one"])
def test_a_wrong_place_on_the_map_is_no_news_in_the_next_scan(landmarks: int) -> None:
    one_walk = walk(9, 0.4)
    log, pose = one_walk.recording, one_walk.poses[0]
    field = with_survey_sigma(log.field, SIGMA_M)
    builder = MixtureBuilder(field, correlation=ErrorCorrelation(range_s=3.0, bearing_s=3.0))
    said = []
    for one in log.measurements:
        if isinstance(one, LandmarkScan):
            # next to nothing but the map's errors
            rows = slice(landmarks)
            exact = LandmarkScan(one.stamp_ns, one.labels[rows], one.range_bearing[rows], 1e-4 * one.covariance[rows])
            mixture = builder.build(exact)
            assert mixture is not None
            near = mixture.expand(pose[None], np.diag([0.3, 0.3, 0.3])[None] ** 2)
            said.append(mixture.chosen(int(near.ids[np.argmax(near.evidence)]))[0].covariance)
            builder.remember(exact, mixture, pose)
    first, second, _ = said
    np.testing.assert_allclose(
        second[:2, :2], inflation(np.array(0.2), 3.0) * first[:2, :2], rtol=0.05, atol=0.1 * SIGMA_M**2
    )
