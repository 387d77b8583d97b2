"""Range-bearing scans as JSON."""

from collections.abc import Sequence

import numpy as np
from msgspec import Raw

from fieldloc.measurements import LandmarkScan
from logs.messages import batch
from logs.messages.fields import (
    STAMP,
    JsonObject,
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
