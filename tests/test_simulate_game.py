import json
import time
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from simulated_games import IDEAL, KIDSIZE, QUIET, game, generator

from estimators.config import Config
from estimators.ekf import Ekf
from estimators.smoother import Smoother
from fieldloc import pose as se2
from fieldloc.errors import FieldlocError
from fieldloc.measurements import Compass, ImageFeatures, InitialPose, Odometry, Truth
from logs.evaluate import evaluate
from logs.reader import LogFile
from logs.recording import load_recording
from logs.replay import replay
from logs.simulate import SCENARIOS, SIMULATION, load_scenario, simulate
from logs.simulate.delivery import Delivery
from logs.simulate.game import BEGIN_NS
from logs.simulate.scenario import Scenario
from logs.simulate.settings import (
    DeliverySettings,
    FallSettings,
    KidnappingSettings,
    OthersSettings,
    PenaltySettings,
    StartSettings,
)
from logs.trajectory import from_estimates, from_truth

EVENTFUL = replace(
    load_scenario("kidsize-game"),
    duration_s=90.0,
    falls=FallSettings(at_s=(10.0,)),
    kidnappings=KidnappingSettings(at_s=(30.0,)),
    penalties=PenaltySettings(at_s=(40.0,), stand_s=(20.0, 20.0)),
)


def _made(folder: Path, scenario: Scenario, seed: int = 0, name: str = "game") -> LogFile:
    path = folder / f"{name}.mcap"
    simulate(path, scenario, seed)
    return LogFile(path)


def _during(stamps_ns: NDArray[np.int64], begin_ns: int, end_ns: int) -> NDArray[np.bool_]:
    return np.asarray((stamps_ns >= begin_ns) & (stamps_ns < end_ns))


def _drawn(log: LogFile) -> Mapping[str, object]:
    drawn = json.loads(log.metadata[SIMULATION]["drawn"])
    assert isinstance(drawn, dict)
    return drawn


def test_a_fall_puts_the_robot_down_turns_it_and_blinds_it() -> None:
    falls = FallSettings(at_s=tuple(range(10, 600, 20)), lying_s=(1.0, 2.0), get_up_s=(3.0, 5.0))
    of = game(replace(IDEAL, duration_s=600.0, falls=falls))
    course, turns = of.course, []
    assert len(of.walk.happened) == 30
    for event in of.walk.happened:
        during = _during(course.stamps_ns, event.begin_ns, event.end_ns)
        assert not course.upright[during].any()
        assert not course.seeing[during].any()
        assert not course.walking[during].any()
        # falling takes 0.6 s
        assert 4.6 - 0.02 <= (event.end_ns - event.begin_ns) * 1e-9 <= 7.6 + 0.02
        moved = se2.local(*course.poses_at(np.array([event.begin_ns, event.end_ns])))
        assert np.hypot(*moved[:2]) < 0.6
        turns.append(float(moved[2]))
    up = course.upright
    assert (
        up.mean()
        == course.seeing.mean()
        == 1.0 - sum((event.end_ns - event.begin_ns) // 10_000_000 for event in of.walk.happened) / len(up)
    )
    # drawn with 0.5 rad; a deviation's standard error of 30 is 13 %, four of these
    assert abs(np.std(turns) / 0.5 - 1.0) < 0.52
    assert np.abs(turns).max() <= np.pi / 2 + 1e-9
    wild = game(replace(IDEAL, duration_s=600.0, falls=replace(falls, turn_sigma_rad=50.0)))
    ends = [se2.local(*wild.course.poses_at(np.array([e.begin_ns, e.end_ns])))[2] for e in wild.walk.happened]
    assert np.abs(ends).max() <= np.pi / 2 + 1e-9


def test_a_kidnapped_robot_is_suddenly_elsewhere_and_saw_nothing_of_it() -> None:
    kidnappings = KidnappingSettings(at_s=tuple(range(10, 600, 20)), carry_s=(2.0, 4.0))
    of = game(replace(IDEAL, duration_s=600.0, kidnappings=kidnappings))
    course = of.course
    jumps = np.flatnonzero(np.hypot(*np.diff(course.poses[:, :2], axis=0).T) > 0.05) + 1
    landed = [event.end_ns for event in of.walk.happened]
    np.testing.assert_array_equal(course.stamps_ns[jumps], landed)
    for event in of.walk.happened:
        during = _during(course.stamps_ns, event.begin_ns, event.end_ns)
        assert not course.seeing[during].any()
        assert course.upright[during].all()
        assert 2.0 <= (event.end_ns - event.begin_ns) * 1e-9 <= 4.0
        assert not course.velocities[during].any()
        assert len(np.unique(course.poses[during], axis=0)) == 1
    places = course.poses[jumps]
    xmin, ymin, xmax, ymax = KIDSIZE.bounds
    assert np.all((places[:, :2] >= [xmin, ymin]) & (places[:, :2] <= [xmax, ymax]))
    assert np.ptp(places[:, 0]) > 5.0
    assert np.ptp(places[:, 2]) > 4.0


def test_a_penalised_robot_stands_at_a_touch_line_of_its_half_then_plays_on() -> None:
    penalties = PenaltySettings(at_s=(20.0, 100.0, 180.0), carry_s=(2.0, 2.0), stand_s=(30.0, 30.0))
    of = game(replace(IDEAL, duration_s=300.0, penalties=penalties))
    course = of.course
    for event, at_s in zip(of.walk.happened, (20, 100, 180), strict=True):
        assert event.begin_ns == BEGIN_NS + at_s * 10**9
        assert event.end_ns == event.begin_ns + 32 * 10**9
        stands = _during(course.stamps_ns, event.begin_ns + 2 * 10**9, event.end_ns)
        x, y, heading = np.unique(course.poses[stands], axis=0)[0]
        assert len(np.unique(course.poses[stands], axis=0)) == 1
        assert x < 0.0
        assert abs(y) == 3.0
        assert heading == -np.sign(y) * np.pi / 2
        assert course.seeing[stands].all()
        soon = _during(course.stamps_ns, event.end_ns, event.end_ns + 20 * 10**9)
        assert course.walking[soon].any()


def test_events_strike_at_their_rates_and_wait_for_each_other() -> None:
    often = replace(
        IDEAL,
        duration_s=3000.0,
        falls=FallSettings(per_min=1.0),
        kidnappings=KidnappingSettings(per_min=1.0),
        penalties=PenaltySettings(per_min=0.3, stand_s=(5.0, 5.0)),
    )
    happened = game(often).walk.happened
    for kind, expected in (("fall", 50), ("kidnapping", 50), ("penalty", 15)):
        assert abs(sum(event.kind == kind for event in happened) - expected) < 4 * np.sqrt(expected), kind
    assert all(a.end_ns <= b.begin_ns for a, b in pairwise(happened))
    assert not game(replace(IDEAL, duration_s=600.0)).walk.happened


def test_events_strike_in_the_order_of_their_times() -> None:
    mixed = replace(
        IDEAL,
        duration_s=100.0,
        falls=FallSettings(at_s=(60.0,)),
        kidnappings=KidnappingSettings(at_s=(80.0, 30.0)),
        penalties=PenaltySettings(at_s=(5.0,), carry_s=(2.0, 2.0), stand_s=(5.0, 5.0)),
    )
    begun = [(event.kind, (event.begin_ns - BEGIN_NS) / 1e9) for event in game(mixed).walk.happened]
    assert begun == [("penalty", 5.0), ("kidnapping", 30.0), ("fall", 60.0), ("kidnapping", 80.0)]


def test_what_happens_at_the_end_is_cut_off_there() -> None:
    of = game(replace(IDEAL, duration_s=20.0, kidnappings=KidnappingSettings(at_s=(19.0, 25.0))))
    assert [event.kind for event in of.walk.happened] == ["kidnapping"]
    assert not of.walk.jumped.any()
    assert of.walk.carried[-101:].all()


def test_no_part_draws_from_anothers_stream() -> None:
    base = game(EVENTFUL)
    alone = game(replace(EVENTFUL, others=OthersSettings(count=0), compass=replace(EVENTFUL.compass, rate_hz=0.0)))
    np.testing.assert_array_equal(alone.course.poses, base.course.poses)
    assert alone.believed.calibration == base.believed.calibration
    assert alone.camera.truth == base.camera.truth
    told = game(replace(EVENTFUL, start=StartSettings(told=False)))
    np.testing.assert_array_equal(told.course.poses, base.course.poses)
    np.testing.assert_array_equal(told.headings.headings_rad, base.headings.headings_rad)
    np.testing.assert_array_equal(told.believed.velocities, base.believed.velocities)
    unkidnapped = game(replace(EVENTFUL, kidnappings=KidnappingSettings()))
    before = slice(0, 3000)
    np.testing.assert_array_equal(unkidnapped.course.poses[before], base.course.poses[before])
    np.testing.assert_array_equal(unkidnapped.course.others[before], base.course.others[before])
    assert unkidnapped.headings.magnetics.declination_rad == base.headings.magnetics.declination_rad


def test_what_is_ready_in_a_stall_comes_at_its_end_and_nothing_overtakes_in_a_topic() -> None:
    delivery = Delivery(DeliverySettings(stalls_per_min=20.0, stall_s=(0.2, 0.5)), 0, 600.0, generator())
    assert np.all(delivery.stalls_ns[1:, 0] > delivery.stalls_ns[:-1, 1])
    ready = np.arange(0, 600 * 10**9, 10**7) + generator(1).integers(0, 3 * 10**7, 60_000)
    arrivals = delivery.arrivals_ns(ready)
    assert np.all(np.diff(arrivals) >= 0)
    assert np.all(arrivals >= ready)
    for begin_ns, end_ns in delivery.stalls_ns.tolist():
        assert not _during(arrivals, begin_ns, end_ns).any()
        held = arrivals[_during(ready, begin_ns, end_ns)]
        assert held.min() == end_ns
        # one that follows a slower one, by up to the 30 ms that these differ, waits for it too
        assert np.sum(held == end_ns) >= len(held) - 4 >= 12
    # 200 stalls of 0.35 s in 600 s; four standard errors
    assert abs(len(delivery.stalls_ns) - 200) < 57


def test_stalls_and_gaps_that_overlap_are_one() -> None:
    often = DeliverySettings(stalls_per_min=60.0, stall_s=(0.5, 2.0), gaps_per_min=60.0, gap_s=(0.5, 2.0))
    delivery = Delivery(often, 0, 1000.0, generator())
    for intervals in (delivery.stalls_ns, delivery.gaps_ns):
        assert np.all(intervals[1:, 0] > intervals[:-1, 1])
        # 1 a second for 1.25 s on average leaves exp(-1.25) free; 1000 of them, four standard errors of about 0.02
        covered = np.sum(intervals[:, 1] - intervals[:, 0]) / 1e12
        assert abs(covered - (1.0 - np.exp(-1.25))) < 0.08


def test_a_gap_takes_all_topics_of_the_robot_but_not_the_truth(tmp_path: Path) -> None:
    scenario = replace(QUIET, duration_s=60.0, delivery=DeliverySettings(gaps_per_min=4.0, gap_s=(2.0, 3.0)))
    log = _made(tmp_path, scenario, seed=1)
    gaps = np.array(_drawn(log)["gaps_ns"])
    assert len(gaps) >= 2
    for topic in ("/odometry", "/compass", "/image_features"):
        times = np.array([message.log_time_ns for message in log.messages([topic])])
        for begin_ns, end_ns in gaps:
            assert not _during(times, begin_ns, end_ns).any()
        assert len(times) > 300
    assert len(list(log.records(Truth))) == 6001


def test_the_log_holds_every_topic_in_the_order_of_log_time(tmp_path: Path) -> None:
    path = tmp_path / "game.mcap"
    counts = simulate(path, EVENTFUL, 3)
    log = LogFile(path)
    assert {source.topic: count for source, count in log.sources} == counts
    assert set(counts) == {
        "/field",
        "/camera",
        "/initial_pose",
        "/truth",
        "/odometry",
        "/compass",
        "/image_features",
    }
    messages = list(log.messages(list(counts)))
    times = [message.log_time_ns for message in messages]
    assert times == sorted(times)
    assert times[0] == BEGIN_NS
    # each is logged after it was measured, so that topics overtake each other
    late = [message.log_time_ns - message.record.stamp_ns for message in messages if message.topic == "/odometry"]
    assert 2_000_000 <= min(late) < 3_000_000
    stamps = [message.record.stamp_ns for message in messages if isinstance(message.record, Odometry | ImageFeatures)]
    assert stamps != sorted(stamps)
    assert not log.warnings
    field = log.field_map()
    assert field is not None
    np.testing.assert_array_equal(field.lines, KIDSIZE.lines)


def test_the_same_scenario_and_seed_make_the_same_bytes_and_another_seed_another_game(tmp_path: Path) -> None:
    short = replace(EVENTFUL, duration_s=35.0)
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        simulate(tmp_path / name, short, seed)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    a, c = LogFile(tmp_path / "a"), LogFile(tmp_path / "c")
    assert [x.velocity.tolist() for x in a.records(Odometry)] != [x.velocity.tolist() for x in c.records(Odometry)]
    assert _drawn(a)["camera"] != _drawn(c)["camera"]


def test_the_truth_is_the_course_but_for_the_time_in_the_air(tmp_path: Path) -> None:
    of = game(EVENTFUL, seed=3)
    truths = list(_made(tmp_path, EVENTFUL, 3).records(Truth))
    stamps = np.array([truth.stamp_ns for truth in truths])
    np.testing.assert_array_equal(stamps, of.course.stamps_ns[~of.walk.carried])
    np.testing.assert_array_equal([truth.pose for truth in truths], of.course.poses[~of.walk.carried])
    fewer = [x.stamp_ns for x in _made(tmp_path, replace(EVENTFUL, truth_hz=20), 3).records(Truth)]
    np.testing.assert_array_equal(fewer, of.course.stamps_ns[::5][~of.walk.carried[::5]])


def test_no_topic_but_the_truth_tells_the_truth(tmp_path: Path) -> None:
    # in a game with errors everywhere, what the robot logs differs from what geometry says
    log = _made(tmp_path, replace(load_scenario("kidsize-game"), duration_s=30.0), 5)
    of = game(replace(load_scenario("kidsize-game"), duration_s=30.0), seed=5)
    said = np.array([x.velocity for x in log.records(Odometry)])
    moments = np.append([x.stamp_ns for x in log.records(Odometry)], of.course.stamps_ns[-1])
    true = se2.local(*(of.course.poses_at(moments[k : len(moments) - 1 + k]) for k in (0, 1)))
    assert np.mean(np.abs(said[:, 2] - true[:, 2] * 50.0) > 1e-6) > 0.99
    compass = np.array([[x.heading_rad, of.course.poses_at(np.array(x.stamp_ns))[2]] for x in log.records(Compass)])
    assert np.abs(se2.wrap(compass[:, 0] - compass[:, 1])).min() > 1e-6
    start = next(iter(log.records(InitialPose)))
    assert np.abs(start.pose - of.course.poses[0]).min() > 1e-6
    assert not {"drawn", "scenario"} & set(log.metadata["fieldloc"])


def test_the_metadata_tells_scenario_seed_and_all_that_was_drawn(tmp_path: Path) -> None:
    log = _made(tmp_path, EVENTFUL, 3)
    of = game(EVENTFUL, seed=3)
    told = log.metadata[SIMULATION]
    assert told["seed"] == "3"
    assert json.loads(told["scenario"])["duration_s"] == 90.0
    drawn = _drawn(log)
    assert drawn["odometry"] == of.believed.calibration._asdict()
    assert drawn["start_pose"] == of.course.poses[0].tolist()
    assert drawn["hard_iron"] == of.headings.magnetics.hard_iron.tolist()
    assert drawn["camera"] == dict(of.camera.truth)
    assert drawn["events"] == [event._asdict() for event in of.walk.happened]
    assert [event.kind for event in of.walk.happened] == ["fall", "kidnapping", "penalty"]


def test_a_start_is_told_with_the_error_that_its_covariance_says(tmp_path: Path) -> None:
    errors = []
    for seed in range(100):
        of = game(IDEAL, seed, start=StartSettings(sigma_m=0.2, sigma_rad=0.1), duration_s=0.1)
        assert of.told is not None
        errors.append((of.told - of.course.poses[0]) / [0.2, 0.2, 0.1])
    # a deviation's standard error of 100 is 7 %, four of these
    np.testing.assert_allclose(np.std(errors, axis=0), 1.0, atol=0.28)
    told = next(iter(_made(tmp_path, replace(IDEAL, duration_s=1.0)).records(InitialPose)))
    np.testing.assert_allclose(told.covariance, np.diag([1e-6, 1e-6, 1e-6]))
    assert told.stamp_ns == BEGIN_NS
    untold = _made(tmp_path, replace(IDEAL, start=StartSettings(told=False), duration_s=1.0))
    assert not list(untold.records(InitialPose))


def test_an_ideal_game_is_followed_to_the_millimetre(tmp_path: Path) -> None:
    log = _made(tmp_path, replace(IDEAL, duration_s=5.0))
    done = replay(load_recording(log), Ekf(Config()))
    metrics = evaluate(from_estimates(done.estimates), from_truth(log.records(Truth)))
    # told to 1 mm; images that are exact hold it there, though where the eyes are is known to some centimetres only
    assert metrics.ate_m.rmse < 0.005
    assert metrics.heading_rad.rmse < 0.01


@pytest.mark.slow
def test_a_quiet_game_is_followed_to_some_centimetres(tmp_path: Path) -> None:
    log = _made(tmp_path, replace(QUIET, duration_s=60.0), 1)
    recording, truth = load_recording(log), from_truth(log.records(Truth))
    for estimator in (Ekf(Config()), Smoother(Config())):
        metrics = evaluate(from_estimates(replay(recording, estimator).estimates), truth)
        assert metrics.ate_m.rmse < 0.15
        assert metrics.heading_rad.rmse < np.radians(3.0)


def test_every_scenario_can_be_played_on_every_kind_of_field(tmp_path: Path) -> None:
    for name in SCENARIOS:
        counts = simulate(tmp_path / "game.mcap", load_scenario(name), 1, duration_s=3.0)
        assert counts["/truth"] == 301
        assert ("/compass" in counts) == (name not in ("spl-game", "no-compass"))
    small = tmp_path / "small.toml"
    small.write_text("lines = [[[0, 0], [1.2, 0]], [[0, 1.2], [1.2, 1.2]]]", encoding="utf-8")
    assert simulate(tmp_path / "game.mcap", replace(QUIET, field=str(small)), 1, 20.0)["/truth"] == 2001


@pytest.mark.parametrize(
    ("field", "says"),
    [
        ("lines = [[[0, 0], [9, 0]]]", "measures 9 x 0 m; a game needs 1 to 200 m"),
        ("lines = [[[0, 0], [1e9, 9]]]", "measures 1e\\+09 x 9 m; a game needs 1 to 200 m"),
    ],
)
def test_a_field_on_which_nobody_can_walk_about_is_refused(tmp_path: Path, field: str, says: str) -> None:
    (tmp_path / "odd.toml").write_text(field, encoding="utf-8")
    with pytest.raises(FieldlocError, match=says):
        simulate(tmp_path / "game.mcap", replace(QUIET, field=str(tmp_path / "odd.toml")), 1)
    assert not (tmp_path / "game.mcap").exists()


def test_numbers_that_make_no_game_are_refused(tmp_path: Path) -> None:
    for duration_s in (0.0, -5.0, float("nan"), 1e12):
        with pytest.raises(FieldlocError, match="duration_s: needs seconds from"):
            simulate(tmp_path / "game.mcap", QUIET, 1, duration_s)
    with pytest.raises(FieldlocError, match="seed: needs to be at least 0, got -1"):
        simulate(tmp_path / "game.mcap", QUIET, -1)
    with pytest.raises(FieldlocError, match=r"start\.pose: needs to be within 200 m"):
        simulate(tmp_path / "game.mcap", replace(QUIET, start=StartSettings((0.0, -201.0, 0.0))), 1)
    with pytest.raises(FieldlocError, match="such field map"):
        simulate(tmp_path / "game.mcap", replace(QUIET, field="moon"), 1)


def test_whoever_watches_is_told_how_much_of_the_game_is_over(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    simulate(tmp_path / "game.mcap", QUIET, 1, 20.0, lambda done, total, doing="": seen.append((done, total)))
    assert len(seen) > 3
    assert seen == sorted(seen)
    assert all(0 <= done <= total for done, total in seen)
    assert seen[-1][1] == 20_000


@pytest.mark.slow
def test_a_game_is_made_a_hundred_times_faster_than_it_is_played(tmp_path: Path) -> None:
    began = time.process_time()
    simulate(tmp_path / "game.mcap", load_scenario("kidsize-game"), 1)
    assert time.process_time() - began < 6.0
