from dataclasses import replace

import numpy as np
from simulated_games import IDEAL, KIDSIZE, game, generator

from fieldloc import pose as se2
from fieldloc.pose import FloatArray
from logs.simulate.compass import Headings, point_north
from logs.simulate.course import Course
from logs.simulate.settings import CompassSettings, FallSettings

PERFECT = IDEAL.compass
COURSE = game(replace(IDEAL, duration_s=600.0)).course


def _headings(settings: CompassSettings, seed: int = 0, course: Course = COURSE) -> Headings:
    return point_north(course, KIDSIZE.bounds, settings, generator(seed))


def _errors(headings: Headings, course: Course = COURSE) -> FloatArray:
    return se2.wrap(headings.headings_rad - course.poses_at(headings.stamps_ns)[:, 2])


def test_without_errors_a_compass_tells_the_heading_ten_times_a_second() -> None:
    headings = _headings(PERFECT)
    np.testing.assert_allclose(_errors(headings), 0.0, atol=1e-12)
    assert len(headings.stamps_ns) == 6000
    assert abs(np.diff(headings.stamps_ns).mean() - 1e8) < 1e5
    assert np.all(np.diff(headings.stamps_ns) > 0)


def test_without_a_rate_there_is_no_compass() -> None:
    assert len(_headings(replace(PERFECT, rate_hz=0.0)).stamps_ns) == 0


def test_iron_on_the_robot_errs_like_a_sine_of_the_heading() -> None:
    headings = _headings(replace(PERFECT, hard_iron=(0.1, 0.1)))
    iron = headings.magnetics.hard_iron
    assert abs(np.hypot(*iron) - 0.1) < 1e-12
    # north plus iron, seen from the robot: atan2 by hand
    true = COURSE.poses_at(headings.stamps_ns)[:, 2]
    expected = np.arctan2(np.sin(true) - iron[1], np.cos(true) + iron[0]) - true
    np.testing.assert_allclose(_errors(headings), se2.wrap(expected), atol=1e-12)
    # for weak iron about -(iron across north)
    across = -(iron[0] * np.sin(true) + iron[1] * np.cos(true))
    assert np.abs(_errors(headings) - across).max() < 0.1**2
    assert np.abs(_errors(headings)).max() > 0.09


def test_a_wrong_north_errs_by_the_same_everywhere() -> None:
    headings = _headings(replace(PERFECT, declination_rad=(0.1, 0.2)))
    assert 0.1 <= headings.magnetics.declination_rad <= 0.2
    np.testing.assert_allclose(_errors(headings), headings.magnetics.declination_rad, atol=1e-12)


def test_steel_errs_beside_it_and_nowhere_else() -> None:
    headings = _headings(replace(PERFECT, steel_places=4, steel_strength=(0.4, 0.4), steel_radius_m=0.5))
    places, strengths = headings.magnetics.steel[:, :2], headings.magnetics.steel[:, 2:]
    np.testing.assert_allclose(np.hypot(*strengths.T), 0.4)
    distance = np.linalg.norm(COURSE.poses_at(headings.stamps_ns)[:, None, :2] - places, axis=-1)
    errors = _errors(headings)
    near, far = distance.min(axis=1) < 0.5, distance.min(axis=1) > 2.5
    assert near.sum() > 20
    assert far.sum() > 20
    # five radii away: 0.4 * exp(-12.5) = 1.5e-6 from each
    assert np.abs(errors[far]).max() < 6e-6
    field = np.array([1.0, 0.0]) + sum(
        np.exp(-0.5 * (distance[:, [k]] / 0.5) ** 2) * strength for k, strength in enumerate(strengths)
    )
    np.testing.assert_allclose(errors, -np.arctan2(field[:, 1], field[:, 0]), atol=1e-12)
    assert np.abs(errors[near]).max() > 0.02


def test_iron_wanders_with_the_root_of_time() -> None:
    ends = []
    for seed in range(60):
        errors = _errors(_headings(replace(PERFECT, hard_iron_walk_per_sqrt_s=0.004), seed))
        ends.append(errors[-1])
    # 0.004 * sqrt(600 s) = 0.098 across north; a deviation's standard error of 60 is 9 %, four of these
    assert abs(np.std(ends) / 0.098 - 1.0) < 0.37


def test_noise_is_white_and_of_the_size_that_is_said() -> None:
    errors = _errors(_headings(replace(PERFECT, sigma_rad=0.05)))
    # standard errors of 6000: 1.3 % of the mean's unit, 0.9 % of the deviation; four of these
    assert abs(np.mean(errors)) < 0.0026
    assert abs(np.std(errors) / 0.05 - 1.0) < 0.037
    assert abs(np.corrcoef(errors[:-1], errors[1:])[0, 1]) < 0.052


def test_motors_add_noise_in_bursts_while_the_robot_walks() -> None:
    settings = replace(PERFECT, motor_bursts_per_min=4.0, motor_burst_s=(1.0, 3.0), motor_sigma_rad=0.3)
    headings = _headings(settings)
    loud = np.abs(_errors(headings)) > 1e-9
    walking = COURSE.walking[COURSE.index_at(headings.stamps_ns)]
    assert not np.any(loud & ~walking)
    # 40 bursts of 2 s: 80 of 600 s, less where two overlap, most of it walking; a fifth is chance
    assert 0.07 < loud.mean() < 0.2
    assert abs(np.std(_errors(headings)[loud]) / 0.3 - 1.0) < 0.15
    edges = np.sum(loud[1:] & ~loud[:-1])
    assert 20 < edges < 80


def test_a_fallen_robots_compass_is_of_little_use() -> None:
    course = game(replace(IDEAL, duration_s=300.0, falls=FallSettings(at_s=tuple(range(10, 300, 20))))).course
    headings = _headings(replace(PERFECT, fallen_sigma_rad=0.5), course=course)
    errors = _errors(headings, course)
    fallen = ~course.upright[course.index_at(headings.stamps_ns)]
    assert fallen.sum() > 500
    np.testing.assert_allclose(errors[~fallen], 0.0, atol=1e-12)
    assert abs(np.std(errors[fallen]) / 0.5 - 1.0) < 0.13


def test_switching_one_error_off_leaves_the_others_as_they_were() -> None:
    everything = CompassSettings(motor_bursts_per_min=0.0)
    quiet = _headings(replace(everything, sigma_rad=0.0))
    noisy = _headings(everything)
    np.testing.assert_array_equal(noisy.stamps_ns, quiet.stamps_ns)
    np.testing.assert_array_equal(noisy.magnetics.steel, quiet.magnetics.steel)
    noise = se2.wrap(noisy.headings_rad - quiet.headings_rad)
    alone = _errors(_headings(replace(PERFECT, sigma_rad=everything.sigma_rad)))
    np.testing.assert_allclose(noise, alone, atol=1e-12)
