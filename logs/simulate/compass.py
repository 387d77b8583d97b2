"""What a magnetometer in a robot full of iron and motors takes for its heading."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.pose import FloatArray
from logs.simulate.course import Course
from logs.simulate.events import draw_intervals_ns
from logs.simulate.settings import CompassSettings

_JITTER = 0.1  # of a period


class Magnetics(NamedTuple):
    """hard_iron: (2,) on the robot, forward and left, when the game begins. steel: (k, 4) places x_m, y_m in the field
    and the field (2,) in their middles, field axes. All as shares of the earth's horizontal field."""

    hard_iron: FloatArray
    declination_rad: float
    steel: FloatArray


class Headings(NamedTuple):
    """stamps_ns (m,), headings_rad (m,) in [-pi, pi)."""

    stamps_ns: NDArray[np.int64]
    headings_rad: FloatArray
    magnetics: Magnetics


def point_north(
    course: Course,
    bounds: tuple[float, float, float, float],
    settings: CompassSettings,
    random: np.random.Generator,
) -> Headings:
    """Each kind of error has a generator of its own. Settings without a rate give no headings."""
    s = settings
    for_magnetics, for_ticks, for_iron, for_noise, for_motors, for_falls = random.spawn(6)
    magnetics = _magnetics(bounds, s, for_magnetics)
    if not s.rate_hz:
        return Headings(np.zeros(0, dtype=np.int64), np.zeros(0), magnetics)
    begin_ns, end_ns = int(course.stamps_ns[0]), int(course.stamps_ns[-1])
    period_ns = 1e9 / s.rate_hz
    regular = np.arange(0.0, float(end_ns - begin_ns), period_ns)
    stamps_ns = begin_ns + np.rint(regular + _JITTER * period_ns * for_ticks.random(len(regular))).astype(np.int64)
    stamps_ns = stamps_ns[stamps_ns <= end_ns]
    poses = course.poses_at(stamps_ns)
    at = course.index_at(stamps_ns)

    north = np.array([1.0, 0.0]) + _steel_at(magnetics.steel, poses[:, :2], s.steel_radius_m)
    in_robot = np.squeeze(se2.rotation(-poses[:, 2]) @ north[:, :, None], axis=-1)
    wander = s.hard_iron_walk_per_sqrt_s * np.sqrt(1.0 / s.rate_hz) * for_iron.standard_normal((len(stamps_ns), 2))
    measured = in_robot + magnetics.hard_iron + np.cumsum(wander, axis=0)
    headings = np.arctan2(-measured[:, 1], measured[:, 0]) + magnetics.declination_rad

    sigma = np.full(len(stamps_ns), s.sigma_rad)
    loud = _inside(
        stamps_ns - begin_ns,
        draw_intervals_ns(s.motor_bursts_per_min, s.motor_burst_s, (end_ns - begin_ns) * 1e-9, for_motors),
    )
    sigma[loud & course.walking[at]] += s.motor_sigma_rad
    headings += sigma * for_noise.standard_normal(len(stamps_ns))
    headings += np.where(course.upright[at], 0.0, s.fallen_sigma_rad * for_falls.standard_normal(len(stamps_ns)))
    return Headings(stamps_ns, se2.wrap(headings), magnetics)


def _magnetics(
    bounds: tuple[float, float, float, float], settings: CompassSettings, random: np.random.Generator
) -> Magnetics:
    s = settings
    strength, direction = random.uniform(*s.hard_iron), random.uniform(-np.pi, np.pi)
    declination_rad = random.uniform(*s.declination_rad)
    places = random.uniform(bounds[:2], bounds[2:], (s.steel_places, 2))
    strengths, directions = (
        random.uniform(*s.steel_strength, s.steel_places),
        random.uniform(-np.pi, np.pi, s.steel_places),
    )
    fields = strengths[:, None] * np.stack([np.cos(directions), np.sin(directions)], axis=-1)
    hard_iron = strength * np.array([np.cos(direction), np.sin(direction)])
    return Magnetics(hard_iron, declination_rad, np.hstack([places, fields]))


def _steel_at(steel: FloatArray, positions: FloatArray, radius_m: float) -> FloatArray:
    """(m, 2) the field of all places at positions (m, 2)."""
    distance = np.linalg.norm(positions[:, None] - steel[:, :2], axis=-1)
    return np.asarray(np.exp(-0.5 * (distance / radius_m) ** 2) @ steel[:, 2:])


def _inside(since_ns: NDArray[np.int64], intervals_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(m,) whether each moment lies in one of the intervals (n, 2)."""
    begins, ends = np.sort(intervals_ns[:, 0]), np.sort(intervals_ns[:, 1])
    begun, over = np.searchsorted(begins, since_ns, side="right"), np.searchsorted(ends, since_ns, side="right")
    return np.asarray(begun > over)
