"""What online filters keep beside the pose, and the poses that what they hear and see is about.

The odometry moves the pose that is kept, at its own stamps. The robot itself may be late: where an odometry does not
say how sure it is, it may be what the robot was told to do. And what is seen is about the pose where the eyes were,
which are turned by their bearing offset and are late too (`estimators.sensor`). Only the sum of both delays shows in a
log; which part of it is the robot's, the prior sigmas say.
"""

import math
from dataclasses import dataclass

import numpy as np

from estimators.config import Config
from estimators.motion import CALIBRATION, HeldVelocity, calibrated_velocity
from estimators.sensor import SENSOR, lever
from fieldloc import pose as se2
from fieldloc.covariance import propagate
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.pose import FloatArray

EXTRA = CALIBRATION + SENSOR + 2
SIZE = 3 + EXTRA
EYES = slice(3 + CALIBRATION, 3 + CALIBRATION + SENSOR)
LATE = EYES.stop  # of the robot
OFFSET = SIZE - 1  # of the compass
"""Places in the tangent: that of the pose, the odometry's calibration, the eyes', the robot's delay, the compass'
offset."""
_HELD = np.eye(3, SIZE)
_EYES = slice(CALIBRATION, CALIBRATION + SENSOR)
_STILL = lever(np.zeros(3))
_NONE = np.zeros((3, 3))


def prior(config: Config) -> tuple[FloatArray, FloatArray]:
    """Mean (EXTRA,) and covariance (EXTRA, EXTRA) of what is kept beside the pose."""
    mean = np.concatenate([config.calibration.means(), config.sensor.means(), [0.0, 0.0]])
    eyes, compass = config.sensor.sigmas(), config.compass.offset_sigma_rad
    return mean, np.diag(np.concatenate([config.calibration.sigmas(), eyes, [0.0, compass]]) ** 2)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """by_state: (3, SIZE) the change of the tangent of a pose that something is about, with all that is kept. twist:
    (3,) of the way there for who keeps `at` (EXTRA,). chance: (3, 3) covariance of what is left open of it."""

    by_state: FloatArray
    twist: FloatArray
    at: FloatArray
    chance: FloatArray

    def of(self, poses: FloatArray, extra: FloatArray) -> FloatArray:
        """(..., 3) of poses (..., 3) that are kept, with (..., EXTRA) beside them."""
        return se2.retract(poses, self.beside(extra))

    def back(self, poses: FloatArray, extra: FloatArray) -> FloatArray:
        """The inverse."""
        return se2.retract(poses, -self.beside(extra))

    def covariance(self, of_state: FloatArray) -> FloatArray:
        """(..., 3, 3) of covariances (..., SIZE, SIZE)."""
        return propagate(self.by_state, of_state) + self.chance

    def of_state(self, covariance: FloatArray, known: FloatArray) -> FloatArray:
        """(..., SIZE, SIZE) of covariances (..., 3, 3) of poses that something is about, beside (..., EXTRA, EXTRA)
        known of the rest: the poses that are kept differ from them by what is not known of the rest."""
        aside = self.by_state[:, 3:]
        out = np.zeros((*covariance.shape[:-2], SIZE, SIZE))
        out[..., :3, 3:] = -aside @ known
        out[..., 3:, :3] = np.swapaxes(out[..., :3, 3:], -1, -2)
        out[..., :3, :3] = covariance + propagate(aside, known) + self.chance
        out[..., 3:, 3:] = known
        return out

    def beside(self, extra: FloatArray) -> FloatArray:
        """(..., 3) twists to the view's poses."""
        return np.asarray(self.twist + (extra - self.at) @ self.by_state[:, 3:].T)


class Views:
    """What is about which pose, for a filter whose odometry `held` is."""

    def __init__(self, config: Config, held: HeldVelocity) -> None:
        self._held = held
        self._unheard_s2 = config.calibration.odometry_delay_sigma_s**2
        self._late = False

    def heard(self) -> float:
        """Variance (s^2) that the robot's delay gains by what is known now of the odometry that is held: once, or
        zero."""
        if self._late or self._unheard_s2 == 0.0 or not self._held.is_said:
            return 0.0
        self._late = True
        return self._unheard_s2

    @property
    def same(self) -> bool:
        """Whether the robot is surely at the pose that is kept."""
        return not self._late

    def now(self, extra: FloatArray) -> View:
        """Of the robot itself. extra: (EXTRA,) as thought to be."""
        by_state, twist = _HELD.copy(), np.zeros(3)
        if self._late:
            late_s = float(extra[LATE - 3])
            by_state[:, LATE] = -self._velocity(late_s, extra)
            twist = -late_s * self._mean_velocity(late_s, extra)
        return View(by_state, twist, extra, _NONE)

    def sight(self, extra: FloatArray, known: FloatArray) -> View:
        """Of what the eyes see. known: (EXTRA, EXTRA) covariance of extra."""
        by_state = _HELD.copy()
        both = slice(LATE - 4, LATE - 2)
        late_s, sigma_s = float(extra[both].sum()), math.sqrt(max(known[both, both].sum(), 0.0))
        by_state[:, EYES] = lever(self._velocity(late_s, extra))
        by_state[:, LATE] = by_state[:, LATE - 1]
        twist = -late_s * self._mean_velocity(late_s, extra)
        twist += _STILL @ extra[_EYES]
        # how much of a sigma's way is not along a straight line
        early, later = (self._held.before(max(late_s + by * sigma_s, 0.0)) for by in (-2.0, 2.0))
        bent = 0.5 * sigma_s * (later - early)
        return View(by_state, twist, extra, bent[:, None] * bent)

    def compass(self, extra: FloatArray) -> View:
        """Of the heading that a compass shows."""
        view = self.now(extra)
        view.by_state[2, OFFSET] = 1.0
        view.twist[2] += extra[-1]
        return view

    def about(self, by_sight: bool, by_compass: bool, extra: FloatArray, known: FloatArray) -> View:
        if by_sight:
            return self.sight(extra, known)
        return self.compass(extra) if by_compass else self.now(extra)

    def _velocity(self, delay_s: float, extra: FloatArray) -> FloatArray:
        """When the last stamp was so long ahead."""
        return calibrated_velocity(self._held.before(max(delay_s, 0.0)), extra[:CALIBRATION])

    def _mean_velocity(self, delay_s: float, extra: FloatArray) -> FloatArray:
        """From then to the last stamp."""
        return calibrated_velocity(self._held.recent(max(delay_s, 0.0)), extra[:CALIBRATION])


def of_factor(views: Views, factor: Factor, extra: FloatArray, known: FloatArray) -> View:
    """Of a plain factor."""
    by_sight = isinstance(factor, (PoseFactor, LandmarkFactor, LineFactor)) and factor.by_sight
    by_compass = isinstance(factor, HeadingFactor) and factor.by_compass
    return views.about(by_sight, by_compass, extra, known)
