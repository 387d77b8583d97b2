"""ROS 1's and CDR's bytes, step by step.

A step takes a message's bytes and a position, appends the values of its stretch that are wanted, and returns the
position behind it; what is not wanted costs an addition. Neighbouring numbers are one step. No length in a message is
believed before the bytes that it promises are there.

CDR aligns each number to its own size, counted from behind the four bytes of the encapsulation header
(OMG, DDS Interoperability Wire Protocol, section 10); ROS 1 aligns nothing.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from logs.foreign.parts import BadPart
from logs.ros.definitions import SEQUENCE, BadDefinition

_MOST_NAMES = 1000  # that are kept, so that a log full of others fills no memory
_LONGEST_NAME = 200

Step = Callable[[bytes, int, list[object]], int]

CODES = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
FLOATS = ("float32", "float64")
BYTES = ("uint8", "byte", "char", "int8")


class Wire(NamedTuple):
    order: str  # "<" or ">"
    aligned: bool


ROS1 = Wire("<", aligned=False)
CDR_LITTLE = Wire("<", aligned=True)
CDR_BIG = Wire(">", aligned=True)


@dataclass(frozen=True, slots=True)
class Number:
    """Numbers of one type beside each other. path: where they are wanted."""

    type: str
    count: int
    path: str | None

    @property
    def size(self) -> int:
        return struct.calcsize("<" + CODES[self.type])


def _misfit() -> BadPart:
    return BadPart("it does not fit its definition")


def block(wire: Wire, kind: str, count: int) -> Step:
    """Floats of one type beside each other, as one array that is not to be written to."""
    dtype = np.dtype(wire.order + ("f4" if kind == "float32" else "f8"))
    size, native = dtype.itemsize * count, dtype == np.float64
    back = dtype.itemsize - 1 if wire.aligned else 0
    mask = ~back

    def step(data: bytes, position: int, out: list[object]) -> int:
        position = ((position - 4 + back) & mask) + 4
        end = position + size
        if end > len(data):
            raise _misfit()
        array = np.frombuffer(data[position:end], dtype)
        out.append(array if native else array.astype(np.float64))
        return end

    return step


def run(wire: Wire, numbers: Sequence[Number]) -> Step:
    """Numbers of many types at once. Where they lie depends on the position, modulo 8, at which they begin."""
    structs = []
    for phase in range(8 if wire.aligned else 1):
        at, text = phase, wire.order
        for number in numbers:
            code, size = CODES[number.type], number.size
            gap = -at % size if wire.aligned and number.count else 0
            text += f"{gap}x" + (f"{number.count * size}x" if number.path is None else f"{number.count}{code}")
            at += gap + number.count * size
        structs.append((struct.Struct(text).unpack_from, at - phase))

    if all(number.path is None for number in numbers):
        sizes = [size for _, size in structs] * (8 // len(structs))
        return lambda data, position, out: position + sizes[(position + 4) & 7]

    if not wire.aligned:
        unpack_only, size_only = structs[0]

        def step_unaligned(data: bytes, position: int, out: list[object]) -> int:
            out += unpack_only(data, position)
            return position + size_only

        return step_unaligned

    def step(data: bytes, position: int, out: list[object]) -> int:
        unpack, size = structs[(position + 4) & 7]
        out += unpack(data, position)
        return position + size

    return step


def _length(wire: Wire) -> Callable[[bytes, int], tuple[int, int]]:
    """A count or length, and the position behind it."""
    unpack = struct.Struct(wire.order + "I").unpack_from
    back = 3 if wire.aligned else 0

    def read(data: bytes, position: int) -> tuple[int, int]:
        position = (position + back) & ~back
        (count,) = unpack(data, position)
        return count, position + 4

    return read


def text(wire: Wire, wanted: bool) -> Step:
    """A string. CDR counts its closing zero; some writers pad with more, some count nothing for an empty one."""
    unpack = struct.Struct(wire.order + "I").unpack_from
    closed = wire.aligned
    known: dict[bytes, str] = {}  # the same few names come again and again
    back = 3 if wire.aligned else 0
    mask = ~back

    def step(data: bytes, position: int, out: list[object]) -> int:
        position = (position + back) & mask
        (length,) = unpack(data, position)
        position += 4
        end: int = position + length
        if end > len(data) or (closed and length and data[end - 1]):
            raise _misfit()
        if wanted:
            raw = data[position:end]
            name = known.get(raw)
            if name is None:
                name = raw.rstrip(b"\0").decode()
                if len(known) < _MOST_NAMES and length < _LONGEST_NAME:
                    known[raw] = name
            out.append(name)
        return end

    return step


def texts(wire: Wire, count: int, wanted: bool) -> Step:
    length, one = _length(wire), text(wire, True)

    def step(data: bytes, position: int, out: list[object]) -> int:
        number, position = length(data, position) if count == SEQUENCE else (count, position)
        if number * 4 > len(data) - position:
            raise _misfit()
        found: list[object] = []
        for _ in range(number):
            position = one(data, position, found)
        if wanted:
            out.append(found)
        return position

    return step


def array(wire: Wire, kind: str, wanted: bool) -> Step:
    """A sequence of numbers: an array of floats, or as bytes where they are."""
    if wanted and kind not in FLOATS + BYTES:
        raise BadDefinition(f"a sequence of {kind} is not expected")
    read_length = _length(wire)
    size = struct.calcsize("<" + CODES[kind])
    back = size - 1 if wire.aligned else 0
    dtype = np.dtype(f"{wire.order}f{size}") if kind in FLOATS else None

    def step(data: bytes, position: int, out: list[object]) -> int:
        count, position = read_length(data, position)
        if count:  # nothing is aligned where nothing follows
            position = ((position - 4 + back) & ~back) + 4
        end = position + count * size
        if end > len(data):
            raise _misfit()
        if wanted:
            raw = data[position:end]
            out.append(raw if dtype is None else np.frombuffer(raw, dtype).astype(np.float64))
        return end

    return step


def messages(wire: Wire, steps: Sequence[Step], least: int, count: int, wanted: bool) -> Step:
    """An array or sequence of messages: a list of rows of values, empty where nothing of them is wanted.

    steps, least: how to read one, and the bytes that it takes at least.
    """
    length = _length(wire)

    def step(data: bytes, position: int, out: list[object]) -> int:
        number, position = length(data, position) if count == SEQUENCE else (count, position)
        if number * least > len(data) - position:
            raise _misfit()
        rows: list[object] = []
        for _ in range(number if least else 0):
            row: list[object] = []
            for each in steps:
                position = each(data, position, row)
            if wanted:
                rows.append(row)
        out.append(rows)
        return position

    return step
