"""Which of Foxglove's messages are read, and what each becomes.

| schema | part |
|---|---|
| foxglove.CompressedImage, foxglove.RawImage | ImagePart |
| foxglove.CompressedVideo | VideoPart |
| foxglove.CameraCalibration | CameraPart |
| foxglove.FrameTransform, foxglove.FrameTransforms | Transforms |
| foxglove.PoseInFrame | PosePart |
| foxglove.Odometry | OdometryPart |
| foxglove.JointStates | JointsPart |

Field names and meanings: https://docs.foxglove.dev/docs/sdk/schemas.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from fieldloc.pose import FloatArray
from logs.foreign.parts import (
    BadPart,
    CameraPart,
    ImagePart,
    JointsPart,
    OdometryPart,
    Part,
    PosePart,
    Transform,
    Transforms,
    TwistPart,
    VideoPart,
)
from logs.foxglove.wire import Fields


class Kind(NamedTuple):
    part: type[Part]
    convert: Callable[[Fields], Part]


def _compressed_image(fields: Fields) -> ImagePart:
    return ImagePart(_stamp(fields), fields.text("frame_id"), fields.text("format"), fields.data("data"))


def _raw_image(fields: Fields) -> ImagePart:
    return ImagePart(
        _stamp(fields),
        fields.text("frame_id"),
        fields.text("encoding"),
        fields.data("data"),
        fields.integer("width"),
        fields.integer("height"),
        fields.integer("step"),
    )


def _compressed_video(fields: Fields) -> VideoPart:
    return VideoPart(_stamp(fields), fields.text("frame_id"), fields.text("format"))


def _camera_calibration(fields: Fields) -> CameraPart:
    matrix = fields.numbers("K")
    if matrix.shape != (9,):
        raise BadPart(f"K has {matrix.size} numbers, needs 9")
    return CameraPart(
        _stamp(fields),
        fields.text("frame_id"),
        fields.integer("width"),
        fields.integer("height"),
        matrix.reshape(3, 3),
        fields.text("distortion_model"),
        fields.numbers("D"),
    )


def _frame_transform(fields: Fields) -> Transforms:
    return Transforms((_transform(fields),))


def _frame_transforms(fields: Fields) -> Transforms:
    return Transforms(tuple(_transform(child) for child in fields.children("transforms")))


def _transform(fields: Fields) -> Transform:
    """One without a time holds from the beginning on: its stamp is 0."""
    return Transform(
        fields.stamp_ns("timestamp") or 0,
        fields.text("parent_frame_id"),
        fields.text("child_frame_id"),
        _vector(fields.child("translation")),
        _quaternion(fields.child("rotation")),
    )


def _pose_in_frame(fields: Fields) -> PosePart:
    pose = fields.child("pose")
    if pose is None:
        raise BadPart("no pose")
    return PosePart(
        fields.stamp_ns("timestamp"),
        fields.text("frame_id"),
        _vector(pose.child("position")),
        _quaternion(pose.child("orientation")),
    )


def _odometry(fields: Fields) -> OdometryPart:
    """What the sender leaves out, pose or velocity, is NaN."""
    stamp_ns, pose = fields.stamp_ns("timestamp"), fields.child("pose")
    linear, angular = fields.child("linear_velocity"), fields.child("angular_velocity")
    unknown = np.full(3, np.nan)
    return OdometryPart(
        PosePart(
            stamp_ns,
            fields.text("frame_id"),
            unknown if pose is None else _vector(pose.child("position")),
            np.full(4, np.nan) if pose is None else _quaternion(pose.child("orientation")),
            _covariance(fields, "pose_covariance"),
        ),
        TwistPart(
            stamp_ns,
            fields.text("body_frame_id"),
            unknown if linear is None else _vector(linear),
            unknown if angular is None else _vector(angular),
            _covariance(fields, "velocity_covariance"),
        ),
    )


def _joint_states(fields: Fields) -> JointsPart:
    """A joint that tells no position has NaN."""
    joints = fields.children("joints")
    positions = [joint.maybe_number("position") for joint in joints]
    return JointsPart(
        _stamp(fields),
        tuple(joint.text("name") for joint in joints),
        np.array([np.nan if position is None else position for position in positions], dtype=np.float64),
    )


def _stamp(fields: Fields) -> int:
    stamp_ns = fields.stamp_ns("timestamp")
    if stamp_ns is None:
        raise BadPart("no timestamp")
    return stamp_ns


def _vector(fields: Fields | None) -> FloatArray:
    return np.zeros(3) if fields is None else np.array([fields.number(axis) for axis in "xyz"])


def _quaternion(fields: Fields | None) -> FloatArray:
    """No rotation where none is given, as the viewers take it."""
    return np.array([0.0, 0.0, 0.0, 1.0] if fields is None else [fields.number(axis) for axis in "xyzw"])


def _covariance(fields: Fields, name: str) -> FloatArray | None:
    """(6, 6); None where it is left out or all zero, which is Foxglove's way of not saying."""
    values = fields.numbers(name)
    if values.size not in (0, 36):
        raise BadPart(f"{name} has {values.size} numbers, needs 36")
    return values.reshape(6, 6) if values.any() else None


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "foxglove.CompressedImage": Kind(ImagePart, _compressed_image),
        "foxglove.RawImage": Kind(ImagePart, _raw_image),
        "foxglove.CompressedVideo": Kind(VideoPart, _compressed_video),
        "foxglove.CameraCalibration": Kind(CameraPart, _camera_calibration),
        "foxglove.FrameTransform": Kind(Transforms, _frame_transform),
        "foxglove.FrameTransforms": Kind(Transforms, _frame_transforms),
        "foxglove.PoseInFrame": Kind(PosePart, _pose_in_frame),
        "foxglove.Odometry": Kind(OdometryPart, _odometry),
        "foxglove.JointStates": Kind(JointsPart, _joint_states),
    }
)
