"""A game from a scenario and a seed: what happened, and what each sensor says of it."""

from dataclasses import dataclass

import numpy as np

from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray
from logs.simulate.compass import Headings, point_north
from logs.simulate.course import Course
from logs.simulate.delivery import Delivery
from logs.simulate.events import draw_events, touch_line_pose
from logs.simulate.odometry import Believed, believe
from logs.simulate.plan import Player
from logs.simulate.robots import make_way, walk_about
from logs.simulate.scenario import Scenario
from logs.simulate.sight import SimulatedCamera
from logs.simulate.walk import Walk, take_walk

BEGIN_NS = 1_000_000_000
"""The first sample's stamp. Not 0, which some viewers take for a missing stamp."""
_SMALLEST_M, _LARGEST_M = 1.0, 200.0

# One stream of random numbers each, so that no part's numbers depend on another's. New ones go to the end.
_PARTS = (
    "start",
    "told",
    "walk",
    "falls",
    "kidnappings",
    "penalties",
    "others",
    "odometry",
    "compass",
    "delivery",
    "odometry_latency",
    "compass_latency",
    "vision",
    "pictures",
)


@dataclass(frozen=True, slots=True, eq=False)
class Game:
    """told: (3,) where the robot is told that it starts, None if it is not told. random: what is left, by part."""

    scenario: Scenario
    field: FieldMap
    walk: Walk
    course: Course
    believed: Believed
    headings: Headings
    camera: SimulatedCamera
    told: FloatArray | None
    delivery: Delivery
    random: dict[str, np.random.Generator]


def play(scenario: Scenario, field: FieldMap, seed: int) -> Game:
    """FieldlocError where nobody could walk about on the field."""
    s = scenario
    bounds = field.bounds
    sides_m = bounds[2] - bounds[0], bounds[3] - bounds[1]
    if min(sides_m) < _SMALLEST_M or max(sides_m) > _LARGEST_M:
        raise FieldlocError(
            f"field {field.name}: measures {sides_m[0]:g} x {sides_m[1]:g} m; a game needs {_SMALLEST_M:g} to "
            f"{_LARGEST_M:g} m"
        )
    if s.start.pose and max(abs(s.start.pose[0]), abs(s.start.pose[1])) > _LARGEST_M:
        raise FieldlocError(f"start.pose: needs to be within {_LARGEST_M:g} m of the field's centre")
    seeds = np.random.SeedSequence(seed).spawn(len(_PARTS))
    random = {part: np.random.default_rng(own) for part, own in zip(_PARTS, seeds, strict=True)}

    start = np.array(s.start.pose) if s.start.pose else touch_line_pose(bounds, random["start"])
    events = draw_events(
        s.duration_s,
        bounds,
        (s.falls, random["falls"]),
        (s.kidnappings, random["kidnappings"]),
        (s.penalties, random["penalties"]),
    )
    player = Player(s.walk, bounds, random["walk"])
    walk = take_walk(start, s.start.stand_s, BEGIN_NS, s.duration_s, player, events)
    poses, velocities = walk.swaying(s.walk)
    others, bumped = make_way(walk_about(walk.stamps_ns, bounds, s.others, random["others"]), poses[:, :2])
    phase = walk.gait_phase_rad(s.walk)
    course = Course(
        walk.stamps_ns,
        poses,
        velocities,
        phase,
        walk.walking,
        walk.upright,
        walk.upright & ~walk.carried,
        others,
    )
    sigmas = np.array([s.start.sigma_m, s.start.sigma_m, s.start.sigma_rad])
    told = start + sigmas * random["told"].standard_normal(3) if s.start.told else None
    return Game(
        s,
        field,
        walk,
        course,
        believe(walk, phase, bumped, s.odometry, random["odometry"]),
        point_north(course, bounds, s.compass, random["compass"]),
        SimulatedCamera(s.vision, random["vision"]),
        told,
        Delivery(s.delivery, BEGIN_NS, s.duration_s, random["delivery"]),
        random,
    )
