from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from simulated_games import IDEAL, game, generator

from estimators.base import Estimate
from estimators.config import Config
from estimators.dead_reckoning import DeadReckoning
from fieldloc import pose as se2
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray
from logs.simulate.game import Game
from logs.simulate.odometry import Believed, believe, stated_covariance
from logs.simulate.settings import (
    FallSettings,
    KidnappingSettings,
    OdometrySettings,
    OthersSettings,
    PenaltySettings,
)

PERFECT = IDEAL.odometry
LONG = replace(IDEAL, duration_s=600.0)
_PERIOD_NS = 20_000_000  # a message that began before something ended tells of what came after it too


def _way(believed: Believed, end_ns: int) -> FloatArray:
    """(m, 3) tangents of what each message says until the next."""
    seconds = np.diff(believed.measured_ns, append=end_ns) * 1e-9
    return believed.velocities * seconds[:, None]


def _true_way(of: Game) -> FloatArray:
    """(m, 3) tangents of the true motion between the messages' moments."""
    moments = np.append(of.believed.measured_ns, of.course.stamps_ns[-1])
    poses = of.course.poses_at(moments)
    return se2.local(poses[:-1], poses[1:])


def _fallen(of: Game) -> NDArray[np.bool_]:
    return ~of.course.upright[of.course.index_at(of.believed.measured_ns)]


def _with(settings: OdometrySettings, seed: int = 0, duration_s: float = 600.0) -> Game:
    return game(LONG, seed, odometry=settings, duration_s=duration_s)


@pytest.mark.parametrize(("rate_hz", "jitter_s"), [(50.0, 0.0), (50.0, 0.003), (83.0, 0.001), (7.0, 0.02)])
def test_without_errors_dead_reckoning_is_the_truth(rate_hz: float, jitter_s: float) -> None:
    # whatever the messages' rate: 10 ms samples, straight or not, are integrated exactly
    of = _with(replace(PERFECT, rate_hz=rate_hz, jitter_s=jitter_s), duration_s=40.0)
    estimator = DeadReckoning(Config())
    estimator.start(Estimate(int(of.believed.stamps_ns[0]), of.course.poses[0], np.eye(3)))
    errors = []
    for stamp_ns, velocity in zip(of.believed.stamps_ns.tolist(), of.believed.velocities, strict=True):
        estimator.predict(Odometry(stamp_ns, velocity))
        estimate = estimator.estimate()
        assert estimate is not None
        errors.append(se2.local(of.course.poses_at(np.array(stamp_ns)), estimate.pose))
    assert len(errors) > 270
    np.testing.assert_allclose(errors, 0.0, atol=1e-9)


def test_the_ratio_of_the_paths_is_the_scale_that_was_drawn() -> None:
    settings = replace(PERFECT, forward_scale=(0.85, 0.95), left_scale=(1.02, 1.1), turn_scale=(0.9, 0.95))
    drawn = []
    for seed in range(5):
        of = _with(settings, seed, duration_s=60.0)
        said, true = _way(of.believed, int(of.course.stamps_ns[-1])), _true_way(of)
        moving = np.abs(true) > 1e-6
        expected = of.believed.calibration[:3]
        for axis, scale in enumerate(expected):
            np.testing.assert_allclose(said[moving[:, axis], axis], scale * true[moving[:, axis], axis], rtol=1e-6)
        drawn.append(expected)
    for scales, (low, high) in zip(np.array(drawn).T, ((0.85, 0.95), (1.02, 1.1), (0.9, 0.95)), strict=True):
        assert np.all((scales >= low) & (scales <= high))
        assert np.ptp(scales) > 0.01


def test_steps_slip_by_their_share_and_nothing_slips_at_standstill() -> None:
    of = _with(replace(PERFECT, slip_share=0.1, heading="steps", slip_rad_per_m=0.2))
    said, true = _way(of.believed, int(of.course.stamps_ns[-1])), _true_way(of)
    still = np.abs(true).max(axis=1) < 1e-12
    assert still.sum() > 1000
    np.testing.assert_allclose(said[still], 0.0, atol=1e-12)
    step = np.floor(np.interp(of.believed.measured_ns, of.course.stamps_ns, of.course.gait_phase_rad) / np.pi)
    straight = np.abs(true[:, 0]) > 1e-4
    shares = (said[straight, 0] / true[straight, 0] - 1.0) / 0.1
    # all messages of a step share its slip
    _, first = np.unique(step[straight], return_index=True)
    per_step = shares[first]
    np.testing.assert_allclose(shares, per_step[np.searchsorted(np.unique(step[straight]), step[straight])], atol=1e-6)
    # about 1000 steps: standard errors 0.03 of the mean and 0.022 of the deviation, four of each
    assert len(per_step) > 700
    assert abs(np.mean(per_step)) < 0.13
    assert abs(np.std(per_step) - 1.0) < 0.1
    assert abs(np.corrcoef(per_step[:-1], per_step[1:])[0, 1]) < 0.15
    # forward and sideways each on its own
    both = straight & (np.abs(true[:, 1]) > 1e-4)
    assert both.sum() > 100
    sideways = (said[both, 1] / true[both, 1] - 1.0) / 0.1
    assert abs(np.corrcoef(sideways, shares[both[straight]])[0, 1]) < 0.7
    assert 0.3 < np.std(sideways) < 2.0
    # the turn slips by the way; its own share adds nothing where the robot hardly turns
    ahead = straight & (np.abs(true[:, 2]) < 1e-9)
    per_metre = (said[ahead, 2] / true[ahead, 0])[np.unique(step[ahead], return_index=True)[1]]
    assert len(per_metre) > 100
    assert abs(np.std(per_metre) / 0.2 - 1.0) < 4.0 / np.sqrt(2 * len(per_metre))


def test_a_robot_that_veers_believes_in_turns_while_it_walks_straight() -> None:
    of = _with(replace(PERFECT, heading="steps", veer_rad_per_m=(-0.2, -0.1)), duration_s=60.0)
    said, true = _way(of.believed, int(of.course.stamps_ns[-1])), _true_way(of)
    veer = of.believed.calibration.veer_rad_per_m
    assert -0.2 <= veer <= -0.1
    np.testing.assert_allclose(said[:, 2] - true[:, 2], veer * true[:, 0], atol=1e-9)


def test_a_gyro_turns_at_standstill_by_its_bias_and_steps_do_not() -> None:
    biased = replace(PERFECT, gyro_bias_sigma_radps=0.01)
    biases = []
    for seed in range(100):
        believed = _with(biased, seed, duration_s=0.5).believed
        np.testing.assert_allclose(believed.velocities[:, 2], believed.calibration.gyro_bias_radps)
        biases.append(believed.calibration.gyro_bias_radps)
    # standard errors 0.1 and 0.07 of the deviation, four of each
    assert abs(np.mean(biases)) < 0.004
    assert abs(np.std(biases) - 0.01) < 0.003
    by_steps = _with(replace(biased, heading="steps", gyro_noise_rad_per_sqrt_s=1.0), duration_s=0.5).believed
    np.testing.assert_array_equal(by_steps.velocities, 0.0)


def test_a_gyros_noise_and_wander_grow_with_the_root_of_time() -> None:
    of = game(replace(IDEAL, start=replace(IDEAL.start, stand_s=100.0), duration_s=100.0))
    alone = np.zeros(len(of.course.stamps_ns), dtype=np.bool_)
    slow = replace(PERFECT, rate_hz=10.0)

    def stood(settings: OdometrySettings, seed: int) -> Believed:
        return believe(of.walk, of.course.gait_phase_rad, alone, settings, generator(seed))

    noisy = replace(slow, gyro_noise_rad_per_sqrt_s=0.01)
    ends = [_way(stood(noisy, seed), int(of.course.stamps_ns[-1]))[:, 2].sum() for seed in range(100)]
    # 0.01 * sqrt(100 s); a deviation's standard error of 100 is 7 %, four of these
    assert abs(np.std(ends) / 0.1 - 1.0) < 0.28
    wanders = replace(slow, gyro_walk_radps_per_sqrt_s=0.001)
    last = [stood(wanders, seed).velocities[-1, 2] for seed in range(100)]
    assert abs(np.std(last) / 0.01 - 1.0) < 0.28


def test_running_into_someone_slips_and_a_gyro_knows_better_than_steps() -> None:
    settings = replace(PERFECT, bump_m=0.1, bump_rad=0.3)
    crowd = OthersSettings(count=10)
    for heading, axes in (("gyro", 2), ("steps", 3)):
        scenario = replace(LONG, others=crowd, odometry=replace(settings, heading=heading))
        of = game(scenario)
        slips = _way(of.believed, int(of.course.stamps_ns[-1])) - _true_way(of)
        slipped = np.abs(slips).max(axis=1) > 1e-6
        near = np.linalg.norm(of.course.others - of.course.poses[:, None, :2], axis=-1)
        # within 0.4 s of a touch, which is at 0.4 m
        touches = np.convolve(np.nanmin(near, axis=1) < 0.4 + 1e-6, np.ones(45))[: len(near)] > 0
        assert 20 < slipped.sum() < 0.3 * len(slipped)
        assert np.all(touches[of.course.index_at(of.believed.measured_ns)][slipped])
        assert np.all(slips[slipped][:, axes:] == 0.0) or np.abs(slips[slipped][:, axes:]).max() < 1e-9
        # each collision's slip is spread over 20 messages
        sizes = slips[slipped][:, :axes] * 20 / np.array([0.1, 0.1, 0.3])[:axes]
        assert 0.5 < np.std(sizes) < 1.6


def test_a_robot_that_was_carried_or_fell_has_made_no_steps() -> None:
    happenings = replace(
        LONG,
        duration_s=100.0,
        falls=FallSettings(at_s=(10.0,)),
        kidnappings=KidnappingSettings(at_s=(40.0,)),
        penalties=PenaltySettings(at_s=(60.0,)),
    )
    of = game(happenings)
    for event in of.walk.happened:
        during = (of.believed.measured_ns >= event.begin_ns) & (of.believed.measured_ns < event.end_ns - _PERIOD_NS)
        assert during.sum() > 50
        np.testing.assert_array_equal(of.believed.velocities[during], 0.0)
    # and all the rest is true
    apart = np.abs(_way(of.believed, int(of.course.stamps_ns[-1])) - _true_way(of)).max(axis=1) > 1e-9
    stamps = of.believed.measured_ns[apart]
    inside = [(stamps > event.begin_ns - _PERIOD_NS) & (stamps < event.end_ns) for event in of.walk.happened]
    assert apart.sum() > 50
    assert np.all(np.any(inside, axis=0))


def test_a_fallen_robots_odometry_is_silent_still_or_lies() -> None:
    falls = replace(LONG, duration_s=200.0, falls=FallSettings(at_s=tuple(range(10, 200, 20))))
    still, silent, walking = (
        game(falls, odometry=replace(PERFECT, fallen=how)) for how in ("still", "silent", "walking")
    )
    assert _fallen(still).sum() > 1000
    ends = [still.believed.measured_ns > event.end_ns - _PERIOD_NS for event in still.walk.happened]
    begins = [still.believed.measured_ns < event.end_ns for event in still.walk.happened]
    last = np.any(np.logical_and(ends, begins), axis=0)
    assert not still.believed.velocities[_fallen(still) & ~last].any()
    assert not _fallen(silent).any()
    np.testing.assert_array_equal(silent.believed.velocities, still.believed.velocities[~_fallen(still)])
    # as before the fall until it gets up, then still
    lies = 0
    for event in walking.walk.happened:
        before = walking.believed.velocities[walking.believed.measured_ns < event.begin_ns][-1]
        during = (walking.believed.measured_ns >= event.begin_ns) & (
            walking.believed.measured_ns < event.end_ns - _PERIOD_NS
        )
        said = walking.believed.velocities[during]
        fooled = walking.walk.fooled[walking.course.index_at(walking.believed.measured_ns[during])]
        steady = said[fooled][:-1]  # the last one tells of the standing after it too
        np.testing.assert_allclose(steady, np.tile(said[0], (len(steady), 1)), atol=1e-9)
        np.testing.assert_allclose(said[0], before, atol=0.02)
        np.testing.assert_array_equal(said[~fooled][1:], 0.0)
        assert 1.4 < fooled.sum() / 50 < 3.3
        lies += int(said[fooled].any())
    assert lies > 4


def test_messages_come_at_the_rate_with_the_jitter_that_is_said() -> None:
    of = _with(replace(PERFECT, rate_hz=50.0, jitter_s=0.002))
    assert len(of.believed.measured_ns) == 30_000
    late = of.believed.measured_ns - of.believed.measured_ns[0] - np.arange(30_000) * 20_000_000
    # a deviation's standard error of 30,000 is 0.4 %
    assert abs(np.std(late) / 2e6 - 1.0) < 0.02
    assert np.all(np.diff(_with(replace(PERFECT, jitter_s=0.02), duration_s=60.0).believed.measured_ns) > 0)


def test_stamps_are_late_by_the_delay() -> None:
    believed = _with(replace(PERFECT, delay_s=0.015), duration_s=10.0).believed
    np.testing.assert_array_equal(believed.stamps_ns - believed.measured_ns, 15_000_000)


def test_messages_are_lost_by_the_share_that_is_said_and_the_others_stay_as_they_are() -> None:
    whole, lossy = _with(PERFECT), _with(replace(PERFECT, drop_share=0.2))
    # standard error sqrt(0.16 / 30000) = 0.0023
    assert abs(len(lossy.believed.stamps_ns) / len(whole.believed.stamps_ns) - 0.8) < 0.01
    left = np.isin(whole.believed.stamps_ns, lossy.believed.stamps_ns)
    np.testing.assert_array_equal(lossy.believed.velocities, whole.believed.velocities[left])


def test_switching_one_error_off_leaves_the_others_as_they_were() -> None:
    everything = OdometrySettings(drop_share=0.1, jitter_s=0.002)
    without = {
        "gyro": replace(everything, gyro_noise_rad_per_sqrt_s=0.0, gyro_walk_radps_per_sqrt_s=0.0),
        "slip": replace(everything, slip_share=0.0),
        "drops": replace(everything, drop_share=0.0),
    }
    base = _with(everything, duration_s=60.0).believed
    gyro = _with(without["gyro"], duration_s=60.0).believed
    slip = _with(without["slip"], duration_s=60.0).believed
    drops = _with(without["drops"], duration_s=60.0).believed
    np.testing.assert_array_equal(gyro.velocities[:, :2], base.velocities[:, :2])
    np.testing.assert_array_equal(slip.velocities[:, 2], base.velocities[:, 2])
    assert np.any(gyro.velocities != base.velocities)
    assert np.any(slip.velocities != base.velocities)
    kept = np.isin(drops.stamps_ns, base.stamps_ns)
    np.testing.assert_array_equal(drops.velocities[kept], base.velocities)
    assert base.calibration == gyro.calibration == slip.calibration == drops.calibration


def test_a_driver_states_what_it_is_told_to_or_nothing() -> None:
    assert stated_covariance(OdometrySettings()) is None
    stated = stated_covariance(OdometrySettings(stated_mps=0.02, stated_radps=0.03))
    assert stated is not None
    np.testing.assert_allclose(stated, np.diag([0.0004, 0.0004, 0.0009]))


def test_a_robot_that_never_moves_is_believed_to_stand() -> None:
    of = game(duration_s=1.0)
    none = np.zeros(len(of.course.stamps_ns), dtype=np.bool_)
    believed = believe(
        of.walk,
        of.course.gait_phase_rad,
        none,
        OdometrySettings(gyro_bias_sigma_radps=0.0, gyro_noise_rad_per_sqrt_s=0.0, gyro_walk_radps_per_sqrt_s=0.0),
        generator(),
    )
    np.testing.assert_array_equal(believed.velocities, 0.0)
