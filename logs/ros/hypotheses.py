"""The poses that a robot may have as ROS 2 knows them: a PoseArray, which has no weights, the likeliest first."""

import struct
from collections.abc import Iterable, Iterator

from estimators.base import Ambiguity
from logs.ros.results import LITTLE_ENDIAN_CDR, USUAL, Frames, flat_pose, source, stamp_of
from logs.source import Encoded

TOPIC = "/fieldloc/hypotheses"

_LEAST_WEIGHT = 0.01


def pose_arrays(ambiguities: Iterable[Ambiguity], frames: Frames = USUAL) -> Iterator[Encoded]:
    """Those of at least 1 %. ValueError for a stamp that ROS 2 cannot hold."""
    channel = source(TOPIC, "geometry_msgs/msg/PoseArray")
    name = frames.field.encode() + b"\0"
    head = struct.pack("<I", len(name)) + name
    head += bytes(-len(head) % 4)
    for ambiguity in ambiguities:
        poses = [flat_pose(*one.pose.tolist()) for one in ambiguity.hypotheses if one.weight >= _LEAST_WEIGHT]
        body = struct.pack("<iI", *stamp_of(ambiguity.stamp_ns)) + head + struct.pack("<I", len(poses))
        if poses:  # CDR aligns what is there
            body += bytes(-len(body) % 8) + struct.pack(f"<{7 * len(poses)}d", *(x for pose in poses for x in pose))
        yield Encoded(channel, ambiguity.stamp_ns, LITTLE_ENDIAN_CDR + body)
