"""Parts to records: which adapter serves which role."""

from collections.abc import Iterator, Sequence
from math import isfinite
from typing import Protocol

import numpy as np

from estimators.base import Estimate
from fieldloc.measurements import Compass, ImageFeatures, InitialPose, LandmarkScan, Odometry, Truth
from logs.foreign.camera import CameraAdapter
from logs.foreign.compass import CompassAdapter
from logs.foreign.images import ImageAdapter
from logs.foreign.odometry import OdometryAdapter
from logs.foreign.parts import JointsPart, OdometryPart, Part, Transforms
from logs.foreign.poses import PoseAdapter, estimate, initial_pose, truth
from logs.foreign.scans import ScanAdapter
from logs.foreign.surroundings import Surroundings
from logs.schema import Record


class Adapter(Protocol):
    """Takes the messages of a role in the order of their log time; gives a record once it knows enough for it.

    take raises Unusable for a message that gives none.
    """

    def take(self, topic: str, stamp_ns: int, part: Part) -> Iterator[Record]: ...

    def finish(self) -> Iterator[Record]:
        """What was waiting for messages that did not come."""


def adapter(role: str, topics: Sequence[str], around: Surroundings) -> Adapter | None:
    """None for roles that give no record."""
    match role:
        case "odometry":
            return OdometryAdapter(around)
        case "camera":
            return CameraAdapter(around)
        case "image_features":
            return ImageAdapter(around, topics)
        case "landmarks":
            return ScanAdapter(around)
        case "compass":
            return CompassAdapter(around)
        case "truth":
            return PoseAdapter(around, truth, through_transforms=False)
        case "estimate":
            return PoseAdapter(around, estimate)
        case "initial_pose":
            return PoseAdapter(around, initial_pose(around.mapping.initial_pose))
        case _:
            return None


def is_finite(record: Record) -> bool:
    """Whether someone can compute with it."""
    match record:
        case Odometry():
            return bool(np.isfinite(record.velocity).all())
        case Truth() | Estimate() | InitialPose():
            return bool(np.isfinite(record.pose).all())
        case LandmarkScan():
            return bool(np.isfinite(record.range_bearing).all() and np.isfinite(record.covariance).all())
        case Compass():
            return isfinite(record.heading_rad)
        case ImageFeatures():
            seen = [*(post.edges_px for post in record.posts), *(line.ends_px for line in record.lines)]
            feet = [post.foot_px for post in record.posts if post.foot_px is not None]
            return all(bool(np.isfinite(pixels).all()) for pixels in (*seen, *feet))
        case _:
            return True


def stamp_of(part: Part) -> int | None:
    """What the message itself says; transforms each have their own."""
    if isinstance(part, OdometryPart):
        return part.pose.stamp_ns
    return None if isinstance(part, Transforms) else part.stamp_ns


def frames_of(part: Part) -> tuple[str, ...]:
    """The frames that the message names, but for transforms."""
    if isinstance(part, OdometryPart):
        return part.pose.frame, part.twist.frame
    return () if isinstance(part, Transforms | JointsPart) else (part.frame,)
