"""What an estimator eats: one instant's knowledge about the pose as an error with a covariance.

Every estimator uses these same errors; none has a measurement model of its own. `error(poses)` is zero-mean with the
factor's covariance at the true pose, and `jacobian` is its derivative by the robot-frame tangent at a pose. A factor
that is `by_sight` is about the pose at which a sensor on the robot saw something (MixtureFactor.by_sight).
"""

from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from fieldloc import pose as se2
from fieldloc.fixes.base import Fix
from fieldloc.pose import FloatArray


class Factor(Protocol):
    """m numbers that would be zero at the true pose if nothing were noisy."""

    @property
    def stamp_ns(self) -> int: ...

    @property
    def covariance(self) -> FloatArray:
        """(m, m) of the error at the true pose."""

    def error(self, poses: FloatArray) -> FloatArray:
        """(..., m) for field_from_robot poses (..., 3)."""

    def jacobian(self, pose: FloatArray) -> FloatArray:
        """(m, 3) of the error by the robot-frame tangent at one pose (3,)."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseFactor:
    """A whole pose (3,), from an analytic fix or told from outside. covariance: (3, 3) in the robot frame of `pose`."""

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray
    by_sight: bool = False

    @classmethod
    def from_fix(cls, stamp_ns: int, fix: Fix) -> "PoseFactor":
        return cls(stamp_ns, fix.pose, se2.rotate_covariance(fix.covariance, -fix.pose[2]))

    def error(self, poses: FloatArray) -> FloatArray:
        return se2.local(self.pose, poses)

    def jacobian(self, pose: FloatArray) -> FloatArray:
        return se2.right_jacobian_inverse(self.error(pose))


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkFactor:
    """One identified landmark, for when there is no fix: it ties the pose to a circle, the heading to the place on it.

    landmark: (2,) on the map. seen: (2,) where it was seen, robot frame; covariance (2, 2) of that, robot frame.
    """

    stamp_ns: int
    landmark: FloatArray
    seen: FloatArray
    covariance: FloatArray
    by_sight: bool = False

    def error(self, poses: FloatArray) -> FloatArray:
        return se2.apply(se2.inverse(poses), self.landmark) - self.seen

    def jacobian(self, pose: FloatArray) -> FloatArray:
        x, y = se2.apply(se2.inverse(pose), self.landmark)
        return np.array([[-1.0, 0.0, y], [0.0, -1.0, -x]])


@dataclass(frozen=True, slots=True, eq=False)
class HeadingFactor:
    """The robot's heading in the field frame. covariance: (1, 1) rad^2.

    by_compass: it is a magnetometer's, so it also holds an offset that stays alike for a while. wider: by how much the
    covariance was widened for being much the same as the last one's; whether it is right at all shows without that.
    """

    stamp_ns: int
    heading_rad: float
    covariance: FloatArray
    by_compass: bool = False
    wider: float = 1.0

    def error(self, poses: FloatArray) -> FloatArray:
        return se2.wrap(poses[..., 2:3] - self.heading_rad)

    def jacobian(self, pose: FloatArray) -> FloatArray:
        return np.array([[0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class LineFactor:
    """Heading and distance along one direction, for when lines of one family only are seen.

    normal_rad: direction of the unit vector n in the field along which the position is known; the other is free.
    heading_rad, offset_m: the heading, and n . position. covariance: (2, 2) of (heading, offset).
    """

    stamp_ns: int
    heading_rad: float
    normal_rad: float
    offset_m: float
    covariance: FloatArray
    by_sight: bool = False

    def error(self, poses: FloatArray) -> FloatArray:
        c, s = np.cos(self.normal_rad), np.sin(self.normal_rad)
        offset = c * poses[..., 0] + s * poses[..., 1] - self.offset_m
        return np.stack([se2.wrap(poses[..., 2] - self.heading_rad), offset], axis=-1)

    def jacobian(self, pose: FloatArray) -> FloatArray:
        between = self.normal_rad - pose[2]
        return np.array([[0.0, 0.0, 1.0], [np.cos(between), np.sin(between), 0.0]])


def innovation_covariance(factor: Factor, pose: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Jacobian (m, 3) at the pose, and covariance (m, m) of the factor's error for a pose that has `covariance` (3, 3),
    robot frame."""
    jacobian = factor.jacobian(pose)
    return jacobian, jacobian @ covariance @ jacobian.T + factor.covariance


AnyFactor = TypeVar("AnyFactor", bound=Factor)


def sighted(factor: AnyFactor) -> AnyFactor:
    """The same factor, as of something that a sensor on the robot saw."""
    return replace(factor, by_sight=True) if isinstance(factor, (PoseFactor, LandmarkFactor, LineFactor)) else factor


def is_by_sight(factor: Factor) -> bool:
    """Whether it is about the pose that a sensor on the robot saw something from."""
    return isinstance(factor, (PoseFactor, LandmarkFactor, LineFactor)) and factor.by_sight
