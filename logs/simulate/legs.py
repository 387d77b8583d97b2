"""Pieces of a walk: from rest to rest, or standing, as body velocities at the course's rate."""

from math import ceil, pi, sqrt

import numpy as np

from fieldloc import pose as se2
from fieldloc.pose import FloatArray
from logs.simulate.course import SAMPLE_NS
from logs.simulate.settings import WalkSettings

SAMPLE_S = SAMPLE_NS * 1e-9


def samples(duration_s: float) -> int:
    """At least one."""
    return max(1, round(duration_s / SAMPLE_S))


def standing(duration_s: float) -> FloatArray:
    """(m, 3) zeros."""
    return np.zeros((samples(duration_s), 3))


def leg(settings: WalkSettings, tangent: FloatArray, effort: float = 1.0, weave_radps: float = 0.0) -> FloatArray:
    """(m, 3) velocities along a tangent (3,), so on an arc of a circle, as fast as the settings allow times `effort`.

    They end at exactly exp(tangent) from where they began, unless the heading weaves on the way: it swings to either
    side and ends as without. All parts of the motion share one profile: smooth ramps, a constant speed between them.
    """
    s = settings
    forward, left, turn = np.abs(tangent).tolist()
    speeds = (s.backward_mps if tangent[0] < 0 else s.forward_mps, s.left_mps, s.turn_radps)
    cruise_s = max(distance / speed for distance, speed in zip((forward, left, turn), speeds, strict=True)) / effort
    if cruise_s == 0.0:
        return np.zeros((0, 3))
    # how many seconds at full speed it takes to get there, for the axis that needs most
    ramp_s = max(
        0.5 * pi * sqrt(forward**2 + left**2) / cruise_s / s.acceleration_mps2,
        0.5 * pi * turn / cruise_s / s.turn_acceleration_radps2,
    )
    profile = _profile(cruise_s, ramp_s)
    out = profile[:, None] * (tangent / SAMPLE_S)
    if weave_radps:
        swings = max(1, round(len(out) * SAMPLE_S / 3.0))
        out[:, 2] += weave_radps * np.sin(2 * pi * swings * (np.arange(len(out)) + 0.5) / len(out))
    return np.asarray(out)


def path(start: FloatArray, velocities: FloatArray) -> FloatArray:
    """(m + 1, 3) poses: the start (3,), then after each velocity (m, 3) was held for one sample."""
    headings = start[2] + np.concatenate([[0.0], np.cumsum(velocities[:, 2] * SAMPLE_S)])
    steps = se2.exp(velocities * SAMPLE_S)[:, :2]
    c, s = np.cos(headings[:-1]), np.sin(headings[:-1])
    out = np.empty((len(velocities) + 1, 3))
    out[0], out[:, 2] = start, se2.wrap(headings)
    out[1:, 0] = start[0] + np.cumsum(c * steps[:, 0] - s * steps[:, 1])
    out[1:, 1] = start[1] + np.cumsum(s * steps[:, 0] + c * steps[:, 1])
    return out


def bump(tangent: FloatArray, duration_s: float) -> FloatArray:
    """(m, 3) velocities along a tangent (3,) in that time, no faster than it takes: what is done to the robot."""
    m = samples(duration_s)
    shape = np.sin(pi * (np.arange(m) + 0.5) / m) ** 2
    return np.asarray((shape / shape.sum())[:, None] * (tangent / SAMPLE_S))


def _profile(cruise_s: float, ramp_s: float) -> FloatArray:
    """(m,) share of the way in each sample: half a cosine up, constant, half a cosine down.

    A way that is too short for the full speed is one long ramp up and one down, with the acceleration it has got.
    """
    if ramp_s > cruise_s:
        ramp_s = cruise_s = sqrt(ramp_s * cruise_s)
    m = max(2, ceil((cruise_s + ramp_s) / SAMPLE_S))
    t = (np.arange(m) + 0.5) * SAMPLE_S
    nearest_end = np.minimum(t, m * SAMPLE_S - t)
    shape = 0.5 - 0.5 * np.cos(np.minimum(nearest_end / ramp_s, 1.0) * pi) if ramp_s > 0 else np.ones(m)
    return np.asarray(shape / shape.sum())
