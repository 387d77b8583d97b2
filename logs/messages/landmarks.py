"""Range-bearing scans and the field map as JSON."""

from collections.abc import Sequence

import numpy as np
from msgspec import Raw

from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import LandmarkScan
from logs.messages import batch
from logs.messages.fields import (
    STAMP,
    BadField,
    JsonObject,
    array,
    covariance,
    covariance_rows,
    fixed,
    list_of,
    many,
    number,
    numeric,
    object_schema,
    one,
    or_null,
    stamp,
    string,
    text,
    text_or_none,
)
from logs.messages.motion import PoseMessage, pose_from_json, pose_to_json, poses

LANDMARK_SCAN_SCHEMA = object_schema(
    "Vertical landmarks seen at one instant as range and bearing from a sensor on the robot",
    stamp_ns=STAMP,
    robot_from_sensor=object_schema(
        "Where the sensor sits on the robot",
        x_m=numeric("Ahead of the robot's origin"),
        y_m=numeric("To the left of the robot's origin"),
        heading_rad=numeric("The sensor's forward axis, counter-clockwise from the robot's"),
    ),
    landmarks=list_of(
        object_schema(
            "One landmark",
            label=or_null(string("Its name on the map; null: identity unknown")),
            range_m=numeric("On the ground, from the sensor to the landmark's axis"),
            bearing_rad=numeric("Counter-clockwise from the sensor's forward axis"),
            covariance=fixed("Covariance of (range_m, bearing_rad), positive definite", 2, 2),
        ),
        "May be empty: looked, and saw none",
    ),
)
FIELD_MAP_SCHEMA = object_schema(
    "The map that the log was recorded on, in the field frame; written once",
    name=string("Of the map"),
    line_width_m=numeric("Width of the white lines"),
    lines_m=list_of(fixed("Ends [[x, y], [x, y]] of a line's middle", 2, 2), "Straight lines"),
    circles_m=list_of(fixed("[x, y, radius] of a circle's middle", 3), "Circles"),
    landmarks=list_of(
        object_schema(
            "A vertical cylinder",
            label=string("Its name, unique on the map"),
            x_m=numeric("Of its axis"),
            y_m=numeric("Of its axis"),
            diameter_m=numeric("0 where it is not known"),
            covariance_m2=fixed("Covariance of (x_m, y_m); zeros where the position is taken as exact", 2, 2),
        ),
        "Landmarks",
    ),
)


def landmark_scan_to_json(record: LandmarkScan) -> JsonObject:
    seen = zip(record.labels, record.range_bearing.tolist(), record.covariance.tolist(), strict=True)
    return {
        "stamp_ns": int(record.stamp_ns),
        "robot_from_sensor": pose_to_json(record.robot_from_sensor),
        "landmarks": [
            {"label": label, "range_m": r, "bearing_rad": b, "covariance": matrix} for label, (r, b), matrix in seen
        ],
    }


def landmark_scan_from_json(data: JsonObject) -> LandmarkScan:
    seen = many(data, "landmarks", _seen_from_json)
    return LandmarkScan(
        stamp(data),
        tuple(label for label, _, _ in seen),
        np.array([range_bearing for _, range_bearing, _ in seen], dtype=np.float64).reshape(-1, 2),
        np.array([matrix for _, _, matrix in seen], dtype=np.float64).reshape(-1, 2, 2),
        one(data, "robot_from_sensor", pose_from_json),
    )


def _seen_from_json(data: JsonObject) -> tuple[str | None, tuple[float, float], list[list[float]]]:
    range_bearing = number(data, "range_m", above=0.0), number(data, "bearing_rad")
    return text_or_none(data, "label"), range_bearing, covariance_rows(data, "covariance", 2, definite=True)


def field_map_to_json(record: FieldMap) -> JsonObject:
    return {
        "name": record.name,
        "line_width_m": float(record.line_width_m),
        "lines_m": record.lines.tolist(),
        "circles_m": record.circles.tolist(),
        "landmarks": [_landmark_to_json(landmark) for landmark in record.landmarks],
    }


def field_map_from_json(data: JsonObject) -> FieldMap:
    arguments = (
        text(data, "name"),
        array(data, "lines_m", 2, 2),
        array(data, "circles_m", 3),
        tuple(many(data, "landmarks", _landmark_from_json)),
        number(data, "line_width_m", above=0.0),
    )
    try:
        return FieldMap(*arguments)
    except ValueError as error:  # what only the map as a whole can tell, such as two landmarks of one label
        raise BadField("the map", f"is refused: {error}") from None


def _landmark_to_json(landmark: Landmark) -> JsonObject:
    x, y = landmark.position.tolist()
    return {
        "label": landmark.label,
        "x_m": x,
        "y_m": y,
        "diameter_m": float(landmark.diameter_m),
        "covariance_m2": landmark.covariance.tolist(),
    }


def _landmark_from_json(data: JsonObject) -> Landmark:
    position = np.array([number(data, "x_m"), number(data, "y_m")])
    diameter = number(data, "diameter_m")
    if diameter < 0.0:
        raise BadField("diameter_m", f"is {diameter:g}, must not be negative")
    return Landmark(text(data, "label"), position, diameter, covariance(data, "covariance_m2", 2))


class _SeenMessage(batch.Message):
    label: str | None
    range_m: float
    bearing_rad: float
    covariance: Raw


class _ScanMessage(batch.Message):
    stamp_ns: object
    robot_from_sensor: PoseMessage
    landmarks: list[_SeenMessage]


_read_scans = batch.reader(_ScanMessage)


def landmark_scan_batch(datas: Sequence[bytes]) -> list[LandmarkScan]:
    read = _read_scans(datas)
    seen = [one for m in read for one in m.landmarks]
    batch.positive([one.range_m for one in seen])
    range_bearing = batch.block([x for one in seen for x in (one.range_m, one.bearing_rad)], 2)
    covariances = batch.definite_covariances([one.covariance for one in seen], 2)
    sizes = [len(m.landmarks) for m in read]
    return batch.records(
        LandmarkScan,
        batch.stamps([m.stamp_ns for m in read]),
        [tuple([one.label for one in m.landmarks]) for m in read],
        batch.pieces(range_bearing, sizes),
        batch.pieces(covariances, sizes),
        poses([m.robot_from_sensor for m in read]),
    )
