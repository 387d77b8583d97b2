"""What was seen, as segments on the ground in the robot frame, ready to be drawn at any pose."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from fieldloc import pose as se2
from fieldloc.camera import Camera
from fieldloc.ground import robot_from_camera, robot_ground_points
from fieldloc.measurements import ImageFeatures, LandmarkScan
from fieldloc.pose import FloatArray
from logs.reader import LogFile
from logs.trajectory import IntArray

_BEARING_LENGTH_M = 15.0  # a ray without range is drawn so long
_FARTHEST_M = 30.0  # a pixel below the horizon may show a point of the ground kilometres away
_STEEPEST = 1e-6  # part of a ray that is along the ground, at least

Scan = LandmarkScan | ImageFeatures


class SegmentKind(IntEnum):
    LANDMARK = 0  # from the sensor to the landmark
    BEARING = 1  # from the camera towards a post whose foot was not seen
    LINE = 2  # a piece of a line


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """stamps_ns: (n,) of the scans and images, rising. ends: (n,) index behind each one's last segment.

    segments: (m, 4) x0, y0, x1, y1 in the robot frame, metres. kinds: (m,) of SegmentKind.
    """

    stamps_ns: IntArray
    ends: NDArray[np.intp]
    segments: FloatArray
    kinds: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.stamps_ns)


def load_seen(log: LogFile, most_segments: int) -> Seen:
    """What the log's scans and images show; of too many every second, third, ... one."""
    scans: list[Scan] = [*log.records(LandmarkScan)]
    camera = next(log.records(Camera), None)
    if camera is not None:
        scans += log.records(ImageFeatures)
    scans.sort(key=lambda scan: scan.stamp_ns)
    total = sum(_count(scan) for scan in scans)
    step = max(1, -(-total // most_segments))
    return seen(scans[::step], camera)


def seen(scans: Sequence[Scan], camera: Camera | None) -> Seen:
    """Scans in the order of their stamps; images show nothing without a camera."""
    parts: list[FloatArray] = []
    kinds: list[SegmentKind] = []
    ends = []
    for scan in scans:
        if isinstance(scan, LandmarkScan):
            parts.append(_of_scan(scan))
            kinds += [SegmentKind.LANDMARK] * len(parts[-1])
        elif camera is not None:
            for kind, segment in _of_image(scan, camera):
                parts.append(segment[None])
                kinds.append(kind)
        ends.append(len(kinds))
    stamps_ns = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)
    segments = np.concatenate([*parts, np.zeros((0, 4))])
    return Seen(stamps_ns, np.array(ends, dtype=np.intp), segments, np.array(kinds, dtype=np.uint8))


def _count(scan: Scan) -> int:
    return len(scan.labels) if isinstance(scan, LandmarkScan) else len(scan.posts) + len(scan.lines)


def _of_scan(scan: LandmarkScan) -> FloatArray:
    ranges, bearings = scan.range_bearing.reshape(-1, 2).T
    points = se2.apply(
        scan.robot_from_sensor, np.stack([ranges * np.cos(bearings), ranges * np.sin(bearings)], axis=-1)
    )
    start = np.broadcast_to(scan.robot_from_sensor[:2], points.shape)
    return np.concatenate([start, points], axis=-1)


def _of_image(image: ImageFeatures, camera: Camera) -> list[tuple[SegmentKind, FloatArray]]:
    """What is on the ground, cut where it is too far away to be drawn."""
    below = np.array([image.mount.x_m, image.mount.y_m])

    def on_ground(pixels: FloatArray) -> FloatArray | None:
        points, exists = robot_ground_points(camera, image.mount, pixels)
        near = exists.all() and np.linalg.norm(points - below, axis=-1).max() <= _FARTHEST_M
        return points if near else None

    out: list[tuple[SegmentKind, FloatArray]] = []
    for post in image.posts:
        foot = None if post.foot_px is None else on_ground(post.foot_px[None])
        if foot is not None:
            out.append((SegmentKind.LANDMARK, np.concatenate([below, foot[0]])))
        elif (bearing := _bearing(post.edges_px.mean(axis=0), image, camera)) is not None:
            out.append((SegmentKind.BEARING, np.concatenate([below, below + _BEARING_LENGTH_M * bearing])))
    for line in image.lines:
        if (points := on_ground(line.ends_px)) is not None:
            out.append((SegmentKind.LINE, points.ravel()))
    return out


def _bearing(pixel: FloatArray, image: ImageFeatures, camera: Camera) -> FloatArray | None:
    """(2,) unit vector over the ground, None where the pixel has no ray or looks straight up or down."""
    ray, exists = camera.ray(pixel)
    over_ground = (robot_from_camera(image.mount) @ ray)[:2]
    length = float(np.linalg.norm(over_ground))
    return over_ground / length if exists and length > _STEEPEST else None
