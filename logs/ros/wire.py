"""ROS 1's and CDR's bytes to the few values that someone asked for, by the definition that is in the file.

A definition is turned once into a short list of steps. Each takes the message's bytes and a position, appends what is
wanted of its stretch and returns the position behind it; what is not wanted costs an addition. Neighbouring numbers
are one step, whatever messages they are nested in: an Odometry is two stamps, two names, and a block of 85 doubles.
No length in a message is believed before the bytes that it promises are there.

CDR aligns each number to its own size, counted from behind the four bytes of the encapsulation header
(OMG, DDS Interoperability Wire Protocol, section 10); ROS 1 aligns nothing.
"""

import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from logs.foreign.parts import BadPart
from logs.ros.definitions import SEQUENCE, BadDefinition, Definitions

Step = Callable[[bytes, int, list[object]], int]

_CODES = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_FLOATS = ("float32", "float64")
_BYTES = ("uint8", "byte", "char", "int8")
_MOST_FIELDS = 5000  # of a definition, everything nested counted; real ones have some hundred at most
_DEEPEST = 32


class Wire(NamedTuple):
    order: str  # "<" or ">"
    aligned: bool

    @property
    def start(self) -> int:
        return 4 if self.aligned else 0


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
        return struct.calcsize("<" + _CODES[self.type])


class Slot(NamedTuple):
    """Where a value is: the place in the list, and its range there if that is an array of several fields.

    kind: "number", "block" (of floats), "floats", "bytes", "string", "strings" or "rows".
    """

    kind: str
    place: int
    start: int = 0
    stop: int = 0


_NOWHERE = Slot("", -1)


class Plan:
    """How to read one type. `slots`: by path; `rows`: the plans of the elements of sequences of messages, by path."""

    def __init__(self) -> None:
        self.steps: list[Step] = []
        self.least = 0  # bytes, without padding
        self.slots: dict[str, Slot] = {}
        self.rows: dict[str, Plan] = {}
        self.places = 0

    def take(self, data: bytes, position: int) -> tuple[list[object], int]:
        values: list[object] = []
        for step in self.steps:
            position = step(data, position, values)
        return values, position

    def has(self, path: str) -> bool:
        return path in self.slots or any(slot.startswith(path + ".") for slot in self.slots)

    def place(self, path: str, kind: str) -> int:
        """Where in the list the value of this path is; BadDefinition where there is none of this kind."""
        slot = self.slots.get(path, _NOWHERE)
        if slot.kind != kind:
            raise BadDefinition(f"it has no field {path} that is a {kind}")
        return slot.place

    def vector(self, path: str, names: str | int) -> tuple[int, slice]:
        """The array in which the numbers of a field are, and their range there.

        names: the letters of its fields ("xyz"), or the length of an array. BadDefinition where they are not so.
        """
        paths = [path] if isinstance(names, int) else [f"{path}.{name}" for name in names]
        count = names if isinstance(names, int) else len(names)
        slots = [self.slots.get(each, _NOWHERE) for each in paths]
        first, last = slots[0], slots[-1]
        side_by_side = all(a.place == b.place and a.stop == b.start for a, b in pairwise(slots))
        if first.kind != "block" or not side_by_side or last.stop - first.start != count:
            raise BadDefinition(f"{path} is not {count} floating-point numbers")
        return first.place, slice(first.start, last.stop)

    def number(self, path: str) -> Callable[[list[object]], float]:
        """Reads one number off a list of values."""
        slot = self.slots.get(path, _NOWHERE)
        get = itemgetter(slot.place)
        if slot.kind == "number":
            return lambda values: float(get(values))
        if slot.kind == "block" and slot.stop - slot.start == 1:
            return lambda values: float(get(values)[slot.start])
        raise BadDefinition(f"it has no number {path}")


def plan(definitions: Definitions, name: str, wanted: Sequence[str], wire: Wire) -> Plan:
    """wanted: paths ("pose.pose"; "posts.bb.center" inside of sequences too); what a type does not have is let be.

    BadDefinition for a definition that leads nowhere.
    """
    return _Planner(definitions, tuple(wanted), wire).plan(name, "", 0)


class _Planner:
    def __init__(self, definitions: Definitions, wanted: tuple[str, ...], wire: Wire) -> None:
        self.definitions, self.wanted, self.wire = definitions, wanted, wire
        self.fields_left = _MOST_FIELDS

    def plan(self, name: str, path: str, depth: int) -> Plan:
        out = Plan()
        numbers: list[Number] = []
        for item in self._flat(name, path, depth):
            if isinstance(item, Number):
                numbers.append(item)
                continue
            self._flush(out, numbers)
            self._add(out, *item, depth)
        self._flush(out, numbers)
        return out

    def _is_wanted(self, path: str) -> bool:
        return any(path == each or path.startswith(each + ".") for each in self.wanted)

    def _flat(self, name: str, path: str, depth: int) -> "Iterable[Number | tuple[str, str, int | None]]":
        """The fields one after the other, messages inside dissolved. Not numbers: (path, type, count)."""
        if depth > _DEEPEST:
            raise BadDefinition(f"{name} is nested too deeply")
        fields = self.definitions.fields(name)
        if not fields and self.wire.aligned:
            yield Number("uint8", 1, None)  # ROS 2 gives an empty message one member, since C has no empty struct
        for field in fields:
            self.fields_left -= 1
            if self.fields_left < 0:
                raise BadDefinition("it has too many fields")
            inner = f"{path}.{field.name}" if path else field.name
            if field.type in _CODES and field.count != SEQUENCE:
                count = 1 if field.count is None else field.count
                yield Number(field.type, count, inner if self._is_wanted(inner) else None)
            elif field.count is None and field.type not in ("string", "wstring"):
                yield from self._flat(field.type, inner, depth + 1)
            else:
                yield inner, field.type, field.count

    def _flush(self, out: Plan, numbers: list[Number]) -> None:
        """Numbers gathered so far become steps: blocks of floats as arrays, the rest one by one."""
        run: list[Number] = []
        while numbers:
            length = _block_length(numbers)
            if sum(number.count for number in numbers[:length]) < 3:
                run.append(numbers.pop(0))
                continue
            self._run(out, run)
            self._block(out, numbers[:length])
            del numbers[:length]
            run = []
        self._run(out, run)

    def _block(self, out: Plan, numbers: Sequence[Number]) -> None:
        at = 0
        for number in numbers:
            assert number.path is not None
            out.slots[number.path] = Slot("block", out.places, at, at + number.count)
            at += number.count
        out.places += 1
        out.least += at * numbers[0].size
        out.steps.append(_block(self.wire, numbers[0].type, at))

    def _run(self, out: Plan, numbers: Sequence[Number]) -> None:
        if not numbers:
            return
        for number in numbers:
            out.least += number.size * number.count
            if number.path is not None:
                if number.count != 1:
                    raise BadDefinition(f"{number.path} is an array of {number.type}")
                out.slots[number.path] = Slot("number", out.places)
                out.places += 1
        out.steps.append(_run(self.wire, numbers))

    def _add(self, out: Plan, path: str, type_name: str, count: int | None, depth: int) -> None:
        """A string, or a sequence or array of strings, numbers or messages."""
        wanted = self._is_wanted(path)
        many = count or 0
        if type_name == "wstring":
            raise BadDefinition(f"{path} is a wstring, whose size on the wire is not agreed on")
        if type_name == "string" and count is None:
            step, kind, least = _text(self.wire, wanted), "string", 4
        elif type_name == "string":
            step, kind, least = _texts(self.wire, many, wanted), "strings", 4
        elif type_name in _CODES:
            step, least = _array(self.wire, type_name, wanted), 4
            kind = "floats" if type_name in _FLOATS else "bytes"
        else:
            rows = out.rows[path] = self.plan(type_name, path, depth + 1)
            step, kind, least = _messages(self.wire, rows, many), "rows", rows.least
            wanted = True
        out.steps.append(step)
        out.least += 4 if many == SEQUENCE else least * max(many, count is None)
        if wanted:
            out.slots[path] = Slot(kind, out.places)
            out.places += 1


def _block_length(numbers: Sequence[Number]) -> int:
    """How many of these, from the first on, are wanted floats of one type."""
    first = numbers[0]
    length = 0
    while length < len(numbers) and numbers[length].path is not None and numbers[length].type == first.type:
        length += 1
    return length if first.type in _FLOATS else 0


def _cut_off() -> BadPart:
    return BadPart("it is shorter than its definition says")


def _block(wire: Wire, kind: str, count: int) -> Step:
    dtype = np.dtype(wire.order + ("f4" if kind == "float32" else "f8"))
    size, native = dtype.itemsize * count, dtype == np.float64
    back = dtype.itemsize - 1 if wire.aligned else 0
    mask = ~back

    def step(data: bytes, position: int, out: list[object]) -> int:
        position = ((position - 4 + back) & mask) + 4
        end = position + size
        if end > len(data):
            raise _cut_off()
        array = np.frombuffer(data[position:end], dtype)
        out.append(array if native else array.astype(np.float64))
        return end

    return step


def _run(wire: Wire, numbers: Sequence[Number]) -> Step:
    """Numbers of many types at once. Where they lie depends on the position, modulo 8, at which they begin."""
    structs = []
    for phase in range(8 if wire.aligned else 1):
        at, text = phase, wire.order
        for number in numbers:
            code, size = _CODES[number.type], number.size
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


def _text(wire: Wire, wanted: bool) -> Step:
    unpack = struct.Struct(wire.order + "I").unpack_from
    back = 3 if wire.aligned else 0
    mask = ~back

    def step(data: bytes, position: int, out: list[object]) -> int:
        position = (position + back) & mask
        (length,) = unpack(data, position)
        position += 4
        end: int = position + length
        if end > len(data):
            raise _cut_off()
        if wanted:  # CDR counts the closing zero; some writers leave it out, or pad with more
            out.append(data[position:end].rstrip(b"\0").decode())
        return end

    return step


def _texts(wire: Wire, count: int, wanted: bool) -> Step:
    length, text = _length(wire), _text(wire, True)

    def step(data: bytes, position: int, out: list[object]) -> int:
        number, position = length(data, position) if count == SEQUENCE else (count, position)
        if number * 4 > len(data) - position:
            raise _cut_off()
        texts: list[object] = []
        for _ in range(number):
            position = text(data, position, texts)
        if wanted:
            out.append(texts)
        return position

    return step


def _array(wire: Wire, kind: str, wanted: bool) -> Step:
    """A sequence of numbers: an array of floats, or as bytes where they are."""
    if wanted and kind not in _FLOATS + _BYTES:
        raise BadDefinition(f"a sequence of {kind} is not expected")
    read_length = _length(wire)
    size = struct.calcsize("<" + _CODES[kind])
    back = size - 1 if wire.aligned else 0
    dtype = np.dtype(f"{wire.order}f{size}") if kind in _FLOATS else None

    def step(data: bytes, position: int, out: list[object]) -> int:
        count, position = read_length(data, position)
        if count:  # nothing is aligned where nothing follows
            position = ((position - 4 + back) & ~back) + 4
        end = position + count * size
        if end > len(data):
            raise _cut_off()
        if wanted:
            raw = data[position:end]
            out.append(raw if dtype is None else np.frombuffer(raw, dtype).astype(np.float64))
        return end

    return step


def _messages(wire: Wire, element: Plan, count: int) -> Step:
    """An array or sequence of messages: a list of rows of values, empty where nothing of them is wanted."""
    length, steps, least = _length(wire), element.steps, element.least
    wanted = bool(element.slots)

    def step(data: bytes, position: int, out: list[object]) -> int:
        number, position = length(data, position) if count == SEQUENCE else (count, position)
        if number * least > len(data) - position:
            raise _cut_off()
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
