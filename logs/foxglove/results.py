"""fieldloc's results as Foxglove messages, ready for a file or a wire. Topics: `logs.foxglove.topics`.

Log times are the stamps of what is shown; so are the messages' own times. Whoever writes on another clock shifts the
log times. A stamp that Foxglove cannot hold (`shapes.LAST_STAMP_NS`) is a ValueError.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    FrameTransform,
    FrameTransforms,
    Odometry,
    Pose,
    PoseInFrame,
    PosesInFrame,
    SceneUpdate,
    Vector3,
)

from estimators.base import Estimate
from fieldloc import pose as se2
from fieldloc.field import FieldMap
from fieldloc.measurements import Truth
from fieldloc.pose import FloatArray
from logs.foxglove import shapes, topics
from logs.foxglove.encoded import encoded
from logs.foxglove.scene import entity, removal, replacement
from logs.foxglove.sights import measurement_messages
from logs.foxglove.throttle import Throttle
from logs.foxglove.topics import Frames
from logs.source import Encoded

__all__ = [
    "estimate_messages",
    "estimates_messages",
    "field_messages",
    "hypothesis_messages",
    "measurement_messages",
    "trajectory_messages",
]

_OWN = Frames()
_BLOCK = 2048  # estimates whose outlines are computed together
_FAN_LENGTH_M = 0.5
_OUTLINE_M = 0.02
_ABOVE_LINES_M = 0.01
_STEP_M, _STEP_RAD = 0.05, 0.1  # of a trajectory's thinning
_MOST_POSES = 5000
_ARROW_M = 0.4
_IN_SPACE = (0, 1, 5)  # x, y and the turn about z among the six of a pose in space


def field_messages(field: FieldMap, stamp_ns: int, frames: Frames = _OWN) -> tuple[Encoded, ...]:
    """The map, in place of any map shown before."""
    ground = entity("ground", stamp_ns, frames.field, triangles=[shapes.ground(field)])
    lines = entity("lines", stamp_ns, frames.field, triangles=shapes.white_lines(field))
    posts, labels = shapes.posts(field), shapes.labels(field)
    marks = entity("landmarks", stamp_ns, frames.field, cylinders=posts, texts=labels)
    return (encoded(topics.FIELD, stamp_ns, replacement(stamp_ns, [ground, lines, marks])),)


def estimate_messages(
    estimate: Estimate, odom_from_robot: FloatArray | None, frames: Frames = _OWN
) -> tuple[Encoded, ...]:
    """Pose, pose with covariance, transforms and uncertainty.

    odom_from_robot: (3,) where the odometry alone says it is; None puts the robot straight into the field.
    """
    odom = None if odom_from_robot is None else odom_from_robot[None]
    return tuple(estimates_messages([estimate], odom, frames))


def estimates_messages(
    estimates: Sequence[Estimate], odom_from_robot: FloatArray | None, frames: Frames = _OWN
) -> Iterator[Encoded]:
    """As `estimate_messages` for each, odom_from_robot (n, 3), but the uncertainty at most ten times a second."""
    throttle = Throttle()
    for first in range(0, len(estimates), _BLOCK):
        block = estimates[first : first + _BLOCK]
        odom = None if odom_from_robot is None else odom_from_robot[first : first + _BLOCK]
        yield from _block_messages(block, odom, frames, throttle)


def _block_messages(
    estimates: Sequence[Estimate], odom_from_robot: FloatArray | None, frames: Frames, throttle: Throttle
) -> Iterator[Encoded]:
    field_from_robot = np.array([estimate.pose for estimate in estimates])
    covariances = np.array([estimate.covariance for estimate in estimates])
    in_space = np.zeros((len(estimates), 6, 6))
    for row, of in enumerate(_IN_SPACE):
        in_space[:, of, _IN_SPACE] = covariances[:, row]
    shown = [throttle.passes(estimate.stamp_ns) for estimate in estimates]
    scenes = iter(_uncertainties([e for e, show in zip(estimates, shown, strict=True) if show], frames))
    links = _links(field_from_robot, odom_from_robot, frames)
    for i, (estimate, show) in enumerate(zip(estimates, shown, strict=True)):
        stamp_ns = int(estimate.stamp_ns)
        time, pose = shapes.timestamp(stamp_ns), shapes.flat_pose(*field_from_robot[i].tolist())
        yield encoded(topics.POSE, stamp_ns, PoseInFrame(timestamp=time, frame_id=frames.field, pose=pose))
        state = Odometry(
            timestamp=time,
            frame_id=frames.field,
            body_frame_id=frames.robot,
            pose=pose,
            pose_covariance=in_space[i].ravel().tolist(),
        )
        yield encoded(topics.STATE, stamp_ns, state)
        transforms = [
            FrameTransform(
                timestamp=time,
                parent_frame_id=parent,
                child_frame_id=child,
                translation=Vector3(x=x, y=y),
                rotation=shapes.about_z(heading),
            )
            for parent, child, poses in links
            for x, y, heading in [poses[i]]
        ]
        yield encoded(topics.TRANSFORMS, stamp_ns, FrameTransforms(transforms=transforms))
        if show:
            yield encoded(topics.UNCERTAINTY, stamp_ns, next(scenes))


def _links(
    field_from_robot: FloatArray, odom_from_robot: FloatArray | None, frames: Frames
) -> list[tuple[str, str, list[list[float]]]]:
    """Parent, child and parent_from_child at each estimate."""
    if odom_from_robot is None:
        return [(frames.field, frames.robot, field_from_robot.tolist())]
    field_from_odom = se2.compose(field_from_robot, se2.inverse(odom_from_robot))
    return [
        (frames.field, frames.odom, field_from_odom.tolist()),
        (frames.odom, frames.robot, odom_from_robot.tolist()),
    ]


def _uncertainties(estimates: Sequence[Estimate], frames: Frames) -> Iterator[SceneUpdate]:
    """The 3-sigma ellipse and fan of each; nothing where a covariance is none."""
    poses = np.array([estimate.pose for estimate in estimates]).reshape(-1, 3)
    covariances = np.array([estimate.covariance for estimate in estimates]).reshape(-1, 3, 3)
    outlines = shapes.ellipses(covariances[:, :2, :2])
    with np.errstate(invalid="ignore"):
        sigmas_rad = np.sqrt(covariances[:, 2, 2])
    fans = shapes.fans(poses[:, 2], sigmas_rad, _FAN_LENGTH_M)
    usable = np.isfinite(np.concatenate([outlines, fans], axis=1)).all(axis=(1, 2)).tolist()
    for estimate, (x, y, _), outline, fan, use in zip(estimates, poses.tolist(), outlines, fans, usable, strict=True):
        stamp_ns = int(estimate.stamp_ns)
        if not use:
            yield removal("uncertainty", stamp_ns)
            continue
        place = shapes.flat_pose(x, y, z_m=_ABOVE_LINES_M)
        lines = [
            shapes.loop(outline, place, shapes.BLUE, _OUTLINE_M),
            shapes.loop(fan, place, shapes.PALE_BLUE, _OUTLINE_M),
        ]
        yield SceneUpdate(entities=[entity("uncertainty", stamp_ns, frames.field, lines=lines)])


def trajectory_messages(
    estimates: Sequence[Estimate] | Sequence[Truth],
    stamp_ns: int,
    frames: Frames = _OWN,
    topic: str = topics.TRAJECTORY,
) -> tuple[Encoded, ...]:
    """All poses in one message, without those less than 5 cm and 0.1 rad of way behind the one before, 5000 at most."""
    poses = np.array([estimate.pose for estimate in estimates]).reshape(-1, 3)
    message = PosesInFrame(timestamp=shapes.timestamp(stamp_ns), frame_id=frames.field, poses=_poses(_thinned(poses)))
    return (encoded(topic, stamp_ns, message),)


def hypothesis_messages(
    poses: FloatArray, weights: FloatArray, stamp_ns: int, frames: Frames = _OWN
) -> tuple[Encoded, ...]:
    """Poses (n, 3) that all could be, with their weights (n,) of any sum: the likeliest first, and as arrows, the
    likelier the less transparent. Empty ones clear what was shown."""
    order = np.argsort(-weights, kind="stable")
    best_first, weights = _poses(poses[order]), weights[order]
    message = PosesInFrame(timestamp=shapes.timestamp(stamp_ns), frame_id=frames.field, poses=best_first)
    largest = max(weights.max(initial=0.0), np.finfo(float).tiny)
    arrows = [
        ArrowPrimitive(
            pose=pose,
            shaft_length=0.7 * _ARROW_M,
            shaft_diameter=0.1 * _ARROW_M,
            head_length=0.3 * _ARROW_M,
            head_diameter=0.25 * _ARROW_M,
            color=Color(r=0.2, g=0.6, b=1.0, a=0.1 + 0.9 * share),
        )
        for pose, share in zip(best_first, (weights / largest).tolist(), strict=True)
    ]
    shown = removal("hypotheses", stamp_ns)
    if arrows:
        shown = SceneUpdate(entities=[entity("hypotheses", stamp_ns, frames.field, arrows=arrows)])
    return encoded(topics.HYPOTHESES, stamp_ns, message), encoded(topics.WEIGHTS, stamp_ns, shown)


def _poses(poses: FloatArray) -> list[Pose]:
    return [shapes.flat_pose(*pose) for pose in poses.tolist()]


def _thinned(poses: FloatArray) -> FloatArray:
    """The first, the last, and each that begins another step of the way."""
    if len(poses) < 3:
        return poses
    moved_m = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=-1)
    turned_rad = np.abs(se2.wrap(np.diff(poses[:, 2])))
    way = np.concatenate([[0.0], np.cumsum(moved_m / _STEP_M + turned_rad / _STEP_RAD)])
    steps = np.floor(way * min(1.0, (_MOST_POSES - 2) / max(way[-1], 1.0)))
    kept = np.concatenate([[True], (np.diff(steps) > 0)[:-1], [True]])
    return np.asarray(poses[kept])
