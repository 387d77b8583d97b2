"""What the walk engine believes: its own steps, scaled, slipped and turned by a gyro that drifts."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.pose import FloatArray
from logs.simulate.course import SAMPLE_NS
from logs.simulate.legs import path
from logs.simulate.settings import OdometrySettings
from logs.simulate.walk import Walk

_MAX_JITTER = 0.4  # of a period: messages stay in order
_BUMP_S = 0.4
_ROUNDING = 1e-12  # metres: nobody moved


class Calibration(NamedTuple):
    """What this robot's odometry gets wrong all the time: what it says for one metre or radian, and its drift."""

    forward_scale: float
    left_scale: float
    turn_scale: float
    veer_rad_per_m: float
    gyro_bias_radps: float


class Believed(NamedTuple):
    """m messages: measured_ns (m,) when each velocity (m, 3) began to hold, stamps_ns (m,) as written beside it."""

    measured_ns: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    velocities: FloatArray
    calibration: Calibration


def believe(
    walk: Walk,
    gait_phase_rad: FloatArray,
    bumped: NDArray[np.bool_],
    settings: OdometrySettings,
    random: np.random.Generator,
) -> Believed:
    """The mean velocity of each message's own interval, as the engine takes it to be.

    bumped: (n,) the player runs into someone. Each kind of noise has a generator of its own.
    """
    s = settings
    for_calibration, for_ticks, for_steps, for_gyro, for_bumps, for_drops = random.spawn(6)
    calibration = Calibration(
        for_calibration.uniform(*s.forward_scale),
        for_calibration.uniform(*s.left_scale),
        for_calibration.uniform(*s.turn_scale),
        for_calibration.uniform(*s.veer_rad_per_m) if s.heading == "steps" else 0.0,
        s.gyro_bias_sigma_radps * for_calibration.standard_normal() if s.heading == "gyro" else 0.0,
    )
    ticks_ns = _ticks(walk.stamps_ns, s.rate_hz, s.jitter_s, for_ticks)
    period_s = np.diff(ticks_ns)[:, None] * 1e-9
    stepped = _fooled(walk) if s.fallen == "walking" else walk.stepped
    moved = _tangents(walk.stamps_ns, stepped, ticks_ns)
    step = np.floor(np.interp(ticks_ns[:-1], walk.stamps_ns, gait_phase_rad) / np.pi).astype(np.int64)
    slip = for_steps.standard_normal((int(step[-1]) + 1, 4))[step]
    length = np.hypot(moved[:, 0], moved[:, 1])
    said = np.empty_like(moved)
    said[:, 0] = moved[:, 0] * (calibration.forward_scale + s.slip_share * slip[:, 0])
    said[:, 1] = moved[:, 1] * (calibration.left_scale + s.slip_share * slip[:, 1])
    if s.heading == "steps":
        by_steps = s.slip_share * slip[:, 2] * moved[:, 2] + s.slip_rad_per_m * slip[:, 3] * length
        said[:, 2] = calibration.turn_scale * moved[:, 2] + calibration.veer_rad_per_m * moved[:, 0] + by_steps
    else:
        said[:, 2] = calibration.turn_scale * moved[:, 2] + _gyro(period_s[:, 0], calibration, s, for_gyro)
    said += _bumps(walk, bumped, ticks_ns, s, for_bumps)
    kept = for_drops.random(len(said)) >= s.drop_share
    if s.fallen == "silent":
        kept &= walk.upright[(ticks_ns[:-1] - walk.stamps_ns[0]) // SAMPLE_NS]
    measured_ns = ticks_ns[:-1][kept]
    return Believed(measured_ns, measured_ns + round(s.delay_s * 1e9), (said / period_s)[kept], calibration)


def stated_covariance(settings: OdometrySettings) -> FloatArray | None:
    """(3, 3) as the driver writes it into every message; None if it writes none."""
    if not (settings.stated_mps and settings.stated_radps):
        return None
    return np.diag([settings.stated_mps, settings.stated_mps, settings.stated_radps]) ** 2


def _ticks(
    stamps_ns: NDArray[np.int64], rate_hz: float, jitter_s: float, random: np.random.Generator
) -> NDArray[np.int64]:
    """(m + 1,) rising: when each message's interval begins, and where the last one ends."""
    period_ns = 1e9 / rate_hz
    regular = np.arange(0.0, float(stamps_ns[-1] - stamps_ns[0]), period_ns)
    late = np.clip(
        1e9 * jitter_s * random.standard_normal(len(regular)), -_MAX_JITTER * period_ns, _MAX_JITTER * period_ns
    )
    late[0] = 0.0
    begins = stamps_ns[0] + np.rint(regular + late).astype(np.int64)
    begins = begins[begins < stamps_ns[-1]]
    return np.append(begins, stamps_ns[-1])


def _tangents(stamps_ns: NDArray[np.int64], velocities: FloatArray, ticks_ns: NDArray[np.int64]) -> FloatArray:
    """(m, 3): exp of each is exactly the motion between two ticks of who moves with these velocities (n, 3)."""
    poses = path(np.zeros(3), velocities)
    at = np.minimum((ticks_ns - stamps_ns[0]) // SAMPLE_NS, len(stamps_ns) - 1)
    since_s = (ticks_ns - stamps_ns[at]) * 1e-9
    at_ticks = se2.compose(poses[at], se2.exp(velocities[at] * since_s[:, None]))
    moved = se2.local(at_ticks[:-1], at_ticks[1:])
    moved[np.abs(moved).max(axis=1) < _ROUNDING] = 0.0
    return moved


def _fooled(walk: Walk) -> FloatArray:
    """(n, 3) steps that go on in the engine's head after the fall, as they were before it."""
    last = np.where(walk.fooled, 0, np.arange(len(walk.stepped)))
    return walk.stepped[np.maximum.accumulate(last)]


def _gyro(
    period_s: FloatArray, calibration: Calibration, settings: OdometrySettings, random: np.random.Generator
) -> FloatArray:
    """(m,) radians too much in each interval."""
    wander, noise = random.standard_normal((2, len(period_s)))
    root_s = np.sqrt(period_s)
    bias = calibration.gyro_bias_radps + np.cumsum(settings.gyro_walk_radps_per_sqrt_s * wander * root_s)
    return np.asarray(bias * period_s + settings.gyro_noise_rad_per_sqrt_s * noise * root_s)


def _bumps(
    walk: Walk,
    bumped: NDArray[np.bool_],
    ticks_ns: NDArray[np.int64],
    settings: OdometrySettings,
    random: np.random.Generator,
) -> FloatArray:
    """(m, 3) motion that was believed in because feet slipped when the player ran into someone."""
    out = np.zeros((len(ticks_ns) - 1, 3))
    collides = bumped & walk.walking & walk.upright
    begins_ns = walk.stamps_ns[np.flatnonzero(collides[1:] & ~collides[:-1]) + 1]
    by_steps = settings.heading == "steps"  # a gyro is not fooled
    sigmas = np.array([settings.bump_m, settings.bump_m, settings.bump_rad if by_steps else 0.0])
    for begin_ns, slip in zip(begins_ns, sigmas * random.standard_normal((len(begins_ns), 3)), strict=True):
        here = np.flatnonzero((ticks_ns[:-1] >= begin_ns) & (ticks_ns[:-1] < begin_ns + round(_BUMP_S * 1e9)))
        if len(here):
            out[here] += slip / len(here)
    return out
