"""Odometry to motion: a velocity held between stamps, the motion it makes and how uncertain that is."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimators.config import MotionNoise
from fieldloc import pose as se2
from fieldloc.measurements import Odometry
from fieldloc.pose import FloatArray

_MAX_GAP_S = 60.0  # a longer silence, or a clock that jumped, makes the pose no more unknown than this
_MAX_PERIOD_S = 1.0
# all of a motion, and what is left of it from its end back to Gauss's two points: exact up to cubic, so straight ahead
_WHOLE_AND_BACK = np.array([[1.0], [-0.5 - 0.5 / 3**0.5], [-0.5 + 0.5 / 3**0.5]])


class OdometryCalibration(NamedTuple):
    """What odometry gets wrong in the same way all the time. All zero is a perfect one.

    Distances are longer by `scale`, turns by `turn_scale`; the robot turns `veer_rad_per_m` while it means to walk
    straight, and walks `crab_rad` to the left of where its heading points. `drift_mps` forward and `turn_drift_radps`
    are there at standstill too: a rate sensor's offset.
    """

    scale: float = 0.0
    turn_scale: float = 0.0
    veer_rad_per_m: float = 0.0
    crab_rad: float = 0.0
    drift_mps: float = 0.0
    turn_drift_radps: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Increment:
    """Motion over an interval: field_from_after = field_from_before @ before_from_after.

    covariance: (3, 3) of its error, a robot-frame tangent at the end.
    by_calibration: (3, 6) the change of that tangent with the odometry's calibration.
    """

    before_from_after: FloatArray
    covariance: FloatArray
    by_calibration: FloatArray

    def then(self, other: "Increment") -> "Increment":
        back = se2.adjoint(se2.inverse(other.before_from_after))
        return Increment(
            se2.compose(self.before_from_after, other.before_from_after),
            back @ self.covariance @ back.T + other.covariance,
            back @ self.by_calibration + other.by_calibration,
        )

    def calibrated(self, calibration: FloatArray) -> "Increment":
        """The motion of an odometry with that calibration (6,), of which this is the uncalibrated one."""
        moved = se2.retract(self.before_from_after, self.by_calibration @ calibration)
        return replace(self, before_from_after=moved)

    @staticmethod
    def carry(covariance: FloatArray, before_from_after: FloatArray) -> FloatArray:
        """A robot-frame covariance (3, 3) before a motion, as one after it."""
        back = se2.adjoint(se2.inverse(before_from_after))
        return np.asarray(back @ covariance @ back.T)


STANDSTILL = Increment(np.zeros(3), np.zeros((3, 3)), np.zeros((3, 6)))


class HeldVelocity:
    """Turns odometry messages and the stamps at which the pose is asked for into increments.

    Stamps that run backwards move nothing; an odometry message older than the last one is not used.
    """

    def __init__(self, noise: MotionNoise) -> None:
        self._noise = noise
        self._odometry: Odometry | None = None
        self._period_s = 0.0
        self.stamp_ns: int | None = None

    def hold(self, odometry: Odometry) -> None:
        """Believe this velocity from now on."""
        if self._odometry is not None:
            elapsed_s = (odometry.stamp_ns - self._odometry.stamp_ns) * 1e-9
            if elapsed_s < 0.0:
                return
            if elapsed_s > 0.0:  # a message that comes twice says nothing of the period
                self._period_s = min(elapsed_s, _MAX_PERIOD_S)
        self._odometry = odometry

    def advance(self, stamp_ns: int) -> Increment | None:
        """The motion from the last stamp to this one; None if no time passes."""
        before_ns, self.stamp_ns = self.stamp_ns, stamp_ns if self.stamp_ns is None else max(stamp_ns, self.stamp_ns)
        if before_ns is None or stamp_ns <= before_ns:
            return None
        held_s = 0.0
        if self._odometry is not None:
            held_until_ns = self._odometry.stamp_ns + int(self._noise.max_hold_s * 1e9)
            held_s = max(0, min(stamp_ns, held_until_ns) - before_ns) * 1e-9
        silent_s = min((stamp_ns - before_ns) * 1e-9 - held_s, _MAX_GAP_S)
        out = self._held(held_s) if held_s > 0.0 else STANDSTILL
        return out if silent_s <= 1e-9 else out.then(self._silent(silent_s))

    def _held(self, duration_s: float) -> Increment:
        assert self._odometry is not None
        velocity, stated = self._odometry.velocity, self._odometry.covariance
        tangent = velocity * duration_s
        moved, *back = se2.exp(_WHOLE_AND_BACK * tangent)
        spread = se2.right_jacobian(tangent)
        if stated is None:
            # white along the way: each part of it is carried to the end
            to_end = se2.adjoint(np.array(back))
            carried = to_end @ self._density(velocity) @ np.swapaxes(to_end, -1, -2)
            covariance = carried.mean(axis=0) * duration_s
        else:
            # one error for all of a message: over a part of its period it counts in proportion
            covariance = spread @ stated @ spread.T * ((self._period_s or duration_s) * duration_s)
        forward, left, turn = tangent
        by_calibration = np.array(
            [
                [forward, 0.0, 0.0, -left, duration_s, 0.0],
                [left, 0.0, 0.0, forward, 0.0, 0.0],
                [0.0, turn, forward, 0.0, 0.0, duration_s],
            ]
        )
        return Increment(moved, covariance, spread @ by_calibration)

    def _density(self, velocity: FloatArray) -> FloatArray:
        n = self._noise
        forward, left, turn = velocity.tolist()
        speed = (forward * forward + left * left) ** 0.5
        idle_m2, idle_rad2 = n.idle_m_per_sqrt_s**2, n.idle_rad_per_sqrt_s**2
        # sideways motion is as uncertain along its way as forward motion is
        along2, across2 = n.forward_m_per_sqrt_m**2, n.sideways_m_per_sqrt_m**2
        return np.diag(
            [
                along2 * abs(forward) + across2 * abs(left) + idle_m2,
                along2 * abs(left) + across2 * abs(forward) + idle_m2,
                n.turn_rad_per_sqrt_rad**2 * abs(turn) + n.turn_rad_per_sqrt_m**2 * speed + idle_rad2,
            ]
        )

    def _silent(self, duration_s: float) -> Increment:
        position, heading = self._noise.silent_m_per_sqrt_s**2, self._noise.silent_rad_per_sqrt_s**2
        return Increment(np.zeros(3), np.diag([position, position, heading]) * duration_s, np.zeros((3, 6)))
