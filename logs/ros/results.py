"""Estimates as ROS 2 knows them: a pose with covariance, an odometry and transforms, as `ros2 bag` records them."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from math import cos, sin
from typing import NamedTuple

from estimators.base import Estimate
from fieldloc.pose import FloatArray
from logs.ros.standard import standard_text
from logs.schema import ROS2_ESTIMATES
from logs.source import Encoded, Source

ODOMETRY_TOPIC = "/fieldloc/odometry"
TF_TOPIC = "/tf"

LITTLE_ENDIAN_CDR = b"\0\1\0\0"
_LAST_SECOND = 2**31 - 1
_CELLS = tuple((6 * row + column, i, j) for i, row in enumerate((0, 1, 5)) for j, column in enumerate((0, 1, 5)))
"""Where (x, y, heading) are among ROS's (x, y, z, about x, about y, about z): cell, our row, our column."""


@dataclass(frozen=True, slots=True)
class Frames:
    """What the field, the odometry's origin and the robot on the ground are called in ROS (REP 105 and 120)."""

    field: str = "map"
    odom: str = "odom"
    robot: str = "base_footprint"


USUAL = Frames()


def ros2_messages(
    estimate: Estimate, odom_from_robot: FloatArray | None, frames: Frames = USUAL
) -> tuple[Encoded, ...]:
    """PoseWithCovarianceStamped, Odometry and TFMessage of one estimate.

    odom_from_robot: (3,) where odometry alone has the robot at that stamp; the transforms are map to odom and odom to
    robot then, and map to robot without it. The odometry's twist is not known: zeros, as is its covariance, which is
    ROS's word for that. ValueError for a stamp that ROS 2's 32 bits of seconds do not hold (before 1970, after 2038).
    """
    stamp = stamp_of(estimate.stamp_ns)
    pose = flat_pose(*estimate.pose.tolist())
    known = (*pose, *_covariance(estimate.covariance))
    if odom_from_robot is None:
        tree, steps = _transforms_layout(frames.field, frames.robot), [pose]
    else:
        tree = _transforms_layout(frames.field, frames.odom, frames.robot)
        steps = [flat_pose(*_odom_in_field(estimate.pose, odom_from_robot)), flat_pose(*odom_from_robot.tolist())]
    datas = (
        _filled(_pose_layout(frames.field), stamp, [known]),
        _filled(_odometry_layout(frames.field, frames.robot), stamp, [known]),
        _filled(tree, stamp, steps),
    )
    return tuple(map(Encoded, sources(), (estimate.stamp_ns,) * 3, datas))


@cache
def sources() -> tuple[Source, Source, Source]:
    """Those of the messages, in their order."""
    return (
        source(ROS2_ESTIMATES, "geometry_msgs/msg/PoseWithCovarianceStamped"),
        source(ODOMETRY_TOPIC, "nav_msgs/msg/Odometry"),
        source(TF_TOPIC, "tf2_msgs/msg/TFMessage"),
    )


def source(topic: str, name: str) -> Source:
    encoding, text = standard_text(name)
    return Source(topic, "cdr", name, encoding, text, {"offered_qos_profiles": ""})  # as rosbag2 where it has none


def stamp_of(stamp_ns: int) -> tuple[int, int]:
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    if not 0 <= seconds <= _LAST_SECOND:
        raise ValueError(
            f"stamp {stamp_ns} ns is {seconds} s, which ROS 2's stamps cannot hold (0 to {_LAST_SECOND} s): "
            "count the log's time from a later zero, or write no ROS 2 messages"
        )
    return seconds, rest


def _odom_in_field(field_from_robot: FloatArray, odom_from_robot: FloatArray) -> tuple[float, float, float]:
    """field_from_robot composed with the inverse of odom_from_robot, on plain numbers for speed."""
    (x, y, heading), (odom_x, odom_y, odom_heading) = field_from_robot.tolist(), odom_from_robot.tolist()
    turn = heading - odom_heading
    c, s = cos(turn), sin(turn)
    return x - c * odom_x + s * odom_y, y - s * odom_x - c * odom_y, turn


def flat_pose(x: float, y: float, heading: float) -> tuple[float, ...]:
    """Position, and the quaternion (x, y, z, w) of a turn about the vertical."""
    return x, y, 0.0, 0.0, 0.0, sin(heading / 2), cos(heading / 2)


def _covariance(covariance: FloatArray) -> list[float]:
    """6 x 6 row by row. Height, roll and pitch are those of a robot on the ground: known, not unknown."""
    ours = covariance.tolist()
    out = [0.0] * 36
    for cell, i, j in _CELLS:
        out[cell] = ours[i][j]
    return out


class _Layout(NamedTuple):
    """A message in which stamps and numbers are still zero, and where these go: stamp, numbers."""

    template: bytes
    places: tuple[tuple[int, int], ...]


@cache
def _pose_layout(frame: str) -> _Layout:
    return _layout(b"", [((frame,), 7 + 36)])


@cache
def _odometry_layout(frame: str, child: str) -> _Layout:
    return _layout(b"", [((frame, child), 7 + 36 + 6 + 36)])


@cache
def _transforms_layout(*names: str) -> _Layout:
    """From each frame to the next."""
    steps = [((parent, child), 7) for parent, child in pairwise(names)]
    return _layout(struct.pack("<I", len(steps)), steps)


def _layout(start: bytes, parts: Sequence[tuple[tuple[str, ...], int]]) -> _Layout:
    """parts: one behind the other, each a stamp, names, and so many doubles. CDR aligns behind its own four bytes."""
    body = bytearray(start)
    places = []
    for names, doubles in parts:
        body += bytes(-len(body) % 4)
        stamp_at = len(body)
        body += bytes(8)
        for name in names:
            text = name.encode() + b"\0"
            body += bytes(-len(body) % 4) + struct.pack("<I", len(text)) + text
        body += bytes(-len(body) % 8)
        places.append((4 + stamp_at, 4 + len(body)))
        body += bytes(8 * doubles)
    return _Layout(LITTLE_ENDIAN_CDR + bytes(body), tuple(places))


def _filled(layout: _Layout, stamp: tuple[int, int], numbers: Sequence[Sequence[float]]) -> bytes:
    out = bytearray(layout.template)
    for (stamp_at, numbers_at), some in zip(layout.places, numbers, strict=True):
        struct.pack_into("<iI", out, stamp_at, *stamp)
        struct.pack_into(f"<{len(some)}d", out, numbers_at, *some)
    return bytes(out)
