"""Posts that a detector placed on the ground, to ranges and bearings from the robot.

They come from pixels, and how far away a pixel is follows from the camera's tilt: seen from a height h, a tilt that is
off by d moves a point at range r by (r^2 + h^2) / h d. Where h is not known, a share of the range stands for that.
"""

from collections.abc import Iterator

import numpy as np

from fieldloc.measurements import LandmarkScan
from fieldloc.pose import FloatArray
from logs.foreign.parts import Part, SpaceDetectionsPart
from logs.foreign.rotations import matrix
from logs.foreign.surroundings import Surroundings, Unusable

_NEAREST_M = 0.05


class ScanAdapter:
    def __init__(self, surroundings: Surroundings) -> None:
        self._around = surroundings

    def take(self, topic: str, stamp_ns: int, part: Part) -> Iterator[LandmarkScan]:
        if not isinstance(part, SpaceDetectionsPart):
            return
        if not np.isfinite(part.posts).all():
            raise Unusable("a detection holds a value that is not finite")
        if not len(part.posts):
            yield LandmarkScan(stamp_ns, (), np.zeros((0, 2)), np.zeros((0, 2, 2)))
            return
        noise = self._around.mapping.detections
        robot_from_frame = self._around.robot_from(part.frame, stamp_ns)
        posts = part.posts[~(part.post_confidences < noise.min_confidence)]
        in_robot = posts @ matrix(robot_from_frame.rotation).T + np.array(robot_from_frame.translation)
        range_m = np.hypot(in_robot[:, 0], in_robot[:, 1])
        in_robot, range_m = in_robot[range_m > _NEAREST_M], range_m[range_m > _NEAREST_M]
        bearing = np.arctan2(in_robot[:, 1], in_robot[:, 0])
        variances = np.zeros((len(range_m), 2, 2))
        variances[:, 0, 0] = noise.range_sigma_m**2 + self._range_sigma_m(range_m, stamp_ns) ** 2
        variances[:, 1, 1] = noise.bearing_sigma_rad**2
        yield LandmarkScan(stamp_ns, (None,) * len(range_m), np.stack([range_m, bearing], axis=-1), variances)

    def finish(self) -> Iterator[LandmarkScan]:
        return iter(())

    def _range_sigma_m(self, range_m: FloatArray, stamp_ns: int) -> FloatArray:
        """The part of it that grows with the range (n,)."""
        mapping = self._around.mapping
        try:
            height_m = self._around.mount("", stamp_ns).height_m
        except Unusable:
            return mapping.detections.range_sigma_relative * range_m
        return (range_m**2 + height_m**2) / height_m * mapping.mount.tilt_sigma_rad
