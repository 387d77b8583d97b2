import json
from pathlib import Path

import log_records
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.base import Estimate
from fieldloc.errors import FieldlocError
from fieldloc.measurements import Compass, LandmarkScan, Odometry, Truth
from logs.schema import BY_KIND, BY_NAME, BY_ROLE, SCHEMAS, TOPICS, BadMessage, decode, encode, seconds, topic_of

ODOMETRY = Odometry(12_300_000_000, np.array([0.1, 0.0, -0.3]), np.diag([0.1, 0.2, 0.3]))
SCAN = LandmarkScan(5, ("7", None), np.array([[1.0, 0.1], [2.0, -0.2]]), np.array([np.eye(2), 2.0 * np.eye(2)]))


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.role)
@given(data=st.data())
@settings(deadline=None, max_examples=60)
def test_every_record_comes_back_bit_by_bit(schema, data):
    record = data.draw(log_records.BY_KIND[schema.kind])
    assert log_records.same(decode(schema, "/topic", encode(record)), record)


@given(bits=st.integers(0, 2**64 - 1))
@settings(deadline=None)
def test_any_double_survives(bits):
    value = np.array([bits], dtype=np.uint64).view(np.float64)
    if np.isfinite(value[0]):
        pose = np.array([value[0], -0.0, 0.0])
        assert decode(BY_ROLE["truth"], "/truth", encode(Truth(0, pose))).pose.tobytes() == pose.tobytes()


def test_names_carry_versions_and_topics_are_the_documented_ones():
    assert {schema.role: schema.name for schema in SCHEMAS} == {
        "odometry": "fieldloc.Odometry.v1",
        "camera": "fieldloc.Camera.v1",
        "image_features": "fieldloc.ImageFeatures.v1",
        "landmarks": "fieldloc.LandmarkScan.v1",
        "compass": "fieldloc.Compass.v1",
        "truth": "fieldloc.Truth.v1",
        "estimate": "fieldloc.Estimate.v1",
        "initial_pose": "fieldloc.InitialPose.v1",
        "hypotheses": "fieldloc.Ambiguity.v1",
        "events": "fieldloc.Event.v1",
        "field": "fieldloc.FieldMap.v1",
    }
    assert all(TOPICS[role] == f"/{role}" for role in TOPICS)
    assert topic_of(Truth) == "/truth"


def complaints(value, schema, where="message"):
    """What a value has wrong by its JSON Schema; the oracle for the part of JSON Schema that is used here."""
    kinds = {"object": dict, "array": list, "string": str, "number": (int, float), "integer": int, "null": type(None)}
    allowed = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    if not any(isinstance(value, kinds[name]) for name in allowed):
        return [f"{where} is not {allowed}"]
    if isinstance(value, dict):
        if set(value) != set(schema["properties"]) or not set(schema["required"]) <= set(schema["properties"]):
            return [f"{where} has {sorted(value)}"]
        return [c for name in value for c in complaints(value[name], schema["properties"][name], f"{where}.{name}")]
    if isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            return [f"{where} has {len(value)} items"]
        return [c for item in value for c in complaints(item, schema["items"], f"{where}[]")]
    return []


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.role)
@given(data=st.data())
@settings(deadline=None, max_examples=20)
def test_messages_are_what_their_json_schema_says(schema, data):
    record = data.draw(log_records.BY_KIND[schema.kind])
    assert complaints(json.loads(encode(record)), json.loads(schema.text)) == []


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.role)
def test_every_number_in_a_schema_names_its_unit_or_is_explained(schema):
    units = ("_m", "_rad", "_px", "_mps", "_radps", "_ns", "_m2", "_px2")

    def walk(name, node):
        if "properties" in node:
            for key, value in node["properties"].items():
                yield from walk(key, value)
        elif node.get("items", {}).get("type") == "object":
            yield from walk(name, node["items"])
        elif "string" not in json.dumps(node) and name != "distortion":
            yield name, node.get("description", "")

    for name, description in walk("", json.loads(schema.text)):
        assert description, name
        assert name.endswith(units) or name in {"covariance", "weight", "mirrored", "lost", "track"}, name


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.role)
@given(data=st.data())
@settings(deadline=None, max_examples=60)
def test_any_field_missing_or_of_a_wrong_type_is_refused_by_name(schema, data):
    message = json.loads(encode(data.draw(log_records.BY_KIND[schema.kind])))
    name = data.draw(st.sampled_from(sorted(message)))
    if name in schema.json_schema["required"] and data.draw(st.booleans()):
        del message[name]
    else:
        message[name] = data.draw(st.sampled_from([True, {"a": 1}, "NaN", [[]], [1, 2]]))
        if type(message[name]) is str and schema.json_schema["properties"][name]["type"] == "string":
            message[name] = 7
        if message[name] in ([[]], [1, 2]) and name == "distortion":
            message[name] = 7
    with pytest.raises(BadMessage, match=name) as error:
        decode(schema, "/some/topic", json.dumps(message).encode())
    assert str(error.value).startswith("/some/topic")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"forward_mps": float("nan")}, "forward_mps is NaN"),
        ({"left_mps": float("inf")}, "left_mps is infinite"),
        ({"turn_radps": None}, "turn_radps is null"),
        ({"turn_radps": "1.0"}, "turn_radps is a string"),
        ({"turn_radps": 10**400}, "turn_radps is too large"),
        ({"covariance": [[1, 0, 0], [0, 1, 0]]}, "covariance is not a 3 x 3 matrix"),
        ({"covariance": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "covariance is not a covariance"),
        ({"covariance": [[1, 2, 0], [2, 1, 0], [0, 0, 1]]}, "covariance is not a covariance"),
        ({"covariance": [[1, 0.5, 0], [0.4, 1, 0], [0, 0, 1]]}, "covariance is not a covariance"),
        ({"covariance": [[0, 0.5, 0], [0.5, 1, 0], [0, 0, 1]]}, "covariance is not a covariance"),
        ({"covariance": [[1, 0, 0], [0, 1, 0], [0, 0, float("nan")]]}, "covariance is NaN"),
    ],
)
def test_odometry_with_values_that_mean_nothing_names_topic_stamp_and_field(change, complaint):
    message = {**json.loads(encode(ODOMETRY)), **change}
    with pytest.raises(FieldlocError, match=complaint) as error:
        decode(BY_KIND[Odometry], "/odometry", json.dumps(message).encode())
    assert "/odometry at 12.3 s" in str(error.value)


@pytest.mark.parametrize("stamp", [-1, 2**63, 1.5, True, None, "0"])
def test_a_stamp_is_a_whole_number_that_mcap_can_hold(stamp):
    message = {**json.loads(encode(ODOMETRY)), "stamp_ns": stamp}
    with pytest.raises(BadMessage, match="stamp_ns"):
        decode(BY_KIND[Odometry], "/odometry", json.dumps(message).encode())


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"range_m": float("nan")}, r"landmarks\[1\]\.range_m is NaN"),
        ({"range_m": 0.0}, r"landmarks\[1\]\.range_m is 0, needs to be above 0"),
        ({"bearing_rad": None}, r"landmarks\[1\]\.bearing_rad is null"),
        ({"label": 7}, r"landmarks\[1\]\.label is a number"),
        ({"covariance": [[1.0, 1.0], [1.0, 1.0]]}, r"landmarks\[1\]\.covariance .* positive definite"),
        ({"covariance": [[1.0, 0.0], [0.0, 0.0]]}, r"landmarks\[1\]\.covariance .* positive definite"),
    ],
)
def test_a_bad_landmark_is_named_by_its_place_in_the_scan(change, complaint):
    message = json.loads(encode(SCAN))
    message["landmarks"][1] |= change
    with pytest.raises(BadMessage, match=complaint):
        decode(BY_KIND[LandmarkScan], "/landmarks", json.dumps(message).encode())


@pytest.mark.parametrize(
    "data", [b"", b"{", b"[]", b"\xff\xfe", b"null", b"[" * 100_000, b'{"stamp_ns":' + b"1" * 9999]
)
def test_what_is_no_json_object_is_refused(data):
    with pytest.raises(BadMessage, match="/odometry: a message is not"):
        decode(BY_KIND[Odometry], "/odometry", data)


@given(matrix=log_records.covariances(3))
@settings(deadline=None)
def test_covariances_of_any_units_pass_and_pass_no_more_with_a_negative_direction(matrix):
    assert decode(BY_KIND[Estimate], "/e", encode(Estimate(0, np.zeros(3), matrix))).covariance.shape == (3, 3)
    scale = np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix / scale[:, None] / scale)
    values[0] = -1e-6  # a thousand times what is taken for rounding
    bad = (vectors * values) @ vectors.T * scale[:, None] * scale
    with pytest.raises(ValueError, match="covariance"):
        encode(Estimate(0, np.zeros(3), 0.5 * (bad + bad.T)))


def test_a_covariance_of_lower_rank_is_an_estimate_s_right():
    direction = np.array([[1.0, 2.0, 3.0]])
    for matrix in (direction.T @ direction, np.zeros((3, 3)), np.diag([1.0, 0.0, 2.0])):
        assert log_records.same(
            decode(BY_KIND[Estimate], "/e", encode(Estimate(0, np.zeros(3), matrix))).covariance, matrix
        )


@pytest.mark.parametrize(
    "record",
    [
        Truth(0, np.array([np.nan, 0.0, 0.0])),
        Truth(0, np.zeros(4)),
        Truth(-1, np.zeros(3)),
        Compass(0, 0.0, 0.0),
        Odometry(0, np.zeros(3), -np.eye(3)),
        LandmarkScan(0, ("a",), np.ones((2, 2)), np.array([np.eye(2)] * 2)),
    ],
)
def test_what_no_reader_would_accept_is_not_encoded(record):
    with pytest.raises(ValueError):
        encode(record)


def test_numpy_scalars_are_numbers():
    record = Compass(np.int64(5), np.float64(0.25), np.float64(0.5))
    assert decode(BY_KIND[Compass], "/compass", encode(record)) == Compass(5, 0.25, 0.5)


def test_fields_that_a_later_writer_adds_do_not_hurt():
    message = {**json.loads(encode(ODOMETRY)), "wheel_slip": [1, 2, 3]}
    assert log_records.same(decode(BY_KIND[Odometry], "/odometry", json.dumps(message).encode()), ODOMETRY)


def test_an_unknown_version_has_no_schema():
    assert "fieldloc.Odometry.v1" in BY_NAME
    assert "fieldloc.Odometry.v2" not in BY_NAME


def test_stamps_are_shown_exactly():
    assert seconds(12_300_000_000) == "12.3 s"
    assert seconds(1_248_444_187_156_000_001) == "1248444187.156000001 s"
    assert seconds(0) == "0.0 s"
    assert seconds(-1_500_000_000) == "-1.5 s"


def test_the_documentation_names_every_schema_topic_and_field():
    text = (Path(__file__).parents[1] / "docs" / "log-format.md").read_text()

    def names(node):
        for name, inner in node.get("properties", {}).items():
            yield name
            yield from names(inner)
        if "items" in node:
            yield from names(node["items"])

    for schema in SCHEMAS:
        assert f"| `/{schema.role}` | `{schema.name}` |" in text
        assert [name for name in names(schema.json_schema) if name not in text] == []
