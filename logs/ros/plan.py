"""A definition, turned once into the steps that read what someone asked for, whatever messages it is nested in.

An Odometry is four steps: two stamps, two names, and a block of 85 doubles.
"""

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from operator import itemgetter
from typing import NamedTuple

from logs.ros import wire
from logs.ros.definitions import SEQUENCE, BadDefinition, Definitions
from logs.ros.wire import CODES, FLOATS, Number, Step, Wire

_MOST_FIELDS = 5000  # of a definition, everything nested counted; real ones have some hundred at most
_DEEPEST = 32


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

    def numbers(self, paths: Sequence[str]) -> Callable[[list[object]], Sequence[float]]:
        """Reads some numbers, two at least, off a list of values."""
        readers = [self.number(path) for path in paths]
        slots = [self.slots[path] for path in paths]
        if any((slot.kind, slot.place) != ("block", slots[0].place) for slot in slots):
            return lambda values: [read(values) for read in readers]
        get, pick = itemgetter(slots[0].place), itemgetter(*[slot.start for slot in slots])
        return lambda values: pick(get(values).tolist())


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
            if field.type in CODES and field.count != SEQUENCE:
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
        out.steps.append(wire.block(self.wire, numbers[0].type, at))

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
        out.steps.append(wire.run(self.wire, numbers))

    def _add(self, out: Plan, path: str, type_name: str, count: int | None, depth: int) -> None:
        """A string, or a sequence or array of strings, numbers or messages."""
        wanted = self._is_wanted(path)
        many = count or 0
        if type_name == "wstring":
            raise BadDefinition(f"{path} is a wstring, whose size on the wire is not agreed on")
        if type_name == "string" and count is None:
            step, kind, least = wire.text(self.wire, wanted), "string", 4
        elif type_name == "string":
            step, kind, least = wire.texts(self.wire, many, wanted), "strings", 4
        elif type_name in CODES:
            step, least = wire.array(self.wire, type_name, wanted), 4
            kind = "floats" if type_name in FLOATS else "bytes"
        else:
            rows = out.rows[path] = self.plan(type_name, path, depth + 1)
            step = wire.messages(self.wire, rows.steps, rows.least, many, bool(rows.slots))
            kind, least = "rows", rows.least
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
    return length if first.type in FLOATS else 0
