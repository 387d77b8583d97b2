"""The other robots: where they walk, and where they stand in the player's way."""

import numpy as np
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from logs.simulate.course import ROBOT_RADIUS_M
from logs.simulate.events import draw_intervals_ns
from logs.simulate.settings import OthersSettings

_TOUCH_M = 2 * ROBOT_RADIUS_M


def walk_about(
    stamps_ns: NDArray[np.int64],
    bounds: tuple[float, float, float, float],
    settings: OthersSettings,
    random: np.random.Generator,
) -> FloatArray:
    """(n, k, 2) from place to place, with pauses; NaN while off the field."""
    out = np.empty((len(stamps_ns), settings.count, 2))
    since_ns = stamps_ns - stamps_ns[0]
    duration_s = float(since_ns[-1]) * 1e-9
    low, high = np.array(bounds[:2]), np.array(bounds[2:])
    for robot in range(settings.count):
        at_s, places = [0.0], [random.uniform(low, high)]
        while at_s[-1] < duration_s:
            place = random.uniform(low, high)
            way_s = float(np.linalg.norm(place - places[-1])) / (settings.speed_mps * random.uniform(0.5, 1.0))
            at_s += [at_s[-1] + way_s, at_s[-1] + way_s + random.exponential(settings.pause_s)]
            places += [place, place]
        for axis in range(2):
            out[:, robot, axis] = np.interp(since_ns * 1e-9, at_s, np.array(places)[:, axis])
        absences = draw_intervals_ns(settings.absences_per_min, settings.absence_s, duration_s, random)
        for begin_ns, end_ns in absences:
            out[(since_ns >= begin_ns) & (since_ns < end_ns), robot] = np.nan
    return out


def make_way(others: FloatArray, positions: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """The others (n, k, 2) beside the player at `positions` (n, 2), none nearer than two robots touch; and (n,) whether
    one had to be pushed away for that."""
    away = others - positions[:, None]
    distance = np.linalg.norm(away, axis=-1)
    close = distance < _TOUCH_M  # not where it is NaN
    out = others.copy()
    direction = away[close] / np.maximum(distance[close], 1e-9)[:, None]
    out[close] = np.broadcast_to(positions[:, None], others.shape)[close] + _TOUCH_M * direction
    return out, close.any(axis=1)
