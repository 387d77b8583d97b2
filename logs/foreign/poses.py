"""Poses that others know or believe, seen from above: truth, estimates, a pose told from outside."""

from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

import numpy as np

from estimators.base import Estimate
from fieldloc import pose as se2
from fieldloc.measurements import InitialPose, Truth
from fieldloc.pose import FloatArray
from logs.foreign.frames import plain
from logs.foreign.parts import OdometryPart, Part, PosePart
from logs.foreign.planar import planar_covariance
from logs.foreign.rotations import STILL, Motion, compose, motion, on_the_ground
from logs.foreign.settings import InitialPoseSettings
from logs.foreign.surroundings import FIELD_NAMES, Surroundings, Unusable, last

P = TypeVar("P", Truth, InitialPose, Estimate)
Make = Callable[[int, FloatArray, FloatArray | None], P]


class PoseAdapter(Generic[P]):
    """through_transforms: whether a pose in another frame than a map is carried there, for which an estimate serves."""

    def __init__(self, surroundings: Surroundings, make: Make[P], through_transforms: bool = True) -> None:
        self._around = surroundings
        self._make: Make[P] = make
        self._through_transforms = through_transforms

    def take(self, topic: str, stamp_ns: int, part: Part) -> Iterator[P]:
        child = ""
        if isinstance(part, OdometryPart):
            child, part = part.twist.frame, part.pose
        if not isinstance(part, PosePart):
            return
        found = motion(part.position, part.rotation)
        if found is None:
            raise Unusable("its position or rotation is not a number")
        whole = compose(
            compose(self._map_from(part.frame, stamp_ns), found), self._around.child_from_robot(child, stamp_ns)
        )
        field_from_map = np.array(self._around.mapping.frames.field_from_map)
        pose = se2.compose(field_from_map, on_the_ground(whole))
        covariance = None if part.covariance is None else planar_covariance(part.covariance)
        if covariance is not None:
            covariance = se2.rotate_covariance(covariance, field_from_map[2])
        yield self._make(stamp_ns, pose, covariance)

    def finish(self) -> Iterator[P]:
        return iter(())

    def _map_from(self, frame: str, stamp_ns: int) -> Motion:
        """A frame that is no map, such as odom, is one where the log's transforms say how it stands in the map."""
        frame, told = plain(frame), plain(self._around.mapping.frames.field)
        if not self._through_transforms or (frame == told if told else last(frame) in FIELD_NAMES):
            return STILL
        frames = self._around.frames
        here = told or next((name for name in frames.names if last(name) in FIELD_NAMES), "")
        if not here or not frames.are_connected(here, frame):
            return STILL
        found = frames.motion(here, frame, stamp_ns)
        if found is None:
            raise Unusable(f"no transform from {here} to {frame} near its stamp")
        return found


def truth(stamp_ns: int, pose: FloatArray, covariance: FloatArray | None) -> Truth:
    return Truth(stamp_ns, pose)


def estimate(stamp_ns: int, pose: FloatArray, covariance: FloatArray | None) -> Estimate:
    """Zeros where no covariance is stated: an evaluation then says that there is none."""
    return Estimate(stamp_ns, pose, np.zeros((3, 3)) if covariance is None else covariance)


def initial_pose(settings: InitialPoseSettings) -> Make[InitialPose]:
    usual = np.diag(np.square([settings.sigma_m, settings.sigma_m, settings.heading_sigma_rad]))

    def make(stamp_ns: int, pose: FloatArray, covariance: FloatArray | None) -> InitialPose:
        return InitialPose(stamp_ns, pose, usual if covariance is None else covariance)

    return make
