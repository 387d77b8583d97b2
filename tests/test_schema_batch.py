"""decode_many against decode, which is its oracle."""

import json
import random
from dataclasses import fields, is_dataclass

import log_records
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.base import Estimate
from fieldloc.measurements import (
    CameraMount,
    Compass,
    ImageFeatures,
    InitialPose,
    LandmarkScan,
    LineObservation,
    Odometry,
    PostObservation,
    Truth,
)
from logs.messages.batch import Odd
from logs.messages.symmetric import are_covariances, is_covariance
from logs.schema import BY_KIND, SCHEMAS, BadMessage, decode, decode_many, encode

FAST = [schema for schema in SCHEMAS if schema.batch is not None]
NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.integers().map(str),
    st.integers(0, 10**400).map(str),
    st.from_regex(r"-?(0|[1-9][0-9]{0,25})(\.[0-9]{1,25})?([eE][+-]?[0-9]{1,3})?", fullmatch=True),
    st.sampled_from(["NaN", "-Infinity", "1e400", "-0", "-0.0", "01", "1.", ".5", "+1", "0x1", "true", "null", '"1"']),
)


@st.composite
def matrices(draw, size):
    """Covariances, nearly covariances and anything."""
    kind = draw(st.integers(0, 3))
    if kind == 0:
        return draw(log_records.vectors(size, size))
    matrix = draw(log_records.covariances(size))
    if kind == 1:  # singular up to rounding
        root = draw(st.lists(st.floats(-1.0, 1.0), min_size=size, max_size=size))
        matrix = np.outer(root, root)
    if kind >= 2:
        i, j = draw(st.integers(0, size - 1)), draw(st.integers(0, size - 1))
        scale = np.sqrt(matrix[i, i] * matrix[j, j])
        matrix[i, j] += scale * draw(st.sampled_from([1e-10, 1e-9, -1e-9, 1e-8, 1.0, -2.0, -1.0]))
        if kind == 3:
            matrix[j, i] = matrix[i, j]
    return matrix


def one_by_one(schema, datas):
    out = []
    for data in datas:
        try:
            out.append(decode(schema, "/topic", data))
        except BadMessage as error:
            out.append(error)
    return out


def same(a, b):
    if isinstance(a, BadMessage) or isinstance(b, BadMessage):
        return type(a) is type(b) and str(a) == str(b)
    return log_records.same(a, b)


def agree(schema, datas):
    got, wanted = decode_many(schema, "/topic", datas), one_by_one(schema, datas)
    return len(got) == len(wanted) and all(map(same, got, wanted))


def taken(schema, data):
    """Whether the fast path takes this message, and then gives what the slow one gives."""
    try:
        (record,) = schema.batch([data])
    except Odd:
        return False
    (wanted,) = one_by_one(schema, [data])
    assert same(record, wanted), data
    return True


def sites(value):
    """Every place in a JSON value, as (container, key)."""
    keys = value if isinstance(value, dict) else range(len(value))
    for key in keys:
        yield value, key
        if isinstance(value[key], (dict, list)):
            yield from sites(value[key])


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.role)
@given(data=st.data())
@settings(deadline=None, max_examples=40)
def test_a_batch_gives_what_its_messages_give_one_by_one(schema, data):
    records = data.draw(st.lists(log_records.BY_KIND[schema.kind], max_size=24))
    assert agree(schema, [encode(record) for record in records])


@pytest.mark.parametrize("schema", FAST, ids=lambda schema: schema.role)
@given(data=st.data())
@settings(deadline=None, max_examples=60)
def test_what_our_own_writer_writes_goes_the_fast_way(schema, data):
    assert taken(schema, encode(data.draw(log_records.BY_KIND[schema.kind])))


@pytest.mark.parametrize("schema", FAST, ids=lambda schema: schema.role)
@given(data=st.data())
@settings(deadline=None, max_examples=60)
def test_a_message_with_anything_in_any_place_is_read_or_refused_as_alone(schema, data):
    message = json.loads(encode(data.draw(log_records.BY_KIND[schema.kind])))
    container, key = data.draw(st.sampled_from([*sites(message)]))
    change = data.draw(st.sampled_from(["number", "value", "delete", "add", "grow"]))
    if change == "delete":
        del container[key]
    elif change == "add" and isinstance(container, dict):
        container["more"] = data.draw(st.sampled_from([1, None, [1.0], {"stamp_ns": 1}]))
    elif change == "grow" and isinstance(container, list):
        container.append(container[key])
    elif change == "value":
        container[key] = data.draw(
            st.sampled_from(
                [None, True, 0, -1, 1.0, 2**63, 2**64, 10**30, -0.0, "", "\ud800", [], {}, [[]], [[1.0, 0.0]]]
            )
        )
    else:
        container[key] = "HERE"
    text = json.dumps(message, ensure_ascii=data.draw(st.booleans()))
    taken(schema, text.replace('"HERE"', data.draw(NUMBERS)).encode("utf-8", "surrogatepass"))


@pytest.mark.parametrize("rounds", [200, pytest.param(20_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("schema", FAST, ids=lambda schema: schema.role)
def test_a_message_with_any_byte_changed_is_read_or_refused_as_alone(schema, rounds):
    rng = random.Random(1)
    whole = MESSAGES[schema.kind]
    assert taken(schema, whole)
    signs = b'{}[],:"\\0123456789.-+eEnulltruefalseNaN \n\t\r\0\x0b\x1f\x7f\x80\xc3\xed\xff\xef\xbb\xbf'
    for _ in range(rounds):
        data = bytearray(whole)
        for _ in range(rng.choice([1, 1, 2, 3])):
            i = rng.randrange(len(data))
            change = rng.randrange(4)
            if change == 0:
                data[i] = rng.choice(signs)
            elif change == 1:
                data.insert(i, rng.choice(signs))
            elif change == 2:
                del data[i]
            else:
                j = rng.randrange(len(data))
                data[i:i] = data[j : j + rng.randrange(1, 12)]
        taken(schema, bytes(data))


MESSAGES = {
    type(record): encode(record)
    for record in [
        Odometry(12_300_000_000, np.array([0.1, 0.0, -0.3]), np.diag([0.1, 0.2, 0.3])),
        Compass(1, 0.5, 0.25),
        Truth(2, np.array([1e-300, 2.5, -0.0])),
        Estimate(3, np.array([1.0, 2.0, 3.0]), np.eye(3)),
        InitialPose(4, np.array([1.0, 2.0, 3.0]), np.array([[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 0.0]])),
        ImageFeatures(
            6,
            CameraMount(0.5, 0.1, 0.2, 0.0, np.diag([0.0, 1e-4, 1e-4, 1e-4])),
            (
                PostObservation(np.array([[1.5, 2.0], [3.0, 4.0]]), np.eye(4), np.array([1.0, 2.0]), np.eye(2)),
                PostObservation(np.array([[1.5, 2.0], [3.0, 4.0]]), np.eye(4), label="a \u00e9"),
            ),
            (LineObservation(np.array([[1.0, 2.0], [3.0, 4.0]]), np.eye(4)),),
        ),
        LandmarkScan(5, ("7", None), np.array([[1.0, 0.1], [2.0, -0.2]]), np.array([np.eye(2), 2.0 * np.eye(2)])),
    ]
}


@given(stack=st.integers(2, 4).flatmap(lambda n: st.lists(matrices(n), min_size=1, max_size=8)), definite=st.booleans())
@settings(deadline=None, max_examples=150)
def test_a_stack_of_matrices_is_judged_as_each_alone(stack, definite):
    with np.errstate(over="ignore", invalid="ignore"):
        stack = np.array(stack)
    assert are_covariances(stack, definite).tolist() == [is_covariance(m.tolist(), definite) for m in stack]


def numbers_of(record):
    """Every array in a record."""
    if isinstance(record, np.ndarray):
        return [record]
    inner = record if isinstance(record, tuple) else [getattr(record, f.name) for f in fields(record)]
    return [
        found
        for item in inner
        if isinstance(item, (np.ndarray, tuple)) or is_dataclass(item)
        for found in numbers_of(item)
    ]


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
def test_a_change_to_one_record_changes_no_other(kind):
    schema = BY_KIND[kind]
    for other in range(20):
        records = decode_many(schema, "/topic", [MESSAGES[kind]] * 20)
        for numbers in numbers_of(records[other]):
            numbers += 1.0
        whole = decode(schema, "/topic", MESSAGES[kind])
        assert all(same(record, whole) for i, record in enumerate(records) if i != other)


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
@given(bad=st.dictionaries(st.integers(0, 99), st.sampled_from([b"", b"{}", b"[1]", b"\xff", b'{"stamp_ns":1}'])))
@settings(deadline=None, max_examples=25)
def test_bad_messages_among_good_ones_are_told_in_their_place(kind, bad):
    datas = [bad.get(i, MESSAGES[kind]) for i in range(100)]
    got = decode_many(BY_KIND[kind], "/topic", datas)
    assert {i for i, record in enumerate(got) if isinstance(record, BadMessage)} == set(bad)
    assert agree(BY_KIND[kind], datas)


@given(
    st.permutations([b'{"a":1},{"b":[', b"2]}", b'{"stamp_ns":1', b',"heading_rad":1.0,"sigma_rad":1.0}', b" ", b"\n"])
)
@settings(deadline=None)
def test_a_message_ends_where_it_ends(pieces):
    assert agree(BY_KIND[Compass], [MESSAGES[Compass]] * 5 + pieces + [MESSAGES[Compass]] * 5)


def test_a_kept_record_keeps_no_log_in_memory():
    records = decode_many(BY_KIND[Odometry], "/odometry", [MESSAGES[Odometry]] * 500)
    for numbers in numbers_of(records[7]):
        assert numbers.base is None or numbers.base.nbytes <= 16 * numbers.nbytes


@pytest.mark.parametrize(
    ("kind", "path", "value"),
    [
        (Truth, "stamp_ns", 2**63),
        (Truth, "stamp_ns", -1),
        (Truth, "stamp_ns", 1.0),
        (Truth, "stamp_ns", True),
        (Compass, "sigma_rad", 0),
        (Odometry, "covariance", [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        (Odometry, "covariance", [[1.0, 0.0], [0.0, 1.0]]),
        (Odometry, "covariance", [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        (Odometry, "covariance", [[1.0, 0.0, 0.0, 0.0], [1.0, 0.0], [0.0, 0.0, 1.0]]),
        (Estimate, "covariance", None),
        (LandmarkScan, "landmarks.1.covariance", [[1.0, 1.0], [1.0, 1.0]]),
        (LandmarkScan, "landmarks.0.range_m", 0.0),
        (LandmarkScan, "landmarks.0.label", 7),
        (ImageFeatures, "posts.0.foot_px", None),
        (ImageFeatures, "posts.0.foot_covariance_px2", None),
        (ImageFeatures, "posts.1.foot_px", [1.0, 2.0]),
        (ImageFeatures, "mount.height_m", -0.5),
        (ImageFeatures, "mount.covariance", None),
        (ImageFeatures, "lines.0.ends_px", [[1.0, 2.0]]),
        (ImageFeatures, "lines", None),
    ],
)
def test_what_is_refused_alone_is_refused_in_a_batch(kind, path, value):
    message = json.loads(MESSAGES[kind])
    *names, last = [int(name) if name.isdigit() else name for name in path.split(".")]
    place = message
    for name in names:
        place = place[name]
    place[last] = value
    datas = [MESSAGES[kind]] * 10 + [json.dumps(message).encode()] + [MESSAGES[kind]] * 10
    assert [isinstance(record, BadMessage) for record in decode_many(BY_KIND[kind], "/topic", datas)] == [
        i == 10 for i in range(21)
    ]
    assert agree(BY_KIND[kind], datas)


@pytest.mark.parametrize(
    "more", [b'"\xff"', b'"\xed\xa0\x80"', b"1" * 5000, b'"\\ud800"', b"NaN", b"[1,]", b'{"a":1,"a":2}', b"[" * 2000]
)
def test_fields_that_nobody_knows_are_no_way_past_the_rules_of_json(more):
    data = MESSAGES[Compass][:-1] + b',"more":' + more + b"}"
    assert agree(BY_KIND[Compass], [data] * 20)
