"""Sensors and cameras out of the values of ROS messages."""

from collections.abc import Callable
from operator import itemgetter

from fieldloc.pose import FloatArray
from logs.foreign.parts import CameraPart, ImagePart, ImuPart, JointsPart, MagneticPart
from logs.ros.motion import SECOND, stamp
from logs.ros.plan import Plan


def imu(plan: Plan) -> Callable[[list[object]], ImuPart]:
    rotation_at, rotation_in = plan.vector("orientation", "xyzw")
    rate_at, rate_in = plan.vector("angular_velocity", "xyz")
    acceleration_at, acceleration_in = plan.vector("linear_acceleration", "xyz")
    first = [
        (at, within.start)
        for at, within in (
            plan.vector(f"{name}_covariance", 9) for name in ("orientation", "angular_velocity", "linear_acceleration")
        )
    ]
    (rotation_c_at, rotation_c), (rate_c_at, rate_c), (acceleration_c_at, acceleration_c) = first
    pick = itemgetter(
        *stamp(plan),
        plan.place("header.frame_id", "string"),
        *(rotation_at, rotation_c_at, rate_at, rate_c_at, acceleration_at, acceleration_c_at),
    )

    def build(values: list[object]) -> ImuPart:
        """A covariance that begins with -1 says that the quantity before it is not there."""
        seconds, rest, frame, rotation, of_rotation, rate, of_rate, acceleration, of_acceleration = pick(values)
        return ImuPart(
            seconds * SECOND + rest,
            frame,
            None if of_rotation[rotation_c] == -1 else rotation[rotation_in],
            None if of_rate[rate_c] == -1 else rate[rate_in],
            None if of_acceleration[acceleration_c] == -1 else acceleration[acceleration_in],
        )

    return build


def magnetic(plan: Plan) -> Callable[[list[object]], MagneticPart]:
    field_at, field_in = plan.vector("magnetic_field", "xyz")
    pick = itemgetter(*stamp(plan), plan.place("header.frame_id", "string"), field_at)

    def build(values: list[object]) -> MagneticPart:
        seconds, rest, frame, field = pick(values)
        return MagneticPart(seconds * SECOND + rest, frame, field[field_in])

    return build


def joints(plan: Plan) -> Callable[[list[object]], JointsPart]:
    pick = itemgetter(*stamp(plan), plan.place("name", "strings"), plan.place("position", "floats"))

    def build(values: list[object]) -> JointsPart:
        seconds, rest, names, positions = pick(values)
        return JointsPart(seconds * SECOND + rest, tuple(names), positions)

    return build


def camera(plan: Plan) -> Callable[[list[object]], CameraPart]:
    """ROS 1 writes D and K, ROS 2 d and k."""
    matrix, distortion = ("K", "D") if "K" in plan.slots else ("k", "d")
    matrix_at, matrix_in = plan.vector(matrix, 9)
    pick = itemgetter(
        *stamp(plan),
        plan.place("header.frame_id", "string"),
        plan.place("width", "number"),
        plan.place("height", "number"),
        plan.place("distortion_model", "string"),
        matrix_at,
        plan.place(distortion, "floats"),
    )

    def build(values: list[object]) -> CameraPart:
        seconds, rest, frame, width, height, model, array, coefficients = pick(values)
        matrix: FloatArray = array[matrix_in]
        return CameraPart(
            seconds * SECOND + rest, frame, int(width), int(height), matrix.reshape(3, 3), model, coefficients
        )

    return build


def image(plan: Plan) -> Callable[[list[object]], ImagePart]:
    pick = itemgetter(
        *stamp(plan),
        plan.place("header.frame_id", "string"),
        plan.place("encoding", "string"),
        plan.place("data", "bytes"),
        *(plan.place(name, "number") for name in ("width", "height", "step")),
    )

    def build(values: list[object]) -> ImagePart:
        seconds, rest, frame, encoding, data, width, height, step = pick(values)
        return ImagePart(seconds * SECOND + rest, frame, encoding, data, int(width), int(height), int(step))

    return build


def compressed_image(plan: Plan) -> Callable[[list[object]], ImagePart]:
    """image_transport writes formats like `rgb8; jpeg compressed bgr8`: what the bytes are is its second word."""
    pick = itemgetter(
        *stamp(plan),
        plan.place("header.frame_id", "string"),
        plan.place("format", "string"),
        plan.place("data", "bytes"),
    )

    def build(values: list[object]) -> ImagePart:
        seconds, rest, frame, written, data = pick(values)
        return ImagePart(seconds * SECOND + rest, frame, _compression(written), data)

    return build


def _compression(written: str) -> str:
    words = written.lower().split(";")[-1].split()
    return {"jpg": "jpeg"}.get(words[0], words[0]) if words else ""
