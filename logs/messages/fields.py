"""Strict, cheap readers for the fields of a JSON message, and the pieces its JSON Schema is made of.

What is read or written one by one passes through here, so the checks are plain Python on small lists. JSON knows no NaN
and no infinity: a message that carries one (as Python's json writes them, or as null) is refused.
"""

from collections.abc import Callable, Sequence
from math import inf
from typing import TypeVar

import numpy as np

from fieldloc.pose import FloatArray
from logs.messages.symmetric import is_covariance

Json = dict[str, "Json"] | list["Json"] | str | int | float | bool | None
JsonObject = dict[str, Json]
T = TypeVar("T")

_ABSENT = object()


class BadField(ValueError):
    """A field that is missing or holds what it must not; the text begins with its name."""

    def __init__(self, name: str, problem: str) -> None:
        super().__init__(f"{name} {problem}")
        self._name, self._problem = name, problem

    def inside(self, parent: str) -> "BadField":
        """The same complaint, told from one level up."""
        return BadField(f"{parent}.{self._name}", self._problem)


def number(data: JsonObject, name: str, above: float = -inf) -> float:
    """The finite number; `above` is a bound that it must exceed."""
    value = _number(data.get(name, _ABSENT), name)
    if value <= above:
        raise BadField(name, f"is {value:g}, needs to be above {above:g}")
    return value


def integer(data: JsonObject, name: str) -> int:
    value = data.get(name, _ABSENT)
    if type(value) is int:
        return value
    raise BadField(name, _refusal(value, "an integer"))


def text(data: JsonObject, name: str) -> str:
    value = data.get(name, _ABSENT)
    if type(value) is str:
        return value
    raise BadField(name, _refusal(value, "a string"))


def text_or_none(data: JsonObject, name: str) -> str | None:
    return None if data.get(name, _ABSENT) is None else text(data, name)


def texts(data: JsonObject, name: str) -> list[str]:
    """The strings of a list."""
    return [text({name: item}, name) for item in _list(data, name)]


def text_lists(data: JsonObject, name: str) -> list[list[str]]:
    """The lists of strings of a list."""
    return [texts({name: item}, name) for item in _list(data, name)]


def stamp(data: JsonObject) -> int:
    """Field stamp_ns; MCAP keeps times as unsigned 64-bit numbers."""
    value = integer(data, "stamp_ns")
    if 0 <= value < 2**63:
        return value
    raise BadField("stamp_ns", f"is {value}, must be from 0 to 2^63 - 1")


def one(data: JsonObject, name: str, read: Callable[[JsonObject], T]) -> T:
    """The object inside, read; a complaint about it tells where."""
    value = data.get(name, _ABSENT)
    if type(value) is not dict:
        raise BadField(name, _refusal(value, "an object"))
    try:
        return read(value)
    except BadField as error:
        raise error.inside(name) from None


def many(data: JsonObject, name: str, read: Callable[[JsonObject], T]) -> list[T]:
    """Each object of the list, read; a complaint about one tells which."""
    out = []
    for i, item in enumerate(_list(data, name)):
        if type(item) is not dict:
            raise BadField(f"{name}[{i}]", _refusal(item, "an object"))
        try:
            out.append(read(item))
        except BadField as error:
            raise error.inside(f"{name}[{i}]") from None
    return out


def array(data: JsonObject, name: str, *row: int) -> FloatArray:
    """(n, *row) finite numbers, n free."""
    items = [_rows(item, name, row) for item in _list(data, name)]
    return np.array(items, dtype=np.float64).reshape(-1, *row)


def fixed_array(data: JsonObject, name: str, *shape: int) -> FloatArray:
    """Finite numbers of exactly that shape."""
    return np.array(_rows(data.get(name, _ABSENT), name, shape), dtype=np.float64)


def covariance(data: JsonObject, name: str, size: int, definite: bool = False) -> FloatArray:
    """(size, size), symmetric and positive semidefinite; positive definite if asked for. Units may differ per axis."""
    return np.array(covariance_rows(data, name, size, definite))


def covariance_rows(data: JsonObject, name: str, size: int, definite: bool = False) -> list[list[float]]:
    """The same as lists."""
    value = data.get(name, _ABSENT)
    if type(value) is not list or [len(row) if type(row) is list else -1 for row in value] != [size] * size:
        raise BadField(name, f"is not a {size} x {size} matrix" if value is not _ABSENT else "is missing")
    rows = [[_number(x, name) for x in row] for row in value]
    if not is_covariance(rows, definite):
        kind = "definite" if definite else "semidefinite"
        raise BadField(name, f"is not a covariance: it must be symmetric and positive {kind}")
    return rows


def maybe(data: JsonObject, name: str, read: Callable[..., FloatArray], *arguments: int) -> FloatArray | None:
    """What `read(data, name, *arguments)` gives, or None where the message says null."""
    return None if data.get(name, _ABSENT) is None else read(data, name, *arguments)


def _number(value: object, name: str) -> float:
    if type(value) is float:
        if -inf < value < inf:
            return value
        raise BadField(name, f"is {'NaN' if value != value else 'infinite'}")
    if type(value) is int:
        try:
            return float(value)
        except OverflowError:
            raise BadField(name, "is too large for a number") from None
    raise BadField(name, _refusal(value, "a number"))


def _list(data: JsonObject, name: str) -> list[Json]:
    value = data.get(name, _ABSENT)
    if type(value) is list:
        return value
    raise BadField(name, _refusal(value, "a list"))


def _rows(value: object, name: str, shape: Sequence[int]) -> list[object] | float:
    if not shape:
        return _number(value, name)
    if type(value) is not list:
        raise BadField(name, _refusal(value, "a list"))
    if len(value) != shape[0]:
        raise BadField(name, f"has {len(value)} entries where {shape[0]} are needed")
    return [_rows(item, name, shape[1:]) for item in value]


def _refusal(value: object, needed: str) -> str:
    if value is _ABSENT:
        return f"is missing, needs {needed}"
    kinds = {dict: "an object", list: "a list", str: "a string", bool: "a truth value", type(None): "null"}
    return f"is {kinds.get(type(value), 'a number')}, needs {needed}"


def object_schema(description: str, **properties: JsonObject) -> JsonObject:
    """JSON Schema of an object that has all these properties; more may be there."""
    return {"type": "object", "description": description, "required": list(properties), "properties": dict(properties)}


def with_optional(schema: JsonObject, **properties: JsonObject) -> JsonObject:
    """The schema of the same object, which may have these properties too."""
    known = schema["properties"]
    assert isinstance(known, dict)
    return {**schema, "properties": {**known, **properties}}


def numeric(description: str) -> JsonObject:
    return {"type": "number", "description": description}


def string(description: str) -> JsonObject:
    return {"type": "string", "description": description}


def list_of(items: JsonObject, description: str) -> JsonObject:
    return {"type": "array", "description": description, "items": items}


def fixed(description: str, *shape: int) -> JsonObject:
    """Nested lists of numbers of exactly that shape."""
    out: JsonObject = {"type": "number"}
    for size in reversed(shape):
        out = {"type": "array", "minItems": size, "maxItems": size, "items": out}
    return {**out, "description": description}


def or_null(schema: JsonObject) -> JsonObject:
    return {**schema, "type": [schema["type"], "null"]}


STAMP: JsonObject = {"type": "integer", "description": "When it was measured, nanoseconds of the log's clock"}
