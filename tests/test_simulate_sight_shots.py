"""When a simulated camera takes pictures, and how far its true place is from where the robot believes it."""

from dataclasses import replace

import numpy as np
import pytest
from sight_course import DOWN, LEVEL, SWEEP, ideal, standing

from fieldloc.pose import FloatArray
from logs.simulate.course import Course
from logs.simulate.shots import Shots
from logs.simulate.sight import SimulatedCamera
from logs.simulate.vision_settings import (
    MountSettings,
    TimingSettings,
    VisionSettings,
)

PLAIN = TimingSettings(15.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
STILL = ideal(DOWN)
EXACT = STILL.mount
HEIGHT, PAN = 2, 3


def _shots(course: Course, settings: VisionSettings, seed: int = 1) -> Shots:
    return SimulatedCamera(settings, np.random.default_rng(seed)).shots(course)


def _error(shots: Shots) -> FloatArray:
    """(n, 4) of height, pan, tilt, roll: the true mount less the believed one."""
    return shots.real.places[:, HEIGHT:] - shots.believed.places[:, HEIGHT:]


def test_images_come_at_their_rate() -> None:
    shots = _shots(standing([0, 0, 0], 60.0), replace(STILL, timing=PLAIN))
    assert len(shots) == 900
    np.testing.assert_allclose(np.diff(shots.stamps_ns), 1e9 / 15.0, atol=1.0)
    np.testing.assert_array_equal(shots.log_times_ns, shots.stamps_ns)


def test_stamps_are_late_and_logs_are_later() -> None:
    timing = replace(PLAIN, stamp_delay_s=0.02, stamp_jitter_s=0.003, latency_s=0.06, latency_jitter_s=0.1)
    course = standing([1.0, 0.0, 0.0], 600.0, turn_radps=0.5)
    shots = _shots(course, replace(STILL, timing=timing))
    late_s = (shots.stamps_ns - shots.taken_ns) * 1e-9
    assert late_s.mean() == pytest.approx(0.02, abs=4 * 0.003 / np.sqrt(len(shots)))
    assert late_s.std() == pytest.approx(0.003, rel=0.05)
    latency_s = (shots.log_times_ns - shots.stamps_ns) * 1e-9
    assert latency_s.min() == pytest.approx(0.06, abs=1e-3)
    assert latency_s.max() < 0.17
    assert (np.diff(shots.stamps_ns) > 0).all()
    assert (np.diff(shots.log_times_ns) >= 0).all()
    # what is in the picture is what was there when it was taken
    np.testing.assert_array_equal(shots.poses, course.poses_at(shots.taken_ns))


def test_a_late_stamp_reads_the_joints_late() -> None:
    late = replace(STILL, head=SWEEP, timing=replace(PLAIN, stamp_delay_s=0.04))
    shots = _shots(standing([0, 0, 0], 60.0), late)
    off = np.abs(_error(shots)[:, 1])
    # at 0.9 rad/s; the turns take a little of it
    assert np.median(off) == pytest.approx(0.036, rel=1e-6)


def test_single_images_drop_out_as_often_as_told() -> None:
    shots = _shots(standing([0, 0, 0], 600.0), replace(STILL, timing=replace(PLAIN, drop_chance=0.1)))
    assert 1.0 - len(shots) / 9000.0 == pytest.approx(0.1, abs=4 * np.sqrt(0.1 * 0.9 / 9000.0))


def test_outages_silence_the_camera_for_a_while() -> None:
    timing = replace(PLAIN, outages_per_minute=2.0, outage_s=1.5)
    gaps_s = np.diff(_shots(standing([0, 0, 0], 3000.0), replace(STILL, timing=timing)).stamps_ns) * 1e-9
    silent_s = gaps_s[gaps_s > 0.1]
    assert len(silent_s) == pytest.approx(100, abs=40)  # four sigmas; some are shorter than a period
    assert silent_s.mean() == pytest.approx(1.5, abs=0.6)


def test_nothing_is_seen_while_the_robot_is_carried() -> None:
    course = standing([0, 0, 0], 20.0)
    seeing = (np.arange(2001) < 500) | (np.arange(2001) > 1200)
    shots = _shots(replace(course, seeing=seeing), replace(STILL, timing=replace(PLAIN, images_hz=230.0)))
    since_s = (shots.taken_ns - course.stamps_ns[0]) * 1e-9
    # not between a sample that sees and one that does not either
    assert not ((since_s >= 4.99) & (since_s < 12.01)).any()
    assert len(shots) == pytest.approx((20.0 - 7.02) * 230.0, abs=4)


def test_the_mount_is_off_by_the_same_all_game_long_and_by_another_in_the_next() -> None:
    errors = []
    for seed in range(400):
        camera = SimulatedCamera(
            replace(STILL, mount=replace(MountSettings(), imu_noise_rad=0.0)), np.random.default_rng(seed)
        )
        shots = camera.shots(standing([0, 0, 0], 1.0))
        each = _error(shots)
        np.testing.assert_allclose(each, np.broadcast_to(each[0], each.shape), atol=1e-12)
        names = [f"mount_error_{name}" for name in ("height_m", "pan_rad", "tilt_rad", "roll_rad")]
        np.testing.assert_allclose(each[0], [camera.truth[name] for name in names], atol=1e-12)
        errors.append(each[0])
    # the spread of a standard deviation over 400 draws is 3.5 %
    np.testing.assert_allclose(np.std(errors, axis=0), [0.01, 0.02, 0.025, 0.02], rtol=0.15)
    np.testing.assert_allclose(np.corrcoef(np.transpose(errors)), np.eye(4), atol=0.2)


def test_the_trunk_rolls_once_a_gait_cycle_and_pitches_and_bobs_twice() -> None:
    mount = replace(EXACT, sway_roll_rad=0.03, sway_pitch_rad=0.02, sway_height_m=0.006, imu_share=0.0)
    settings = replace(STILL, head=LEVEL, mount=mount, timing=replace(PLAIN, images_hz=50.0))
    shots = _shots(standing([0, 0, 0], 60.0, steps_hz=3.0), settings)
    settled = _error(shots)[50:]
    frequency_hz = np.fft.rfftfreq(len(settled), 1.0 / 50.0)
    strongest = frequency_hz[np.abs(np.fft.rfft(settled - settled.mean(axis=0), axis=0)).argmax(axis=0)]
    assert strongest[[0, 2, 3]] == pytest.approx([3.0, 3.0, 1.5], abs=0.03)
    assert np.abs(settled[:, 3]).max() == pytest.approx(0.03, rel=0.01)
    assert np.abs(settled[:, 2]).max() == pytest.approx(0.02, rel=0.02)
    # turning about the ground lowers it by less than a millimetre and moves it sideways by its height times the roll
    assert np.abs(settled[:, 0]).max() == pytest.approx(0.006, abs=0.001)
    assert np.abs(shots.real.places[50:, 1]).max() == pytest.approx(0.55 * 0.03, rel=0.02)


def test_a_head_that_looks_left_sees_the_trunks_roll_as_looking_up() -> None:
    mount = replace(EXACT, sway_roll_rad=0.03, imu_share=0.0)
    sweep = replace(SWEEP, far_tilt_rad=0.0, near_tilt_rad=0.0)
    course = standing([0, 0, 0], 60.0, steps_hz=3.0)
    shots = _shots(course, replace(STILL, head=sweep, mount=mount, timing=PLAIN))
    roll = 0.03 * np.sin(3.0 * np.pi * (shots.taken_ns - course.stamps_ns[0]) * 1e-9)
    expected = -roll * np.sin(shots.believed.places[:, PAN])
    assert np.abs(expected).max() > 0.02
    # second order in the roll, and samples 10 ms apart
    np.testing.assert_allclose(_error(shots)[20:, 2], expected[20:], atol=2e-4)


def test_what_the_inertial_unit_measures_is_no_error() -> None:
    mount = replace(EXACT, sway_roll_rad=0.03, sway_pitch_rad=0.02, imu_share=1.0)
    timing = replace(PLAIN, stamp_delay_s=0.0)
    course = standing([0, 0, 0], 30.0, steps_hz=3.0)
    known = _shots(course, replace(STILL, mount=mount, timing=timing))
    np.testing.assert_allclose(known.real.places, known.believed.places, atol=1e-12)
    half = _shots(course, replace(STILL, mount=replace(mount, imu_share=0.5), timing=timing))
    assert np.abs(_error(half)[:, 3]).max() == pytest.approx(0.015, rel=0.1)


def test_a_standing_robot_does_not_sway() -> None:
    settings = replace(STILL, mount=replace(MountSettings(), imu_noise_rad=0.0), timing=PLAIN)
    course = standing([0, 0, 0], 20.0, steps_hz=3.0)
    stopped = np.arange(2001) > 1000
    phase = np.where(stopped, course.gait_phase_rad[1000], course.gait_phase_rad)
    shots = _shots(replace(course, walking=~stopped, gait_phase_rad=phase), settings)
    late = shots.taken_ns > course.stamps_ns[1040]
    error = _error(shots)
    assert np.ptp(error[late], axis=0).max() < 1e-12
    assert np.ptp(error[~late], axis=0).min() > 1e-4


def test_joint_and_inertial_noise_are_white() -> None:
    head = replace(DOWN, joint_noise_rad=0.004)
    shots = _shots(standing([0, 0, 0], 600.0), replace(STILL, head=head, timing=PLAIN))
    for column in (1, 2):
        off = _error(shots)[:, column]
        assert off.std() == pytest.approx(0.004, rel=0.05)
        assert abs(np.corrcoef(off[1:], off[:-1])[0, 1]) < 0.05
    shaken = _shots(standing([0, 0, 0], 600.0), replace(STILL, mount=replace(EXACT, imu_noise_rad=0.005), timing=PLAIN))
    assert _error(shaken)[:, 2].std() == pytest.approx(0.005, rel=0.05)


def test_the_view_turns_with_head_and_body() -> None:
    body = _shots(standing([0, 0, 0], 10.0, turn_radps=0.7), replace(STILL, head=LEVEL))
    np.testing.assert_allclose(body.turning_radps, 0.7, atol=1e-9)
    down = _shots(standing([0, 0, 0], 10.0, turn_radps=0.7), STILL)
    np.testing.assert_allclose(down.turning_radps, 0.7 * np.cos(0.3), atol=1e-9)
    sweep = replace(SWEEP, far_tilt_rad=0.2, near_tilt_rad=0.2)
    head = _shots(standing([0, 0, 0], 60.0), replace(STILL, head=sweep))
    assert np.median(head.turning_radps) == pytest.approx(0.9 * np.cos(0.2))


@pytest.mark.parametrize(
    ("section", "name", "value"),
    [
        ("timing", "images_hz", 0.0),
        ("timing", "drop_chance", 1.5),
        ("mount", "imu_share", -0.1),
        ("mount", "sway_roll_rad", -0.1),
        ("noise", "claim_ratio", 0.0),
        ("posts", "ghost_chance", 2.0),
        ("posts", "people", -1),
        ("lines", "shortened_share", 0.5),
        ("lines", "range_scale_m", 0.0),
        ("robots", "radius_m", 0.0),
    ],
)
def test_settings_that_cannot_be_are_refused_by_name(section: str, name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        replace(getattr(VisionSettings(), section), **{name: value})
