from dataclasses import replace

import numpy as np
import pytest
from simulated_games import IDEAL, KIDSIZE, game, generator

from fieldloc import pose as se2
from fieldloc.pose import FloatArray
from logs.simulate.course import SAMPLE_NS
from logs.simulate.events import draw_events
from logs.simulate.game import BEGIN_NS
from logs.simulate.legs import SAMPLE_S, leg, path, standing
from logs.simulate.plan import Player
from logs.simulate.robots import make_way, walk_about
from logs.simulate.settings import (
    FallSettings,
    KidnappingSettings,
    OthersSettings,
    PenaltySettings,
    StartSettings,
    WalkSettings,
)
from logs.simulate.walk import take_walk

WALK = WalkSettings()
LONG = replace(IDEAL, duration_s=600.0)


def _steps(poses: FloatArray, velocities: FloatArray) -> FloatArray:
    """(n - 1, 3) how far each next pose is from where the velocity leads."""
    return se2.local(se2.compose(poses[:-1], se2.exp(velocities[:-1] * SAMPLE_S)), poses[1:])


@pytest.mark.parametrize(
    "tangent", [[2.0, 0.0, 0.0], [-0.3, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, -3.0], [1.5, 0.0, 1.2], [0.0, -0.3, 1.5]]
)
def test_a_leg_leads_exactly_along_its_arc_from_rest_to_rest_within_the_limits(tangent: list[float]) -> None:
    wanted = np.array(tangent)
    velocities = leg(WALK, wanted)
    np.testing.assert_allclose(path(np.zeros(3), velocities)[-1], se2.exp(wanted), atol=1e-12)
    top = np.array([WALK.backward_mps if tangent[0] < 0 else WALK.forward_mps, WALK.left_mps, WALK.turn_radps])
    # rounding up to whole samples, and normalizing after, moves the top by less than a sample's share
    assert np.all(np.abs(velocities).max(axis=0) <= 1.01 * top)
    assert np.max(np.abs(velocities).max(axis=0) / top) > 0.6
    rests = np.concatenate([np.zeros((1, 3)), velocities, np.zeros((1, 3))])
    accelerations = np.diff(rests, axis=0) / SAMPLE_S
    assert np.hypot(*accelerations[:, :2].T).max() <= 1.01 * WALK.acceleration_mps2
    assert np.abs(accelerations[:, 2]).max() <= 1.01 * WALK.turn_acceleration_radps2


def test_a_long_leg_reaches_the_top_speed_and_takes_as_long_as_that_says() -> None:
    velocities = leg(WALK, np.array([3.5, 0.0, 0.0]))
    assert abs(velocities[:, 0].max() - WALK.forward_mps) < 0.002
    # a half cosine up and one down cost one ramp: pi / 2 * v / a
    ramp_s = 0.5 * np.pi * WALK.forward_mps / WALK.acceleration_mps2
    assert abs(len(velocities) * SAMPLE_S - (3.5 / WALK.forward_mps + ramp_s)) <= SAMPLE_S


@pytest.mark.parametrize("tangent", [[0.05, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.1], [0.03, 0.01, 0.05]])
def test_a_short_leg_speeds_up_and_slows_down_within_the_limits(tangent: list[float]) -> None:
    velocities = leg(WALK, np.array(tangent))
    np.testing.assert_allclose(path(np.zeros(3), velocities)[-1], se2.exp(np.array(tangent)), atol=1e-12)
    rests = np.concatenate([np.zeros((1, 3)), velocities, np.zeros((1, 3))])
    accelerations = np.diff(rests, axis=0) / SAMPLE_S
    shares = np.hypot(*accelerations[:, :2].T) / 0.5, np.abs(accelerations[:, 2]) / 2.0
    # all of what is allowed, but for the few samples' share that rounding takes
    assert 0.85 < np.max(shares) <= 1.01


def test_a_weaving_leg_ends_in_the_heading_of_a_straight_one() -> None:
    straight, weaving = leg(WALK, np.array([2.0, 0.0, 0.0])), leg(WALK, np.array([2.0, 0.0, 0.0]), weave_radps=0.2)
    assert np.abs(weaving[:, 2]).max() > 0.19
    assert abs(path(np.zeros(3), weaving)[-1, 2]) < 1e-12
    np.testing.assert_array_equal(weaving[:, :2], straight[:, :2])


def test_no_way_takes_no_time() -> None:
    assert leg(WALK, np.zeros(3)).shape == (0, 3)
    assert standing(0.5).shape == (50, 3)


def test_the_path_is_what_composing_sample_by_sample_gives() -> None:
    velocities = generator().uniform(-1.0, 1.0, (300, 3))
    poses = [np.array([1.0, -2.0, 3.0])]
    for velocity in velocities:
        poses.append(se2.compose(poses[-1], se2.exp(velocity * SAMPLE_S)))
    np.testing.assert_allclose(se2.local(np.array(poses), path(poses[0], velocities)), 0.0, atol=1e-12)


def test_a_player_gets_to_the_balls_and_stays_on_the_field() -> None:
    poses = game(LONG).course.poses
    xmin, ymin, xmax, ymax = KIDSIZE.bounds
    # an arc or a weave may lead out by some tenths of a metre
    assert np.all((poses[:, 0] > xmin - 0.5) & (poses[:, 0] < xmax + 0.5))
    assert np.all((poses[:, 1] > ymin - 0.5) & (poses[:, 1] < ymax + 0.5))
    assert np.ptp(poses[:, 0]) > 4.0
    assert np.ptp(poses[:, 1]) > 3.0


def test_a_player_does_all_that_players_do() -> None:
    course = game(LONG).course
    forward, left, turn = course.velocities.T
    kinds = {
        "stands": ~course.walking,
        "walks straight": (forward > 0.1) & (np.abs(turn) < 0.02),
        "walks an arc": (forward > 0.1) & (np.abs(turn) > 0.1),
        "turns on the spot": (np.abs(turn) > 0.2) & (np.hypot(forward, left) < 1e-9),
        "steps aside": (np.abs(left) > 0.05) & (np.abs(forward) < 1e-9) & (np.abs(turn) < 1e-9),
        "circles the ball": (np.abs(left) > 0.05) & (np.abs(turn) > 0.2) & (np.abs(forward) < 1e-9),
        "backs up": forward < -0.05,
    }
    for kind, moments in kinds.items():
        assert moments.sum() * SAMPLE_S > 1.0, kind
    # an arc is walked along the heading, and a ball that is circled stays at the feet
    assert np.abs(left[kinds["walks an arc"]]).max() < 1e-9
    circled = kinds["circles the ball"]
    np.testing.assert_allclose(left[circled], -0.25 * turn[circled], atol=1e-9)


def test_nobody_backs_off_the_field() -> None:
    player, pose, backed = Player(WALK, (-0.7, -0.7, 0.7, 0.7), generator(2)), np.zeros(3), 0
    for _ in range(600):
        piece = player.next_piece(pose)
        pose = path(pose, piece)[-1]
        if piece[:, 0].min() < -0.01:
            backed += 1
            assert np.abs(pose[:2]).max() < 0.9
    assert backed > 20


class _Forgetful(Player):
    """Counts how often it is told to think again."""

    forgot = 0

    def think_again(self) -> None:
        self.forgot += 1
        super().think_again()


def test_a_player_thinks_again_after_everything_that_happens_to_it() -> None:
    player = _Forgetful(WALK, KIDSIZE.bounds, generator(1))
    events = draw_events(
        60.0,
        KIDSIZE.bounds,
        (FallSettings(at_s=(10.0, 40.0)), generator(2)),
        (KidnappingSettings(at_s=(25.0,)), generator(3)),
        (PenaltySettings(), generator(4)),
    )
    walk = take_walk(np.zeros(3), 1.0, 0, 60.0, player, events)
    assert player.forgot == len(walk.happened) == 3


def test_to_think_again_is_to_drop_what_was_begun() -> None:
    stubborn, open_minded = Player(WALK, KIDSIZE.bounds, generator(3)), Player(WALK, KIDSIZE.bounds, generator(3))
    pose = path(np.zeros(3), stubborn.next_piece(np.zeros(3)))[-1]
    np.testing.assert_array_equal(path(np.zeros(3), open_minded.next_piece(np.zeros(3)))[-1], pose)
    open_minded.think_again()
    assert len(stubborn.next_piece(pose)) != len(open_minded.next_piece(pose))


def test_a_player_that_is_told_to_think_again_plans_from_where_it_is() -> None:
    player = Player(WALK, KIDSIZE.bounds, generator(3))
    player.next_piece(np.zeros(3))
    player.think_again()
    moved = np.array([-4.0, -2.5, 2.0])
    xmin, ymin, xmax, ymax = KIDSIZE.bounds
    pose = moved
    for _ in range(20):
        pose = path(pose, player.next_piece(pose))[-1]
        assert xmin - 0.5 < pose[0] < xmax + 0.5
        assert ymin - 0.5 < pose[1] < ymax + 0.5


def test_samples_are_10_ms_apart_and_cover_the_game() -> None:
    course = game(duration_s=12.34).course
    assert course.stamps_ns[0] == BEGIN_NS
    assert np.all(np.diff(course.stamps_ns) == SAMPLE_NS)
    assert course.stamps_ns[-1] == BEGIN_NS + 12_340_000_000


@pytest.mark.parametrize("sway_m", [0.0, 0.02])
def test_velocities_lead_from_each_pose_to_the_next(sway_m: float) -> None:
    course = game(LONG, walk=replace(IDEAL.walk, sway_m=sway_m)).course
    np.testing.assert_allclose(_steps(course.poses, course.velocities), 0.0, atol=1e-12)


@pytest.mark.parametrize("sway_m", [0.0, 0.02])
def test_velocities_are_nothing_before_a_jump_and_lead_on_everywhere_else(sway_m: float) -> None:
    short = KidnappingSettings(at_s=tuple(range(5, 100, 5)), carry_s=(0.05, 0.1))  # the body still sways in the air
    of = game(LONG, duration_s=100.0, kidnappings=short, walk=replace(IDEAL.walk, sway_m=sway_m))
    before_jump = of.walk.jumped[1:]
    assert before_jump.sum() == 19
    np.testing.assert_array_equal(of.course.velocities[:-1][before_jump], 0.0)
    steps = _steps(of.course.poses, of.course.velocities)
    np.testing.assert_allclose(steps[~before_jump], 0.0, atol=1e-12)
    assert np.hypot(*steps[before_jump][:, :2].T).max() > 2.0


def test_the_body_sways_over_the_feet_by_what_is_said_once_in_two_steps() -> None:
    still, swaying = game(LONG).course, game(LONG, walk=replace(IDEAL.walk, sway_m=0.02)).course
    sway = se2.local(still.poses, swaying.poses)
    assert 0.0195 < sway[:, 1].max() <= 0.02 + 1e-12
    np.testing.assert_allclose(sway[:, [0, 2]], 0.0, atol=1e-12)
    # once a full cycle, two steps, the sway crosses its middle upwards
    upward = np.sum((sway[:-1, 1] < 0.0) & (sway[1:, 1] >= 0.0) & still.walking[1:])
    steps = still.gait_phase_rad[-1] / np.pi
    assert abs(upward - steps / 2) < 0.05 * steps
    standing_long = ~np.convolve(still.walking, np.ones(60))[: len(sway)].astype(bool)
    assert standing_long.sum() > 100
    np.testing.assert_allclose(sway[standing_long, 1], 0.0, atol=1e-12)


def test_the_gait_phase_grows_by_pi_a_step_and_only_while_walking() -> None:
    course = game(LONG).course
    grown = np.diff(course.gait_phase_rad)
    np.testing.assert_allclose(grown[course.walking[:-1]], np.pi * IDEAL.walk.steps_hz * SAMPLE_S)
    assert np.all(grown[~course.walking[:-1]] == 0.0)
    np.testing.assert_array_equal(course.walking, course.velocities.any(axis=1))


def test_the_robot_starts_where_it_is_told_and_stands_first() -> None:
    course = game(start=StartSettings((1.0, -2.0, 0.5), stand_s=3.0)).course
    np.testing.assert_array_equal(course.poses[:300], np.tile([1.0, -2.0, 0.5], (300, 1)))
    assert course.walking[300:320].any()


def test_without_a_start_the_robot_stands_on_a_touch_line_of_its_own_half_facing_the_field() -> None:
    sides = set()
    for seed in range(20):
        x, y, heading = game(seed=seed, duration_s=1.0).course.poses[0]
        assert -4.5 < x < 0.0
        assert abs(y) == 3.0
        assert heading == -np.sign(y) * np.pi / 2
        sides.add(y)
    assert sides == {-3.0, 3.0}


def test_poses_between_samples_are_on_the_arc_and_beyond_the_ends_at_the_ends() -> None:
    course = game(duration_s=20.0).course
    at = int(np.argmax(np.abs(course.velocities[:, 2])))
    between = course.stamps_ns[at] + np.array([0, 2_500_000, SAMPLE_NS - 1, SAMPLE_NS])
    found = course.poses_at(between)
    np.testing.assert_array_equal(found[0], course.poses[at])
    expected = se2.compose(course.poses[at], se2.exp(course.velocities[at] * 0.0025))
    np.testing.assert_allclose(found[1], expected, atol=1e-15)
    assert np.hypot(*(found[2] - course.poses[at + 1])[:2]) < 1e-8
    np.testing.assert_array_equal(found[3], course.poses[at + 1])
    ends = course.poses_at(np.array([0, course.stamps_ns[-1] + 10**12]))
    np.testing.assert_array_equal(ends, course.poses[[0, -1]])
    assert course.index_at(np.array(0)).shape == ()


OTHERS = OthersSettings(count=6, speed_mps=0.4, absences_per_min=0.5, absence_s=(20.0, 40.0))
STAMPS = np.arange(60_001) * SAMPLE_NS


def test_the_others_walk_on_the_field_at_their_speed_and_pause() -> None:
    others = walk_about(STAMPS, KIDSIZE.bounds, OTHERS, generator())
    xmin, ymin, xmax, ymax = KIDSIZE.bounds
    assert others.shape == (len(STAMPS), 6, 2)
    here = ~np.isnan(others[..., 0])
    assert np.all(others[here] >= [xmin, ymin])
    assert np.all(others[here] <= [xmax, ymax])
    speeds = np.linalg.norm(np.diff(others, axis=0), axis=-1) / SAMPLE_S
    speeds = speeds[np.isfinite(speeds)]
    assert speeds.max() <= 0.4 + 1e-9
    assert 0.05 < np.mean(speeds < 1e-9) < 0.6
    # each on its own way
    assert len(np.unique(np.round(others[1000], 3), axis=0)) == 6


def test_the_others_are_off_the_field_as_often_and_as_long_as_said() -> None:
    others = walk_about(np.arange(300_001) * SAMPLE_NS, KIDSIZE.bounds, OTHERS, generator())
    # 0.5 a minute for 30 s on average: a quarter of the time, less where two overlap: 1 - exp(-0.25) = 0.22.
    # 150 absences in all: a share's standard error of about 9 % of it, four of these
    away = np.isnan(others[..., 0])
    np.testing.assert_array_equal(away, np.isnan(others[..., 1]))
    assert abs(np.mean(away) - 0.221) < 0.08
    assert not np.isnan(walk_about(STAMPS, KIDSIZE.bounds, replace(OTHERS, absences_per_min=0.0), generator())).any()


def test_nobody_stands_inside_the_player() -> None:
    positions = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [0.0, 0.0]])
    others = np.array(
        [[[0.1, 0.0], [3.0, 0.0]], [[np.nan, np.nan], [1.0, 1.5]], [[2.0, 2.3], [2.3, 2.0]], [[0.5, 0], [0, 1]]]
    )
    moved, bumped = make_way(others, positions)
    np.testing.assert_array_equal(bumped, [True, False, True, False])
    np.testing.assert_allclose(moved[0], [[0.4, 0.0], [3.0, 0.0]])
    np.testing.assert_array_equal(moved[1], others[1])
    np.testing.assert_allclose(moved[2], [[2.0, 2.4], [2.4, 2.0]])
    course = game(LONG, others=OthersSettings(count=10)).course
    distance = np.linalg.norm(course.others - course.poses[:, None, :2], axis=-1)
    assert np.nanmin(distance) > 0.4 - 1e-9
