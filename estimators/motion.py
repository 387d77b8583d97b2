"""Odometry to motion: a velocity held between stamps, the motion it makes and how uncertain that is."""

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np

from estimators.config import MotionNoise
from estimators.recent import Recent
from estimators.silence import FALLEN, Silence
from fieldloc.measurements import Odometry
from fieldloc.one_pose import after, arc, composed, spread
from fieldloc.pose import FloatArray

MAX_GAP_S = 60.0  # a longer silence, or a clock that jumped, makes the pose no more unknown than this
MAX_PERIOD_S = 1.0
SAID = 3
PARTS = SAID + 2
"""Of the noise: along the way, of its heading by how far it turns, of its heading by how far it goes; and of what an
odometry states of itself: of the position, and of the heading with what goes along with it."""
# how much of a motion is left at Gauss's two points: exact up to cubic, so straight ahead
GAUSS_POINTS = (0.5 + 0.5 / 3**0.5, 0.5 - 0.5 / 3**0.5)
Number = TypeVar("Number", float, FloatArray)
_NONE = np.zeros((3, 3))
_NO_PARTS = np.zeros((PARTS, 3, 3))
_AS_SAID = np.ones(PARTS)


class OdometryCalibration(NamedTuple):
    """What odometry gets wrong in the same way all the time. All zero is a perfect one.

    Distances are longer by `scale`, turns by `turn_scale`; the robot turns `veer_rad_per_m` while it means to walk
    straight, and walks `crab_rad` to the left of where its heading points. `drift_mps` forward, `side_drift_mps` to the
    left and `turn_drift_radps` are there at standstill too: a rate sensor's offset. (Who walks askew drifts askew. A
    drift that could be forward only would tell how askew it walks from how its eyes are turned, which nothing does.)
    While it turns the robot is slower than it says, by `turn_slowing_s` of its speed for each rad/s: steps are shorter
    in a turn, wheels share their speed with it.
    """

    scale: float = 0.0
    turn_scale: float = 0.0
    veer_rad_per_m: float = 0.0
    crab_rad: float = 0.0
    drift_mps: float = 0.0
    side_drift_mps: float = 0.0
    turn_drift_radps: float = 0.0
    turn_slowing_s: float = 0.0


CALIBRATION = len(OdometryCalibration._fields)


def calibrated_velocity(velocity: FloatArray, calibration: FloatArray) -> FloatArray:
    """(3,) that a robot really has whose odometry of that calibration (c,) says `velocity` (3,)."""
    scale, turn_scale, veer, crab, drift, side_drift, turn_drift, slowing = calibration.tolist()
    forward, left, turn = velocity.tolist()
    scale -= slowing * abs(turn)
    return np.array(
        [
            forward * (1.0 + scale) - crab * left + drift,
            left * (1.0 + scale) + crab * forward + side_drift,
            turn * (1.0 + turn_scale) + veer * forward + turn_drift,
        ]
    )


def noise_density(noise: MotionNoise, forward: Number, left: Number, turn: Number) -> tuple[Number, ...]:
    """Four variances per second, of velocities without their signs: forward, to the left, of the heading as it turns
    and as it goes."""
    idle_m2, idle_rad2 = noise.idle_m_per_sqrt_s**2, noise.idle_rad_per_sqrt_s**2
    # sideways motion is as uncertain along its way as forward motion is
    along2, across2 = noise.forward_m_per_sqrt_m**2, noise.sideways_m_per_sqrt_m**2
    return (
        along2 * forward + across2 * left + idle_m2,
        along2 * left + across2 * forward + idle_m2,
        noise.turn_rad_per_sqrt_rad**2 * turn,
        noise.turn_rad_per_sqrt_m**2 * (forward * forward + left * left) ** 0.5 + idle_rad2,
    )


def stated_parts(covariance: FloatArray) -> FloatArray:
    """(..., PARTS, 3, 3) of covariances (..., 3, 3) that an odometry states of its velocity, each of them one too."""
    of_heading = covariance[..., :, 2]
    variance = np.where(of_heading[..., 2] > 0.0, of_heading[..., 2], 1.0)
    out = np.zeros((*covariance.shape[:-2], PARTS, 3, 3))
    out[..., SAID + 1, :, :] = of_heading[..., :, None] * of_heading[..., None, :] / variance[..., None, None]
    out[..., SAID, :, :] = covariance - out[..., SAID + 1, :, :]
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Increment:
    """Motion over an interval: field_from_after = field_from_before @ before_from_after.

    covariance: (3, 3) of its error, a robot-frame tangent at the end.
    by_calibration: (3, CALIBRATION) the change of that tangent with the odometry's calibration.
    parts: (PARTS, 3, 3) of the covariance, what comes of which noise; silence is in none of them.
    """

    before_from_after: FloatArray
    covariance: FloatArray
    by_calibration: FloatArray
    parts: FloatArray = field(default_factory=_NO_PARTS.copy)

    def then(self, other: "Increment") -> "Increment":
        back = after(other.before_from_after)
        return Increment(
            composed(self.before_from_after, other.before_from_after),
            back @ self.covariance @ back.T + other.covariance,
            back @ self.by_calibration + other.by_calibration,
            back @ self.parts @ back.T + other.parts,
        )

    def calibrated(self, calibration: FloatArray) -> "Increment":
        """The motion of an odometry with that calibration (c,), of which this is the uncalibrated one."""
        moved = np.array(arc(*(self.by_calibration @ calibration).tolist()))
        return Increment(composed(self.before_from_after, moved), self.covariance, self.by_calibration, self.parts)

    @property
    def back(self) -> FloatArray:
        """(3, 3) the robot-frame tangent after the motion with that before it."""
        return after(self.before_from_after)

    @staticmethod
    def carry(covariance: FloatArray, before_from_after: FloatArray) -> FloatArray:
        """A robot-frame covariance (3, 3) before a motion, as one after it."""
        back = after(before_from_after)
        return np.asarray(back @ covariance @ back.T)


STANDSTILL = Increment(np.zeros(3), np.zeros((3, 3)), np.zeros((3, CALIBRATION)))


class HeldVelocity:
    """Turns odometry messages and the stamps at which the pose is asked for into increments.

    Stamps that run backwards move nothing; an odometry message older than the last one is not used. scales: (PARTS,) by
    how much the variances are larger than is thought or stated. delay_s: what a message says happens so much later than
    its stamp.
    """

    def __init__(self, noise: MotionNoise, delay_s: float = 0.0) -> None:
        self._noise = noise
        self.delay_s = delay_s
        self._waiting: deque[Odometry] = deque()
        self.scales = _AS_SAID
        self._recent = Recent()
        self._silence = Silence()
        self._odometry: Odometry | None = None
        self._period_s = 0.0
        self.stamp_ns: int | None = None

    def hold(self, odometry: Odometry) -> None:
        """Believe this velocity from now on, or from when it is due."""
        if self.delay_s > 0.0:
            due_ns = odometry.stamp_ns + int(self.delay_s * 1e9)
            self._waiting.append(replace(odometry, stamp_ns=due_ns))
        else:
            self._hold(odometry)

    def _hold(self, odometry: Odometry) -> None:
        if self._odometry is not None:
            elapsed_s = (odometry.stamp_ns - self._odometry.stamp_ns) * 1e-9
            if elapsed_s < 0.0:
                return
            if elapsed_s > 0.0:  # a message that comes twice says nothing of the period
                self._period_s = min(elapsed_s, MAX_PERIOD_S)
        self._odometry = odometry
        self._recent.hold(odometry)

    @property
    def is_said(self) -> bool:
        """Whether there is odometry that does not state its covariance: it may be what the robot was told to do."""
        return self._odometry is not None and self._odometry.covariance is None

    def before(self, duration_s: float) -> FloatArray:
        """(3,) velocity that was held so long before the last stamp, a second at most."""
        return np.zeros(3) if self.stamp_ns is None else self._recent.at(self.stamp_ns, duration_s)

    def recent(self, duration_s: float) -> FloatArray:
        """(3,) velocity on the average of so long before the last stamp, a second at most; the present one for none."""
        return np.zeros(3) if self.stamp_ns is None else self._recent.mean(self.stamp_ns, duration_s)

    def advance(self, stamp_ns: int) -> Increment | None:
        """The motion from the last stamp to this one; None if no time passes."""
        motion = None
        while self._waiting and self._waiting[0].stamp_ns <= stamp_ns:
            motion = _joined(motion, self._advance(self._waiting[0].stamp_ns))
            self._hold(self._waiting.popleft())
        return _joined(motion, self._advance(stamp_ns))

    def looked(self) -> None:
        """There was an image at the last stamp."""
        if self.stamp_ns is not None:
            self._silence.end(self.stamp_ns)

    def doubted(self, covariance: FloatArray) -> FloatArray:
        """(3, 3) of a pose by this motion, on any axes: more where images have ceased to come.

        That is what is told; what is believed stays as it is. Most silences are none of a robot that fell, and the next
        image tells.
        """
        silent = self.stamp_ns is not None and self._silence.lasts(self.stamp_ns)
        return covariance + FALLEN if silent else covariance

    def _advance(self, stamp_ns: int) -> Increment | None:
        before_ns, self.stamp_ns = self.stamp_ns, stamp_ns if self.stamp_ns is None else max(stamp_ns, self.stamp_ns)
        if before_ns is None or stamp_ns <= before_ns:
            return None
        held_s = 0.0
        if self._odometry is not None:
            held_until_ns = self._odometry.stamp_ns + int(self._noise.max_hold_s * 1e9)
            held_s = max(0, min(stamp_ns, held_until_ns) - before_ns) * 1e-9
        silent_s = min((stamp_ns - before_ns) * 1e-9 - held_s, MAX_GAP_S)
        out = self._held(held_s) if held_s > 0.0 else STANDSTILL
        return out if silent_s <= 1e-9 else out.then(self._silent(silent_s))

    def _held(self, duration_s: float) -> Increment:
        assert self._odometry is not None
        velocity, stated = self._odometry.velocity, self._odometry.covariance
        tangent = velocity * duration_s
        forward, left, turn = tangent.tolist()
        by_rate = spread(forward, left, turn)
        if stated is None:
            density = noise_density(self._noise, *map(abs, velocity.tolist()))
            parts = _noise(density, forward, left, turn) * (duration_s * self.scales)[:, None, None]
            covariance = parts.sum(axis=0)
        else:
            # one error for all of a message: over a part of its period it counts in proportion
            known = stated_parts(stated) * ((self._period_s or duration_s) * duration_s * self.scales)[:, None, None]
            parts = by_rate @ known @ by_rate.T
            covariance = parts.sum(axis=0)
        turning = abs(float(velocity[2]))
        by_calibration = np.array(
            [
                [forward, 0.0, 0.0, -left, duration_s, 0.0, 0.0, -turning * forward],
                [left, 0.0, 0.0, forward, 0.0, duration_s, 0.0, -turning * left],
                [0.0, turn, forward, 0.0, 0.0, 0.0, duration_s, 0.0],
            ]
        )
        return Increment(np.array(arc(forward, left, turn)), covariance, by_rate @ by_calibration, parts)

    def _silent(self, duration_s: float) -> Increment:
        position, heading = self._noise.silent_m_per_sqrt_s**2, self._noise.silent_rad_per_sqrt_s**2
        return Increment(np.zeros(3), np.diag([position, position, heading]) * duration_s, np.zeros((3, CALIBRATION)))


def _noise(density: tuple[float, ...], forward: float, left: float, turn: float) -> FloatArray:
    """(PARTS, 3, 3) of a second with that motion, of noise that is white along the way: each bit is carried to the end.

    density: as of noise_density.
    """
    ahead, aside, by_turn, by_way = (0.5 * each for each in density)
    m00 = m01 = m11 = t00 = t01 = t11 = t02 = t12 = 0.0
    for point in GAUSS_POINTS:
        x, y, heading = arc(point * forward, point * left, point * turn)
        c, s = math.cos(heading), math.sin(heading)
        m00 += ahead * c * c + aside * s * s
        m01 += (aside - ahead) * c * s
        m11 += ahead * s * s + aside * c * c
        along, across = s * x - c * y, c * x + s * y  # how a turn before the rest of the way moves its end
        t00, t01, t11 = t00 + along * along, t01 + along * across, t11 + across * across
        t02, t12 = t02 + along, t12 + across
    points = len(GAUSS_POINTS)
    turned = np.array([t00, t01, t02, t01, t11, t12, t02, t12, points]).reshape(3, 3)
    moved = np.array([m00, m01, 0.0, m01, m11, 0.0, 0.0, 0.0, 0.0]).reshape(3, 3)
    return np.array([moved, by_turn * turned, by_way * turned, _NONE, _NONE])


def _joined(one: Increment | None, other: Increment | None) -> Increment | None:
    if one is None or other is None:
        return other if one is None else one
    return one.then(other)
