"""Many factors of one kind as arrays: errors and Jacobians of k factors at h poses in one sweep.

The same errors as in `fieldloc.factors`, which has them one by one; there the formulas are explained.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.factors import Factor, HeadingFactor, LandmarkFactor, LineFactor, PoseFactor
from fieldloc.pose import FloatArray


class FactorStack(Protocol):
    """k factors of m numbers each."""

    @property
    def covariances(self) -> FloatArray:
        """(k, m, m) of the errors at the true pose."""

    @property
    def curved(self) -> bool:
        """Whether the errors bend so much with the pose that they are to be linearised twice."""

    def errors(self, poses: FloatArray) -> FloatArray:
        """(..., k, m) at poses (..., 3)."""

    def jacobians(self, poses: FloatArray) -> FloatArray:
        """(..., k, m, 3) by the robot-frame tangent at poses (..., 3)."""

    def log_room(self, area_m2: float) -> FloatArray:
        """(k,) log of the integral of the error's density over all poses, within the area where a position is free."""

    def take(self, rows: NDArray[np.intp]) -> "FactorStack":
        """Those factors, in that order. Of rows (c, 1) c stacks of one each, at c poses."""

    def factor(self, stamp_ns: int, row: int) -> Factor: ...


@dataclass(frozen=True, slots=True, eq=False)
class PoseStack:
    """Whole poses (k, 3), covariances (k, 3, 3) in the robot frame of each."""

    poses: FloatArray
    covariances: FloatArray
    curved = True

    def errors(self, poses: FloatArray) -> FloatArray:
        return se2.local(self.poses, poses[..., None, :])

    def jacobians(self, poses: FloatArray) -> FloatArray:
        return se2.right_jacobian_inverse(self.errors(poses))

    def log_room(self, area_m2: float) -> FloatArray:
        return np.zeros(len(self.poses))

    def take(self, rows: NDArray[np.intp]) -> "PoseStack":
        return PoseStack(self.poses[rows], self.covariances[rows])

    def factor(self, stamp_ns: int, row: int) -> PoseFactor:
        return PoseFactor(stamp_ns, self.poses[row], self.covariances[row])


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkStack:
    """Single landmarks: on the map (k, 2), seen (k, 2) in the robot frame, covariances (k, 2, 2) of that."""

    landmarks: FloatArray
    seen: FloatArray
    covariances: FloatArray
    curved = True

    def errors(self, poses: FloatArray) -> FloatArray:
        return se2.apply(se2.inverse(poses)[..., None, :], self.landmarks) - self.seen

    def jacobians(self, poses: FloatArray) -> FloatArray:
        at = se2.apply(se2.inverse(poses)[..., None, :], self.landmarks)
        out = np.zeros((*at.shape, 3))
        out[..., 0, 0] = out[..., 1, 1] = -1.0
        out[..., 0, 2], out[..., 1, 2] = at[..., 1], -at[..., 0]
        return out

    def log_room(self, area_m2: float) -> FloatArray:
        return np.full(len(self.landmarks), np.log(2 * np.pi))

    def take(self, rows: NDArray[np.intp]) -> "LandmarkStack":
        return LandmarkStack(self.landmarks[rows], self.seen[rows], self.covariances[rows])

    def factor(self, stamp_ns: int, row: int) -> LandmarkFactor:
        return LandmarkFactor(stamp_ns, self.landmarks[row], self.seen[row], self.covariances[row])


@dataclass(frozen=True, slots=True, eq=False)
class LineStack:
    """Heading and distance along one direction (see LineFactor), arrays (k,); covariances (k, 2, 2).

    along_m: (k, 2) where on the line the robot can be, along the normal turned by +90 degrees.
    """

    heading_rad: FloatArray
    normal_rad: FloatArray
    offset_m: FloatArray
    along_m: FloatArray
    covariances: FloatArray
    curved = False

    def errors(self, poses: FloatArray) -> FloatArray:
        x, y, heading = (poses[..., None, i] for i in range(3))
        offset = np.cos(self.normal_rad) * x + np.sin(self.normal_rad) * y - self.offset_m
        return np.stack([se2.wrap(heading - self.heading_rad), offset], axis=-1)

    def jacobians(self, poses: FloatArray) -> FloatArray:
        between = self.normal_rad - poses[..., None, 2]
        out = np.zeros((*between.shape, 2, 3))
        out[..., 0, 2] = 1.0
        out[..., 1, 0], out[..., 1, 1] = np.cos(between), np.sin(between)
        return out

    def log_room(self, area_m2: float) -> FloatArray:
        return np.log(np.maximum(self.along_m[:, 1] - self.along_m[:, 0], 1e-6))

    def take(self, rows: NDArray[np.intp]) -> "LineStack":
        columns = (self.heading_rad, self.normal_rad, self.offset_m, self.along_m, self.covariances)
        return LineStack(*(column[rows] for column in columns))

    def factor(self, stamp_ns: int, row: int) -> LineFactor:
        heading_rad, normal_rad, offset_m = (float(a[row]) for a in (self.heading_rad, self.normal_rad, self.offset_m))
        return LineFactor(stamp_ns, heading_rad, normal_rad, offset_m, self.covariances[row])


@dataclass(frozen=True, slots=True, eq=False)
class HeadingStack:
    """The robot's heading in the field, (k,); covariances (k, 1, 1)."""

    heading_rad: FloatArray
    covariances: FloatArray
    curved = False

    def errors(self, poses: FloatArray) -> FloatArray:
        return se2.wrap(poses[..., None, 2] - self.heading_rad)[..., None]

    def jacobians(self, poses: FloatArray) -> FloatArray:
        out = np.zeros((*poses.shape[:-1], len(self.heading_rad), 1, 3))
        out[..., 2] = 1.0
        return out

    def log_room(self, area_m2: float) -> FloatArray:
        return np.full(len(self.heading_rad), np.log(area_m2))

    def take(self, rows: NDArray[np.intp]) -> "HeadingStack":
        return HeadingStack(self.heading_rad[rows], self.covariances[rows])

    def factor(self, stamp_ns: int, row: int) -> HeadingFactor:
        return HeadingFactor(stamp_ns, float(self.heading_rad[row]), self.covariances[row])
