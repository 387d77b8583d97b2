"""No bytes and no definition make logs.ros do anything but give a part or call the message bad."""

import contextlib
import tracemalloc
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
import ros_messages
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.serde import SerdeError
from test_ros_decode import idl

from logs import ros
from logs.foreign.parts import BadPart, Part
from logs.ros.types import KNOWN
from logs.source import Source

KINDS = [
    (name.replace("/", "/msg/"), ros1, little)
    for name in KNOWN
    for ros1, little in ((False, True), (False, False), (True, True))
    if name != "tf/tfMessage" or ros1
]


def decoder(source: Source) -> Callable[[bytes], Part]:
    decode = ros.decoder(source)
    assert decode is not None
    return decode


DECODERS = {(name, ros1): decoder(ros_messages.source(name, ros1)) for name, ros1, _ in KINDS}


def sample(name: str, ros1: bool, little: bool = True, seed: int = 5) -> bytes:
    message = ros_messages.random_message(name, np.random.default_rng(seed), ros1)
    return ros_messages.packed(message, name, ros1, little=little)


@pytest.mark.parametrize(("name", "ros1", "little"), KINDS)
def test_a_message_that_is_cut_off_anywhere_is_bad(name: str, ros1: bool, little: bool) -> None:
    data = sample(name, ros1, little)
    DECODERS[name, ros1](data)
    for length in range(len(data)):
        with pytest.raises(BadPart):
            DECODERS[name, ros1](data[:length])


@pytest.mark.parametrize(("name", "ros1", "little"), KINDS)
def test_no_length_in_a_message_is_believed(name: str, ros1: bool, little: bool) -> None:
    """Whatever four bytes become a huge number: no more memory is taken than the message is long, by and large."""
    data = sample(name, ros1, little)
    decode = DECODERS[name, ros1]
    tracemalloc.start()
    for at in range(0 if ros1 else 4, len(data) - 4, 4):
        for huge in (b"\xff\xff\xff\xff", b"\0\0\0\x7f", b"\x7f\0\0\0"):
            with contextlib.suppress(BadPart):
                decode(data[:at] + huge + data[at + 4 :])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200_000 + 20 * len(data)


@pytest.mark.parametrize(("name", "ros1", "little"), KINDS)
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=8))
def test_changed_bytes_give_a_part_or_a_bad_one(
    name: str, ros1: bool, little: bool, changes: list[tuple[float, int]]
) -> None:
    data = bytearray(sample(name, ros1, little))
    for place, value in changes:
        data[int(place * (len(data) - 1))] = value
    with contextlib.suppress(BadPart):
        assert isinstance(DECODERS[name, ros1](bytes(data)), KNOWN[name.replace("/msg/", "/")])


@pytest.mark.parametrize(("name", "ros1", "little"), KINDS)
@settings(max_examples=25, deadline=None)
@given(data=st.binary(max_size=400))
def test_any_bytes_give_a_part_or_a_bad_one(name: str, ros1: bool, little: bool, data: bytes) -> None:
    head = b"" if ros1 else b"\0\1\0\0" if little else b"\0\0\0\0"
    with contextlib.suppress(BadPart):
        assert isinstance(DECODERS[name, ros1](head + data), KNOWN[name.replace("/msg/", "/")])


@settings(max_examples=300, deadline=None)
@given(name=st.sampled_from(KINDS), place=st.floats(0, 1), value=st.integers(1, 127))
def test_what_rosbags_refuses_is_refused_and_what_it_reads_is_read(
    name: tuple[str, bool, bool], place: float, value: int
) -> None:
    """With a byte changed, too. (None to zero: we let an empty string without its closing zero be. And none to what is
    not ASCII: rosbags wants the names that we step over to be UTF-8, too.)"""
    kind, ros1, little = name
    data = bytearray(sample(kind, ros1, little))
    data[int(place * (len(data) - 1))] = value
    types = ros_messages.store(ros1)
    try:
        types.deserialize_ros1(bytes(data), kind) if ros1 else types.deserialize_cdr(bytes(data), kind)
        readable = True
    except (SerdeError, IndexError, TypeError):
        readable = False
    try:
        DECODERS[kind, ros1](bytes(data))
        read = True
    except BadPart:
        read = False
    assert read == readable


@settings(max_examples=150, deadline=None)
@given(
    name=st.sampled_from(sorted(KNOWN)),
    encoding=st.sampled_from(["ros2msg", "ros2idl"]),
    changes=st.lists(st.tuples(st.floats(0, 1), st.binary(max_size=3)), min_size=1, max_size=4),
)
def test_no_definition_breaks_anything(name: str, encoding: str, changes: list[tuple[float, bytes]]) -> None:
    name = name.replace("/", "/msg/")
    if name == "tf/msg/tfMessage":
        return
    text = bytearray(ros_messages.source(name).schema_data)
    if encoding == "ros2idl":
        text = bytearray(idl("tf2_msgs/msg/TFMessage").encode())
        name = "tf2_msgs/msg/TFMessage"
    for place, new in changes:
        at = int(place * len(text))
        text[at : at + 1] = new
    decode = decoder(Source("/topic", "cdr", name, encoding, bytes(text) or b" x"))
    with contextlib.suppress(BadPart):
        decode(sample(name, ros1=False))


@pytest.mark.parametrize(
    "text",
    [
        "A a\nA b\n" + "".join(f"{'=' * 80}\nMSG: x/{c}\n{n} a\n{n} b\n" for c, n in pairwise("ABCDEFGHIJKLMN")),
        "float64[4000000000] covariance\n",
        "float64[99999999999999999999] covariance\n",
        "Empty[] nothing\nfloat64[3] a\n" + f"{'=' * 80}\nMSG: geometry_msgs/Empty\n",
        "Twist again\n",
        "\xff\xfe",
        "=" * 100_000,
        "string " * 10_000,
    ],
    ids=["many", "long", "longer", "empty", "itself", "no text", "lines", "words"],
)
def test_definitions_that_would_fill_the_memory_make_messages_bad(text: str) -> None:
    for encoding, schema in (("cdr", "ros2msg"), ("ros1", "ros1msg")):
        decode = decoder(Source("/t", encoding, "geometry_msgs/Twist", schema, text.encode()))
        for data in (b"\0\1\0\0" + b"\xff" * 100, b"\xff" * 104):
            with pytest.raises(BadPart):
                decode(data)
