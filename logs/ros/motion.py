"""Poses, velocities and frames out of the values of ROS messages."""

from collections.abc import Callable
from math import isnan
from operator import itemgetter

from fieldloc.pose import FloatArray
from logs.foreign.parts import OdometryPart, PosePart, Transform, Transforms, TwistPart
from logs.ros.plan import Plan

SECOND = 1_000_000_000
STAMP = ("header.stamp", "header.frame_id")
_POSE = ("pose.position", "pose.orientation")


def stamp(plan: Plan, path: str = "header.stamp") -> tuple[int, int]:
    """Places of a stamp's seconds and nanoseconds: `sec` or `secs`, depending on the version of ROS."""
    names = ("sec", "nanosec") if f"{path}.sec" in plan.slots else ("secs", "nsecs")
    return plan.place(f"{path}.{names[0]}", "number"), plan.place(f"{path}.{names[1]}", "number")


def known(covariance: FloatArray) -> FloatArray | None:
    """(36,) row by row, as (6, 6). None for zeros, which is ROS's word for unknown, and where there is NaN."""
    numbers = (
        covariance.tolist()
    )  # sums and all on Python's numbers: numpy's overhead is more, and it warns of infinity
    return covariance.reshape(6, 6) if any(numbers) and not isnan(sum(numbers)) else None


def odometry(plan: Plan) -> Callable[[list[object]], OdometryPart]:
    position_at, position_in = plan.vector("pose.pose.position", "xyz")
    rotation_at, rotation_in = plan.vector("pose.pose.orientation", "xyzw")
    pose_at, pose_in = plan.vector("pose.covariance", 36)
    linear_at, linear_in = plan.vector("twist.twist.linear", "xyz")
    angular_at, angular_in = plan.vector("twist.twist.angular", "xyz")
    twist_at, twist_in = plan.vector("twist.covariance", 36)
    frames = plan.place("header.frame_id", "string"), plan.place("child_frame_id", "string")
    arrays = position_at, rotation_at, pose_at, linear_at, angular_at, twist_at
    pick = itemgetter(*stamp(plan), *frames, *arrays)

    def build(values: list[object]) -> OdometryPart:
        seconds, rest, frame, child, position, rotation, pose, linear, angular, twist = pick(values)
        stamp_ns = seconds * SECOND + rest
        return OdometryPart(
            PosePart(stamp_ns, frame, position[position_in], rotation[rotation_in], known(pose[pose_in])),
            TwistPart(stamp_ns, child, linear[linear_in], angular[angular_in], known(twist[twist_in])),
        )

    return build


def twist(plan: Plan) -> Callable[[list[object]], TwistPart]:
    """Without a header: neither stamp nor frame."""
    linear_at, linear_in = plan.vector("linear", "xyz")
    angular_at, angular_in = plan.vector("angular", "xyz")
    pick = itemgetter(linear_at, angular_at)

    def build(values: list[object]) -> TwistPart:
        linear, angular = pick(values)
        return TwistPart(None, "", linear[linear_in], angular[angular_in])

    return build


def stamped_twist(plan: Plan) -> Callable[[list[object]], TwistPart]:
    linear_at, linear_in = plan.vector("twist.linear", "xyz")
    angular_at, angular_in = plan.vector("twist.angular", "xyz")
    pick = itemgetter(*stamp(plan), plan.place("header.frame_id", "string"), linear_at, angular_at)

    def build(values: list[object]) -> TwistPart:
        seconds, rest, frame, linear, angular = pick(values)
        return TwistPart(seconds * SECOND + rest, frame, linear[linear_in], angular[angular_in])

    return build


def stamped_pose(plan: Plan) -> Callable[[list[object]], PosePart]:
    position_at, position_in = plan.vector("pose.position", "xyz")
    rotation_at, rotation_in = plan.vector("pose.orientation", "xyzw")
    pick = itemgetter(*stamp(plan), plan.place("header.frame_id", "string"), position_at, rotation_at)

    def build(values: list[object]) -> PosePart:
        seconds, rest, frame, position, rotation = pick(values)
        return PosePart(seconds * SECOND + rest, frame, position[position_in], rotation[rotation_in])

    return build


def stamped_pose_with_covariance(plan: Plan) -> Callable[[list[object]], PosePart]:
    position_at, position_in = plan.vector("pose.pose.position", "xyz")
    rotation_at, rotation_in = plan.vector("pose.pose.orientation", "xyzw")
    covariance_at, covariance_in = plan.vector("pose.covariance", 36)
    frame_at = plan.place("header.frame_id", "string")
    pick = itemgetter(*stamp(plan), frame_at, position_at, rotation_at, covariance_at)

    def build(values: list[object]) -> PosePart:
        seconds, rest, frame, position, rotation, covariance = pick(values)
        stamp_ns = seconds * SECOND + rest
        return PosePart(stamp_ns, frame, position[position_in], rotation[rotation_in], known(covariance[covariance_in]))

    return build


def transform(plan: Plan) -> Callable[[list[object]], Transforms]:
    one = _one_transform(plan, "")
    return lambda values: Transforms((one(values),))


def transforms(plan: Plan) -> Callable[[list[object]], Transforms]:
    get_rows = itemgetter(plan.place("transforms", "rows"))
    one = _one_transform(plan.rows["transforms"], "transforms.")
    return lambda values: Transforms(tuple([one(row) for row in get_rows(values)]))


def _one_transform(plan: Plan, path: str) -> Callable[[list[object]], Transform]:
    translation_at, translation_in = plan.vector(f"{path}transform.translation", "xyz")
    rotation_at, rotation_in = plan.vector(f"{path}transform.rotation", "xyzw")
    frames = plan.place(f"{path}header.frame_id", "string"), plan.place(f"{path}child_frame_id", "string")
    pick = itemgetter(*stamp(plan, f"{path}header.stamp"), *frames, translation_at, rotation_at)

    def build(values: list[object]) -> Transform:
        seconds, rest, parent, child, translation, rotation = pick(values)
        return Transform(seconds * SECOND + rest, parent, child, translation[translation_in], rotation[rotation_in])

    return build
