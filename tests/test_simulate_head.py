"""A simulated head sweeps, looks at the ball, and keeps to its joints' limits."""

from dataclasses import replace

import numpy as np
import pytest
from sight_course import standing

from fieldloc import pose as se2
from logs.simulate.head import head_motion
from logs.simulate.vision_settings import HeadSettings

NO_BALL = HeadSettings(ball_every_s=0.0)


def test_joints_are_never_faster_nor_farther_than_they_can() -> None:
    settings = HeadSettings(ball_every_s=1.0, max_joint_radps=2.0, max_pan_rad=1.15, max_tilt_rad=0.9)
    motion = head_motion(standing([0.0, 0.0, 0.0], 120.0, turn_radps=1.0), settings, np.random.default_rng(1))
    steps = np.diff(motion.links_rad, axis=0)
    assert np.abs(steps).max() == pytest.approx(0.02, rel=1e-6)  # 2 rad/s at 100 Hz, and the limit is reached
    assert np.abs(motion.links_rad[:, 0]).max() <= 1.15 + 1e-9
    assert motion.links_rad[:, 1].max() == pytest.approx(0.9)
    np.testing.assert_allclose(motion.links_radps[:-1], steps * 100.0, atol=1e-9)


def test_a_sweep_goes_to_both_sides_far_one_way_and_near_the_other() -> None:
    motion = head_motion(standing([0.0, 0.0, 0.0], 60.0), NO_BALL, np.random.default_rng(1))
    pan, tilt = motion.links_rad.T
    rate = motion.links_radps[:, 0]
    steady = np.abs(np.abs(rate) - NO_BALL.sweep_radps) < 1e-6
    assert np.mean(steady) > 0.9  # all but the turns
    settled = steady & (np.abs(pan) < 0.5)
    np.testing.assert_allclose(tilt[settled & (rate > 0)], NO_BALL.far_tilt_rad, atol=1e-9)
    np.testing.assert_allclose(tilt[settled & (rate < 0)], NO_BALL.near_tilt_rad, atol=1e-9)
    # rounding a turn off costs a quarter of the softened way
    np.testing.assert_allclose([pan.min(), pan.max()], [-1.1, 1.1], atol=0.03)


def test_the_head_follows_a_ball_that_rolls_straight_while_the_robot_turns() -> None:
    settings = HeadSettings(ball_every_s=1e-6, ball_look_s=1.0, max_joint_radps=20.0)
    course = standing([1.0, -0.5, 2.0], 60.0, turn_radps=0.3)
    motion = head_motion(course, settings, np.random.default_rng(5))
    inside = (np.abs(motion.links_rad[:, 0]) < 1.5) & (motion.links_rad[:, 1] < 1.0)
    range_m = 0.55 / np.tan(motion.links_rad[:, 1])
    bearing = motion.links_rad[:, 0]
    # a joint obeys 45 ms late: half of what it is softened over
    late = course.poses_at(course.stamps_ns - 45_000_000)
    ball = se2.apply(late, range_m[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)]))
    tracked = 0
    for look in range(60):
        rows = slice(100 * look + 70, 100 * look + 99)  # the head has arrived by then
        if not inside[rows].all() or range_m[rows].max() > 3.0:
            continue
        tracked += 1
        bend = np.diff(ball[rows], n=2, axis=0)
        assert np.abs(bend).max() < 1e-4  # a straight way at constant speed
        speed = 100.0 * np.linalg.norm(np.diff(ball[rows], axis=0), axis=1).mean()
        assert 0.0 < speed < 1.5
    assert tracked > 20


def test_the_ball_is_looked_at_as_often_as_told() -> None:
    settings = HeadSettings(sweep_pan_rad=0.0, far_tilt_rad=-0.2, ball_every_s=4.0, ball_look_s=1.0)
    motion = head_motion(standing([0.0, 0.0, 0.0], 1000.0), settings, np.random.default_rng(2))
    looking = np.mean(motion.links_rad[:, 1] > 0.0)
    assert looking == pytest.approx(1.0 / 5.0, abs=0.04)  # 200 looks, whose pauses vary by as much as they last


def test_sensors_run_ahead_of_the_links_by_half_the_backlash() -> None:
    settings = replace(NO_BALL, backlash_rad=0.02)
    motion = head_motion(standing([0.0, 0.0, 0.0], 30.0), settings, np.random.default_rng(1))
    ahead = (motion.sensors_rad - motion.links_rad)[:, 0]
    moving = np.abs(motion.links_radps[:, 0]) > 0.1
    np.testing.assert_allclose(ahead[moving], 0.01 * np.sign(motion.links_radps[moving, 0]), atol=1e-12)
    tilt_ahead = (motion.sensors_rad - motion.links_rad)[:, 1]
    # the tilt rests most of the time, and stays where it was pushed to
    assert set(np.round(np.abs(tilt_ahead), 9).tolist()) <= {0.0, 0.01}
    assert np.mean(np.abs(tilt_ahead) > 0.009) > 0.8


def test_a_head_that_does_not_sweep_looks_ahead() -> None:
    motion = head_motion(standing([0, 0, 0]), replace(NO_BALL, sweep_pan_rad=0.0), np.random.default_rng(1))
    np.testing.assert_array_equal(motion.links_rad[:, 0], 0.0)
    np.testing.assert_allclose(motion.links_rad[:, 1], NO_BALL.far_tilt_rad, atol=1e-12)


def test_a_seed_gives_one_motion_bit_for_bit() -> None:
    course = standing([0, 0, 0], 60.0)
    first, again, other = (head_motion(course, HeadSettings(), np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.links_rad, again.links_rad)
    assert not np.array_equal(first.links_rad, other.links_rad)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("sweep_radps", 0.0),
        ("backlash_rad", -0.1),
        ("min_tilt_rad", 0.4),
        ("max_tilt_rad", 0.3),
        ("sweep_pan_rad", 2.0),
        ("neck_height_m", float("nan")),
        ("ball_look_s", "long"),
    ],
)
def test_a_head_that_cannot_be_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        replace(HeadSettings(), **{name: value})
