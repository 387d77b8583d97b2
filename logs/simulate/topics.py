"""A game as the messages of a log: in the order in which they reach it."""

import heapq
import json
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from fieldloc.measurements import Compass, ImageFeatures, InitialPose, Odometry, Truth
from logs.schema import Record, topic_of
from logs.simulate.course import SAMPLE_NS
from logs.simulate.game import BEGIN_NS, Game
from logs.simulate.odometry import stated_covariance
from logs.simulate.pictures import PictureSettings, take_pictures
from logs.source import Encoded

SIMULATION = "fieldloc.simulation"
"""Name of the metadata record that says how a game was made and what was drawn for it."""


class Logged(NamedTuple):
    log_time_ns: int
    topic: str
    record: Record


def messages(game: Game) -> Iterator[Logged]:
    """All of the game in the order of log time, but for pictures."""
    topics = (_head(game), _truths(game), _odometry(game), _compass(game), _images(game))
    return heapq.merge(*topics, key=lambda message: message.log_time_ns)


def messages_with_pictures(game: Game, settings: PictureSettings) -> Iterator[Logged | Encoded]:
    """As `messages`; what a detector finds in the pictures is left out unless the settings keep it."""
    sensors: list[Iterable[Logged | Encoded]] = [_head(game), _truths(game), _odometry(game), _compass(game)]
    if settings.observations:
        sensors.append(_images(game))
    return heapq.merge(*sensors, _pictures(game, settings), key=lambda message: message.log_time_ns)


def _head(game: Game) -> list[Logged]:
    """What is there from the beginning."""
    camera = game.scenario.vision.camera
    out: list[tuple[type, Record]] = [(type(game.field), game.field), (type(camera), camera)]
    if game.told is not None:
        s = game.scenario.start
        covariance = np.diag([s.sigma_m, s.sigma_m, s.sigma_rad]) ** 2
        out.append((InitialPose, InitialPose(BEGIN_NS, game.told, covariance)))
    return [Logged(BEGIN_NS, topic_of(kind), record) for kind, record in out]


def _truths(game: Game) -> Iterator[Logged]:
    """None while the robot is in the air."""
    course, topic = game.course, topic_of(Truth)
    every = 1_000_000_000 // SAMPLE_NS // game.scenario.truth_hz
    chosen = np.arange(0, len(course.stamps_ns), every)
    chosen = chosen[~game.walk.carried[chosen]]
    poses = course.poses[chosen]
    for stamp_ns, pose in zip(course.stamps_ns[chosen].tolist(), poses, strict=True):
        yield Logged(stamp_ns, topic, Truth(stamp_ns, pose))


def _odometry(game: Game) -> Iterator[Logged]:
    believed, topic = game.believed, topic_of(Odometry)
    covariance = stated_covariance(game.scenario.odometry)
    latencies = game.delivery.latencies_ns(len(believed.stamps_ns), game.random["odometry_latency"])
    log_times = game.delivery.arrivals_ns(believed.stamps_ns + latencies)
    kept = game.delivery.kept(log_times)
    rows = (log_times[kept].tolist(), believed.stamps_ns[kept].tolist(), believed.velocities[kept])
    for log_time_ns, stamp_ns, velocity in zip(*rows, strict=True):
        yield Logged(log_time_ns, topic, Odometry(stamp_ns, velocity, covariance))


def _compass(game: Game) -> Iterator[Logged]:
    headings, topic = game.headings, topic_of(Compass)
    sigma_rad = game.scenario.compass.stated_sigma_rad
    latencies = game.delivery.latencies_ns(len(headings.stamps_ns), game.random["compass_latency"])
    log_times = game.delivery.arrivals_ns(headings.stamps_ns + latencies)
    kept = game.delivery.kept(log_times)
    rows = (log_times[kept].tolist(), headings.stamps_ns[kept].tolist(), headings.headings_rad[kept].tolist())
    for log_time_ns, stamp_ns, heading_rad in zip(*rows, strict=True):
        yield Logged(log_time_ns, topic, Compass(stamp_ns, heading_rad, sigma_rad))


def _images(game: Game) -> Iterator[Logged]:
    topic = topic_of(ImageFeatures)
    for ready_ns, features in game.camera.images(game.course, game.field):
        log_times = game.delivery.arrivals_ns(np.array([ready_ns]))
        if game.delivery.kept(log_times)[0]:
            yield Logged(int(log_times[0]), topic, features)


def _pictures(game: Game, settings: PictureSettings) -> Iterator[Encoded]:
    from logs.foxglove.pictures import picture_messages

    vision, random = game.scenario.vision, game.random["pictures"]
    for picture in take_pictures(game.camera, game.course, game.field, vision, settings, random):
        log_times = game.delivery.arrivals_ns(np.array([picture.ready_ns]))
        if game.delivery.kept(log_times)[0]:
            yield from picture_messages(picture.data, "jpeg", picture.mount, picture.stamp_ns, int(log_times[0]))


def simulation_metadata(game: Game, seed: int) -> dict[str, str]:
    """The scenario, the seed, and what was drawn: numbers that a calibration should find again."""
    calibration, magnetics = game.believed.calibration, game.headings.magnetics
    drawn = {
        "start_pose": game.course.poses[0].tolist(),
        "odometry": calibration._asdict(),
        "odometry_delay_s": game.scenario.odometry.delay_s,
        "hard_iron": magnetics.hard_iron.tolist(),
        "declination_rad": magnetics.declination_rad,
        "steel": magnetics.steel.tolist(),
        "camera": dict(game.camera.truth),
        "events": [event._asdict() for event in game.walk.happened],
        "stalls_ns": game.delivery.stalls_ns.tolist(),
        "gaps_ns": game.delivery.gaps_ns.tolist(),
    }
    return {"scenario": game.scenario.to_json(), "seed": str(seed), "drawn": json.dumps(drawn)}
