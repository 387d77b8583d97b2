"""The records that a log can hold, each with its name, version, topic and JSON Schema (docs/log-format.md).

Messages are JSON (MCAP message encoding "json") described by JSON Schema ("jsonschema"), so that any viewer shows them
and any person reads them. Numbers come back bit by bit. A change that an old reader would misread makes a new version.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeVar

import msgspec

from estimators.base import Ambiguity, Estimate, Event
from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import Compass, ImageFeatures, InitialPose, LandmarkScan, Odometry, Truth
from logs.messages import ambiguity, camera, image, landmarks, maps, motion
from logs.messages.batch import Odd
from logs.messages.fields import BadField, JsonObject

MESSAGE_ENCODING = "json"
SCHEMA_ENCODING = "jsonschema"

Stamped = Odometry | ImageFeatures | LandmarkScan | Compass | Truth | Estimate | InitialPose | Ambiguity | Event
Record = Stamped | Camera | FieldMap
R = TypeVar("R", bound=Record)

_FEW = 8  # messages are read one by one
_ENCODER = msgspec.json.Encoder()  # a float as the shortest text that comes back bit by bit


class BadMessage(FieldlocError):
    """A message that does not hold what its schema promises. Names topic, stamp and field."""


@dataclass(frozen=True, slots=True)
class Schema:
    """How one kind of record is written. Its role in a log is also the name of its usual topic."""

    role: str
    kind: type
    version: int
    json_schema: JsonObject
    to_json: Callable[[Record], JsonObject]
    from_json: Callable[[JsonObject], Record]
    batch: Callable[[Sequence[bytes]], Sequence[Record]] | None
    """Reads many messages as `from_json` would, or raises logs.messages.batch.Odd."""

    @property
    def name(self) -> str:
        """As MCAP's schema record has it: fieldloc.Odometry.v1."""
        return f"fieldloc.{self.kind.__name__}.v{self.version}"

    @property
    def text(self) -> str:
        """The JSON Schema as it stands in the file."""
        head: JsonObject = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": self.name}
        return json.dumps({**head, **self.json_schema}, indent=1)


def _schema(
    role: str,
    kind: type[R],
    json_schema: JsonObject,
    to_json: Callable[[R], JsonObject],
    from_json: Callable[[JsonObject], R],
    batch: Callable[[Sequence[bytes]], Sequence[R]] | None = None,
    version: int = 1,
) -> Schema:
    def checked(record: Record) -> JsonObject:
        if not isinstance(record, kind):
            raise ValueError(f"a {type(record).__name__} where a {kind.__name__} is needed")
        return to_json(record)

    return Schema(role, kind, version, json_schema, checked, from_json, batch)


SCHEMAS = (
    _schema(
        "odometry",
        Odometry,
        motion.ODOMETRY_SCHEMA,
        motion.odometry_to_json,
        motion.odometry_from_json,
        motion.odometry_batch,
    ),
    _schema("camera", Camera, camera.CAMERA_SCHEMA, camera.camera_to_json, camera.camera_from_json),
    _schema(
        "image_features",
        ImageFeatures,
        image.IMAGE_FEATURES_SCHEMA,
        image.image_features_to_json,
        image.image_features_from_json,
        image.image_features_batch,
    ),
    _schema(
        "landmarks",
        LandmarkScan,
        landmarks.LANDMARK_SCAN_SCHEMA,
        landmarks.landmark_scan_to_json,
        landmarks.landmark_scan_from_json,
        landmarks.landmark_scan_batch,
    ),
    _schema(
        "compass",
        Compass,
        motion.COMPASS_SCHEMA,
        motion.compass_to_json,
        motion.compass_from_json,
        motion.compass_batch,
    ),
    _schema("truth", Truth, motion.TRUTH_SCHEMA, motion.truth_to_json, motion.truth_from_json, motion.truth_batch),
    _schema(
        "estimate",
        Estimate,
        motion.ESTIMATE_SCHEMA,
        motion.estimate_to_json,
        motion.estimate_from_json,
        motion.estimate_batch,
    ),
    _schema(
        "initial_pose",
        InitialPose,
        motion.INITIAL_POSE_SCHEMA,
        motion.estimate_to_json,
        motion.initial_pose_from_json,
        motion.initial_pose_batch,
    ),
    _schema(
        "hypotheses",
        Ambiguity,
        ambiguity.AMBIGUITY_SCHEMA,
        ambiguity.ambiguity_to_json,
        ambiguity.ambiguity_from_json,
    ),
    _schema("events", Event, ambiguity.EVENT_SCHEMA, ambiguity.event_to_json, ambiguity.event_from_json),
    _schema("field", FieldMap, maps.FIELD_MAP_SCHEMA, maps.field_map_to_json, maps.field_map_from_json),
)
BY_NAME: Mapping[str, Schema] = MappingProxyType({schema.name: schema for schema in SCHEMAS})
BY_ROLE: Mapping[str, Schema] = MappingProxyType({schema.role: schema for schema in SCHEMAS})
BY_KIND: Mapping[type, Schema] = MappingProxyType({schema.kind: schema for schema in SCHEMAS})
TOPICS: Mapping[str, str] = MappingProxyType({schema.role: f"/{schema.role}" for schema in SCHEMAS})
"""Where each role is written, and looked for unless told otherwise."""
ROS2_ESTIMATES = "/fieldloc/pose_with_covariance"
"""Where estimates are written as ROS 2 messages, and looked for too."""


def topic_of(kind: type[R]) -> str:
    """Where records of this kind are usually written."""
    return TOPICS[BY_KIND[kind].role]


def encode(record: Record) -> bytes:
    """The record as JSON. ValueError for what a reader would refuse: NaN, infinity, no covariance, wrong shapes."""
    schema = BY_KIND[type(record)]
    data = schema.to_json(record)
    try:
        schema.from_json(data)  # a reader's own checks, so that none can be forgotten
    except BadField as error:
        raise ValueError(f"{schema.name}{_when(data)}: {error}") from None
    return _ENCODER.encode(data)


def decode(schema: Schema, topic: str, data: bytes) -> Record:
    """The record, exactly as it was encoded; BadMessage for anything that the schema does not allow."""
    try:
        parsed = json.loads(data)
    except (ValueError, RecursionError):
        raise BadMessage(f"{topic}: a message is not JSON, its schema {schema.name} needs it") from None
    if type(parsed) is not dict:
        raise BadMessage(f"{topic}: a message is not a JSON object, its schema {schema.name} needs one")
    try:
        return schema.from_json(parsed)
    except BadField as error:
        raise BadMessage(f"{topic}{_when(parsed)}: {error} ({schema.name})") from None


def decode_many(schema: Schema, topic: str, datas: Sequence[bytes]) -> list[Record | BadMessage]:
    """What `decode` gives for each, bit by bit, or the BadMessage that it raises; several times as fast."""
    if len(datas) > _FEW and schema.batch is not None:
        try:
            return [*schema.batch(datas)]
        except Odd:  # most often one message in many
            half = len(datas) // 2
            return decode_many(schema, topic, datas[:half]) + decode_many(schema, topic, datas[half:])
    out: list[Record | BadMessage] = []
    for data in datas:
        try:
            out.append(decode(schema, topic, data))
        except BadMessage as error:
            out.append(error)
    return out


def seconds(stamp_ns: int) -> str:
    """A stamp for people, exact to the nanosecond: '12.3 s'."""
    whole, rest = divmod(abs(stamp_ns), 10**9)
    digits = f"{rest:09d}".rstrip("0") or "0"
    return f"{'-' if stamp_ns < 0 else ''}{whole}.{digits} s"


def _when(data: JsonObject) -> str:
    stamp = data.get("stamp_ns")
    return f" at {seconds(stamp)}" if type(stamp) is int else ""
