"""Odometry, compass, truth, estimate and initial pose as JSON."""

from collections.abc import Sequence

import numpy as np
from msgspec import Raw

from estimators.base import Estimate
from fieldloc.measurements import Compass, InitialPose, Odometry, Truth
from fieldloc.pose import FloatArray
from logs.messages import batch
from logs.messages.fields import (
    STAMP,
    JsonObject,
    covariance,
    fixed,
    maybe,
    number,
    numeric,
    object_schema,
    or_null,
    stamp,
)

POSE: dict[str, JsonObject] = {
    "x_m": numeric("Robot in the field frame: towards the opponent's goal, from the field's centre"),
    "y_m": numeric("Robot in the field frame: to the left"),
    "heading_rad": numeric("Robot's forward axis, counter-clockwise from the field's x axis"),
}
POSE_COVARIANCE = fixed("Covariance of (x_m, y_m, heading_rad) in field axes", 3, 3)

ODOMETRY_SCHEMA = object_schema(
    "Velocity in the robot frame, held from this stamp to the next message's",
    stamp_ns=STAMP,
    forward_mps=numeric("Velocity along the robot's forward axis"),
    left_mps=numeric("Velocity to the robot's left"),
    turn_radps=numeric("Turning rate, counter-clockwise"),
    covariance=or_null(
        fixed("Covariance of (forward_mps, left_mps, turn_radps), white between messages; null: not stated", 3, 3)
    ),
)
COMPASS_SCHEMA = object_schema(
    "Heading of the robot in the field frame from a magnetometer",
    stamp_ns=STAMP,
    heading_rad=numeric("Robot's forward axis, counter-clockwise from the field's x axis"),
    sigma_rad=numeric("Standard deviation of the heading, above 0"),
)
TRUTH_SCHEMA = object_schema("Pose of the robot from a reference system", stamp_ns=STAMP, **POSE)
ESTIMATE_SCHEMA = object_schema("Estimated pose of the robot", stamp_ns=STAMP, **POSE, covariance=POSE_COVARIANCE)
INITIAL_POSE_SCHEMA = object_schema(
    "Pose of the robot told from outside", stamp_ns=STAMP, **POSE, covariance=POSE_COVARIANCE
)


def odometry_to_json(record: Odometry) -> JsonObject:
    forward, left, turn = record.velocity.tolist()
    return {
        "stamp_ns": int(record.stamp_ns),
        "forward_mps": forward,
        "left_mps": left,
        "turn_radps": turn,
        "covariance": None if record.covariance is None else record.covariance.tolist(),
    }


def odometry_from_json(data: JsonObject) -> Odometry:
    velocity = np.array([number(data, "forward_mps"), number(data, "left_mps"), number(data, "turn_radps")])
    return Odometry(stamp(data), velocity, maybe(data, "covariance", covariance, 3))


def compass_to_json(record: Compass) -> JsonObject:
    return {
        "stamp_ns": int(record.stamp_ns),
        "heading_rad": float(record.heading_rad),
        "sigma_rad": float(record.sigma_rad),
    }


def compass_from_json(data: JsonObject) -> Compass:
    return Compass(stamp(data), number(data, "heading_rad"), number(data, "sigma_rad", above=0.0))


def truth_to_json(record: Truth) -> JsonObject:
    return {"stamp_ns": int(record.stamp_ns), **pose_to_json(record.pose)}


def truth_from_json(data: JsonObject) -> Truth:
    return Truth(stamp(data), pose_from_json(data))


def estimate_to_json(record: Estimate | InitialPose) -> JsonObject:
    pose = pose_to_json(record.pose)
    return {"stamp_ns": int(record.stamp_ns), **pose, "covariance": record.covariance.tolist()}


def estimate_from_json(data: JsonObject) -> Estimate:
    return Estimate(stamp(data), pose_from_json(data), covariance(data, "covariance", 3))


def initial_pose_from_json(data: JsonObject) -> InitialPose:
    return InitialPose(stamp(data), pose_from_json(data), covariance(data, "covariance", 3))


def pose_to_json(pose: FloatArray) -> JsonObject:
    """A pose (3,) of anything in anything."""
    x, y, heading = pose.tolist()
    return {"x_m": x, "y_m": y, "heading_rad": heading}


def pose_from_json(data: JsonObject) -> FloatArray:
    return np.array([number(data, "x_m"), number(data, "y_m"), number(data, "heading_rad")])


class PoseMessage(batch.Message):
    x_m: float
    y_m: float
    heading_rad: float


class _OdometryMessage(batch.Message):
    stamp_ns: object
    forward_mps: float
    left_mps: float
    turn_radps: float
    covariance: Raw


class _CompassMessage(batch.Message):
    stamp_ns: object
    heading_rad: float
    sigma_rad: float


class _TruthMessage(PoseMessage):
    stamp_ns: object


class _EstimateMessage(PoseMessage):
    stamp_ns: object
    covariance: Raw


_read_odometry = batch.reader(_OdometryMessage)
_read_compass = batch.reader(_CompassMessage)
_read_truth = batch.reader(_TruthMessage)
_read_estimate = batch.reader(_EstimateMessage)


def odometry_batch(datas: Sequence[bytes]) -> list[Odometry]:
    read = _read_odometry(datas)
    velocities = batch.arrays([x for m in read for x in (m.forward_mps, m.left_mps, m.turn_radps)], 3)
    covariances = batch.covariances_or_none([m.covariance for m in read], 3)
    return batch.records(Odometry, batch.stamps([m.stamp_ns for m in read]), velocities, covariances)


def compass_batch(datas: Sequence[bytes]) -> list[Compass]:
    read = _read_compass(datas)
    sigmas = batch.positive([m.sigma_rad for m in read])
    return batch.records(Compass, batch.stamps([m.stamp_ns for m in read]), [m.heading_rad for m in read], sigmas)


def truth_batch(datas: Sequence[bytes]) -> list[Truth]:
    read = _read_truth(datas)
    return batch.records(Truth, batch.stamps([m.stamp_ns for m in read]), poses(read))


def estimate_batch(datas: Sequence[bytes]) -> list[Estimate]:
    read = _read_estimate(datas)
    covariances = batch.covariances([m.covariance for m in read], 3)
    return batch.records(Estimate, batch.stamps([m.stamp_ns for m in read]), poses(read), covariances)


def initial_pose_batch(datas: Sequence[bytes]) -> list[InitialPose]:
    return [InitialPose(e.stamp_ns, e.pose, e.covariance) for e in estimate_batch(datas)]


def poses(read: Sequence[PoseMessage]) -> list[FloatArray]:
    """(3,) each."""
    return batch.arrays([x for m in read for x in (m.x_m, m.y_m, m.heading_rad)], 3)
