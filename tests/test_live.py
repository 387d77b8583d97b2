"""The robot's own loop: measurements in the order in which they arrive, late images, and the pose at present."""

from dataclasses import replace

import numpy as np
import pytest
from walks import ns

from estimators.config import Config
from estimators.ekf import Ekf
from estimators.live import Localizer
from estimators.mixture import MixtureFilter
from estimators.particles import ParticleFilter
from fieldloc import pose as se2
from fieldloc.covariance import squared_mahalanobis
from fieldloc.field import load_field
from fieldloc.measurements import Compass, ImageFeatures, InitialPose, Measurement, Odometry
from fieldloc.pose import FloatArray
from logs.recording import Recording
from logs.replay import replay
from logs.simulate import load_scenario
from logs.simulate.game import Game, play
from logs.simulate.topics import messages

FIELD = load_field("kidsize")
SECONDS = 14.0


def game() -> tuple[Game, list[Measurement]]:
    """And all that its robot measures, as it arrives: images two tenths of a second after their stamp at most."""
    scenario = replace(load_scenario("quiet"), duration_s=SECONDS)
    played = play(scenario, FIELD, 11)
    arrived = [
        message.record
        for message in sorted(messages(played), key=lambda message: message.log_time_ns)
        if isinstance(message.record, Odometry | Compass | ImageFeatures | InitialPose)
    ]
    return played, arrived


GAME, ARRIVED = game()
CAMERA = GAME.scenario.vision.camera


def truth_at(stamp_ns: int) -> FloatArray:
    return np.asarray(GAME.course.poses_at(np.array([stamp_ns]))[0])


def test_images_do_come_late() -> None:
    newest, late = 0, []
    for measurement in ARRIVED:
        newest = max(newest, measurement.stamp_ns)
        if isinstance(measurement, ImageFeatures):
            late.append(newest - measurement.stamp_ns)
    assert np.median(late) > ns(0.04)


@pytest.mark.parametrize("made", [MixtureFilter, Ekf, ParticleFilter])
def test_the_present_pose_is_as_good_as_that_of_a_recording(made: type[MixtureFilter | Ekf | ParticleFilter]) -> None:
    robot = Localizer(FIELD, CAMERA, estimator=made(Config()))
    off, squared = [], []
    for measurement in ARRIVED:
        robot.take(measurement)
        now = robot.estimate()
        if now is not None and isinstance(measurement, Odometry) and measurement.stamp_ns > ns(8.0):
            assert now.stamp_ns >= measurement.stamp_ns
            error = se2.local(now.pose, truth_at(now.stamp_ns))
            off.append(np.hypot(*error[:2]))
            squared.append(float(squared_mahalanobis(error, now.robot_covariance)))
    assert robot.late <= 1

    in_order = tuple(sorted(ARRIVED, key=lambda one: (one.stamp_ns, not isinstance(one, Odometry))))
    done = replay(Recording("game", FIELD, CAMERA, in_order), made(Config()))
    past = [np.hypot(*(now.pose - truth_at(now.stamp_ns))[:2]) for now in done.estimates if now.stamp_ns > ns(8.0)]
    assert len(off) > 200
    assert np.sqrt(np.mean(np.square(off))) < 1.5 * np.sqrt(np.mean(np.square(past))) + 0.005
    assert np.mean(squared) < 6.0  # 3 where covariances are right


def test_what_comes_out_of_order_is_as_what_comes_in_order() -> None:
    """Up to what has waited long enough."""
    one, other = Localizer(FIELD, CAMERA), Localizer(FIELD, CAMERA)
    in_order = sorted(ARRIVED, key=lambda measurement: (measurement.stamp_ns, not isinstance(measurement, Odometry)))
    for measurement in ARRIVED:
        one.take(measurement)
    for measurement in in_order:
        other.take(measurement)
    first, second = one.estimate(), other.estimate()
    assert first is not None
    assert second is not None
    assert first.stamp_ns == second.stamp_ns
    np.testing.assert_allclose(first.pose, second.pose, atol=0.02)


def test_what_comes_after_all_of_its_time_has_been_heeded_is_left_out_and_counted() -> None:
    robot = Localizer(FIELD, CAMERA)
    for k in range(100):
        robot.take(Odometry(ns(0.02 * k), np.zeros(3)))
    robot.take(Compass(ns(0.5), 0.0, 0.1))
    assert robot.late == 1
    assert robot.warnings == ("1 measurements came too late",)


def test_a_clock_that_is_set_costs_a_moment() -> None:
    robot, now = Localizer(FIELD, CAMERA, start=np.zeros(3)), None
    for begin_s in (100.0, 10.0, 500.0, 20.0):
        for k in range(200):
            robot.take(Odometry(ns(begin_s + 0.02 * k), np.array([0.1, 0.0, 0.0])))
        now = robot.estimate()
        assert now is not None
        assert now.stamp_ns == ns(begin_s + 3.98)
    # what was left out, and how long a velocity is believed where the clock jumps ahead, is not gone
    assert now is not None
    assert now.pose[0] == pytest.approx(0.1 * 4 * 3.98, abs=0.15)
    assert robot.late < 50


def test_who_knows_nothing_says_nothing() -> None:
    robot = Localizer(FIELD, CAMERA)
    assert robot.estimate() is None
    assert robot.ambiguity() is None
    robot.take(Odometry(0, np.zeros(3)))
    assert robot.estimate() is None


def test_numbers_that_are_none_are_left_out_and_said() -> None:
    robot = Localizer(FIELD, CAMERA, start=np.zeros(3))
    for k in range(50):
        robot.take(Odometry(ns(0.02 * k), np.array([np.nan if k % 10 == 5 else 0.1, 0.0, 0.0])))
        robot.take(Compass(ns(0.02 * k), np.inf, 0.1))
    now = robot.estimate()
    assert now is not None
    assert now.pose[0] == pytest.approx(0.098, abs=0.01)
    (warning,) = robot.warnings
    assert " measurements left out, the first: " in warning
    assert "is no measurement" in warning
